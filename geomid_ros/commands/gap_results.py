"""The verdict on a gap, its findings, channels and candidates, as tables."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

from rich.console import Console
from rich.table import Table

from geomid_ros.api.gap import Gap
from geomid_ros.checks.verdict import recording_verdict
from geomid_ros.commands.terminal import lines, number_columns, plain_table, print_verdict, results_console, say
from geomid_ros.exports.handover import JudgedFile
from geomid_ros.gap.result import GapResult
from geomid_ros.report import gap_words
from geomid_ros.resimulation.resimulate import Resimulated

_BAR = 24  # characters
_AFTER, _INERTIAS, _BEFORE = "█", "▓", "░"


def show(found: Gap) -> None:
    """Print the verdict, what was found, the gap of every channel, candidates, and what to record next."""
    console = results_console()
    result, review = found.result, found.session.review
    print_verdict(console, recording_verdict(review.findings), review.warnings(), found.session.notes)
    say(console, result.verdict.upper(), f"  {gap_words.verdict_sentence(result)}")
    for sentence in gap_words.in_short(result):
        say(console, "", sentence)
    if result.findings:
        console.print(_findings_table(result))
    for sentence in (*gap_words.of_every_joint(result), *_sentences(result)):
        say(console, "", sentence)
    console.print(_channels_table(result))
    _print_file(console, found.handover)
    for simulation in found.simulated:
        console.print(_simulated_table(simulation))
    if found.not_simulated:
        say(console, "No resimulation", f"  {found.not_simulated}")
    if result.ranking and result.verdict != "no gap":
        console.print(_candidates_table(result))
    record = gap_words.to_record(result)
    if record:
        say(console, "Next recording", "")
        for what in record:
            say(console, "", f"- {what}")


def _print_file(console: Console, judged: JudgedFile | None) -> None:
    """Print how well the written description predicts, and where it does worse than the given one."""
    if judged is None:
        return
    say(console, "", judged.sentence)
    for sentence in judged.worse:
        say(console, "DOUBTFUL", f"  {sentence}")
    for sentence in judged.limited:
        say(console, "Warning", f"  {sentence}")


def _findings_table(result: GapResult) -> Table:
    table = plain_table("Findings (confident ones are in the written model)", ["effect", "where"])
    table.add_column("parameter", no_wrap=True)
    number_columns(table, ["value"])
    table.add_column("probability", no_wrap=True)
    number_columns(table, ["closes"])
    for finding in result.findings:
        names = lines(name.replace("_", " ") for name in finding.parameters)
        values = lines(map(gap_words.measured, finding.parameters.values()))
        where = gap_words.place(finding.joint, finding.link)
        probability = f"{gap_words.percent(finding.probability):>5}, {finding.confidence}"
        closes = gap_words.percent(finding.share)
        table.add_row(gap_words.headline(finding.effect), where, names, values, probability, closes)
    return table


def _sentences(result: GapResult) -> Iterator[str]:
    """One of each finding, with its rivals where there are any to choose from; of many findings only of these."""
    few = len(result.findings) <= gap_words.MOST_LISTED
    for finding in result.findings:
        rivals = [gap_words.compared(rival) for rival in finding.rivals[: gap_words.MOST_LISTED]]
        ambiguous = finding.confidence == "ambiguous" and rivals
        if few or ambiguous:
            yield f"{finding.sentence}{' Rivals: ' + ', '.join(rivals) + '.' if ambiguous else ''}"


def _channels_table(result: GapResult) -> Table:
    headings = ["\nfloor", "\nnominal", "inertias\nonly", "written\nmodel", "moving\nalone", "moving,\nexpected"]
    title = "Gap on all held-out samples, in units of the noise floor (no model can do better than 1)"
    table = plain_table(title, ["\nchannel"], headings)
    table.add_column(f"gap above the floor, logarithmic\n{_AFTER} after {_INERTIAS} inertias only {_BEFORE} nominal")
    gaps = (result.gap.before, result.gap.inertias_only, result.gap.after)
    end = max(2.0, *(gap_words.worst(values) for values in gaps))
    for k, (name, unit, floor) in enumerate(zip(result.channels, result.units, result.corrected_floor, strict=True)):
        before, inertias, after = (float(values[k]) for values in gaps)
        if math.isfinite(before):
            moving = float(result.moving[k]), float(result.gap.expected[k])
            numbers = (gap_words.ratio(value) for value in (before, inertias, after, *moving))
            table.add_row(name, f"{floor:.2g} {unit}", *numbers, _bar(before, inertias, after, end))
    return table


def _bar(before: float, inertias: float, after: float, end: float) -> str:
    """Three bars in one line, the shortest in front."""
    bars = ((after, _AFTER), (inertias, _INERTIAS), (before, _BEFORE))
    lengths = sorted((_length(value, end), mark) for value, mark in bars)
    return "".join(mark * (length - shorter) for (shorter, _), (length, mark) in pairwise([(0, ""), *lengths]))


def _length(value: float, end: float) -> int:
    return round(_BAR * math.log(max(value, 1.0)) / math.log(end)) if math.isfinite(value) else 0


def _simulated_table(simulation: Resimulated) -> Table:
    how = {"windows": "in short windows", "closed_loop": "in closed loop"}[simulation.kind]
    table = plain_table(f"Resimulation {how}\n(error in units of the noise)", ["channel"], ["before", "after"])
    for name, before in simulation.before.items():
        table.add_row(name, gap_words.ratio(before), gap_words.ratio(simulation.after[name]))
    return table


def _candidates_table(result: GapResult) -> Table:
    table = plain_table("Candidates, best first", ["candidate"], ["score gain", "separable", "chosen"])
    for entry in result.ranking[: gap_words.MOST_CANDIDATES]:
        chosen = "yes" if entry.chosen else ""
        table.add_row(gap_words.title(entry), f"{entry.gain:.1f}", gap_words.percent(entry.separability), chosen)
    return table
