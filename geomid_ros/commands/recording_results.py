"""Tables of results from recordings: an identification, a gap, a fleet."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

import geomid_ros
from geomid_ros.checks.verdict import DOUBTFUL, USABLE, recording_verdict
from geomid_ros.commands.terminal import lines, plain_table, print_remarks, print_verdict, results_console, say
from geomid_ros.estimation.estimate import EffectEstimate, LinkEstimate, WeighedEstimate
from geomid_ros.exports.handover import FileTest
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.gap.result import GapResult
from geomid_ros.model.effects import EFFECTS, KnownEffect
from geomid_ros.report import gap_words, result_pages
from geomid_ros.resimulation.resimulate import Resimulated
from geomid_ros.signals.ledger import Account

if TYPE_CHECKING:
    from geomid_ros.resimulation.resimulate import Tracking


def _print_messages(console: Console, topics: Mapping[str, Account], said: Collection[str]) -> None:
    """Print for each topic how many messages were used, why others were not, and remarks that are not yet ``said``."""
    for topic, account in topics.items():
        refused = account.rejected + account.dropped
        reasons = "".join(f"; {count} {reason}" for reason, count in refused.most_common())
        remarks = [(text, count) for text, count in account.noted.most_common() if f"{topic}: {text}" not in said]
        noted = "".join(f"; noted: {text} ({count})" for text, count in remarks)
        say(console, "", f"{topic}: {account.accepted} of {account.received} messages used{reasons}{noted}")


def show_identification(found: geomid_ros.Identification) -> None:
    """Print links, effects and the prediction error of each channel, as in estimate.json."""
    console, file = results_console(), EstimateFile.of(found.document, "estimate.json")
    links = file.link_estimates
    state = "converged" if file.converged else f"NOT converged ({file.reason})"
    if file.judgement.word == USABLE:
        say(console, USABLE.upper(), f"  {' '.join(result_pages.uses(file))}")
    print_verdict(console, file.judgement, file.warnings, file.notes)
    _print_messages(console, file.messages, {*file.judgement.reasons, *file.warnings, *file.notes})
    console.print(f"{file.rows.accepted} rows, {state} in {file.seconds:.1f} s, prior weight {file.gamma:.1e}")
    console.print("In the tables ± is one standard deviation.")
    console.print(_links_table(file, links))
    if file.known:
        console.print(_known_table(file.known))
    for table in _effects_tables(file.effect_estimates, file.known_effects):
        console.print(table)
    console.print(_errors_table(file))
    if found.tracking is not None:
        say(console, "Closed loop:", f" {_tracking(found.tracking, file.description)}")


def _tracking(tracking: Tracking, name: str) -> str:
    if tracking.skipped:
        return f"not simulated: {tracking.skipped}"
    worst = max(tracking.rms, key=lambda joint: tracking.rms[joint])
    return (
        f"simulated under the recorded commands, {name} deviates from the measured positions by {tracking.total:.4f} "
        f"rad (m), RMS of {len(tracking.rms)} joints; the largest is '{worst}', {tracking.rms[worst]:.4f}"
    )


def _links_table(file: EstimateFile, links: Sequence[LinkEstimate]) -> Table:
    """Table of mass, centre of mass, their standard deviations and their source: data or prior."""
    headings = ["mass [kg]\nURDF", "\nidentified", "centre of\nmass [m]", "from\ndata", "dist. to\nprior"]
    table = plain_table("Links", ["\nlink"], headings, ["not\nidentified"])
    for link in links:
        names = lines([link.name, *(f"+ {name}" for name in link.merged)])
        masses = f"{file.urdf_masses[link.name]:.3f}", f"{link.mass:.3f} ± {link.std_mass:.3f}"
        com = lines(f"{c:+.3f} ± {s:.3f}" for c, s in zip(link.com, link.std_com, strict=True))
        shares = f"{100 * link.from_data:.0f} %", f"{link.distance_from_prior:.2f}"
        table.add_row(names, *masses, com, *shares, result_pages.not_identified(link))
    return table


def _known_table(weighed: Sequence[WeighedEstimate]) -> Table:
    table = plain_table("Weighed masses", ["what"], ["weighed [kg]", "identified [kg]", "difference [std weighed]"])
    for body in weighed:
        table.add_row(
            body.name,
            f"{body.given:.3f} ± {body.given_std:.3f}",
            f"{body.mass:.3f} ± {body.std:.3f}",
            f"{(body.mass - body.given) / body.given_std:+.1f}",
        )
    return table


def _effects_tables(
    effects: Sequence[EffectEstimate], known: Sequence[KnownEffect], where: str = ""
) -> Iterator[Table]:
    """Yield tables of the ``effects`` that most joints have, and of all others that are ``known``; ``where`` they are
    written, for the titles."""
    of_joints = _at_every_joint(effects)
    if of_joints:
        yield _joint_effects_table(of_joints, f"Joint effects{where}")
    listed = {(effect.name, effect.joint) for effect in of_joints}
    others = [effect for effect in known if (effect.effect, effect.joint) not in listed]
    if others:
        yield _other_effects_table(others, f"Other effects{where}")


def _at_every_joint(effects: Sequence[EffectEstimate]) -> list[EffectEstimate]:
    """Select the effects with one coefficient that most joints have, for a table with a row for each joint."""
    kinds = {name: EFFECTS[name] for name in {effect.name for effect in effects}}
    of_joints = [e for e in effects if kinds[e.name].place == "joint" and kinds[e.name].is_one_number()]
    joints, counts = {effect.joint for effect in of_joints}, Counter(effect.name for effect in of_joints)
    return [effect for effect in of_joints if 2 * counts[effect.name] > len(joints)]


def _other_effects_table(effects: Sequence[KnownEffect], title: str) -> Table:
    """Table of effects with several parameters, at other places, or fixed by the model."""
    table = plain_table(title, ["effect", "where", "parameter"], ["value"])
    for effect in effects:
        names = lines(name.replace("_", " ") for name in effect.parameters)
        values = lines(map(gap_words.measured, effect.parameters.values()))
        table.add_row(gap_words.headline(effect.effect), gap_words.place(effect.joint, effect.link), names, values)
    return table


def _joint_effects_table(effects: Sequence[EffectEstimate], title: str) -> Table:
    """Table of joint effects. A cell is empty if the joint has no such effect, or has it with the default constant.
    Values that are not from the data are marked."""
    joints = list(dict.fromkeys(effect.joint for effect in effects))
    columns: dict[str, dict[str, str]] = {}
    for effect in effects:
        (_, size), *constants = effect.parameters.items()
        first, _, second = effect.name.partition("_")
        cells = columns.setdefault(f"{first}\n{second}\n[{size.unit}]", {})
        weak = "*" * (effect.from_data < result_pages.WEAK)
        cells[effect.joint] = f"{gap_words.measured(replace(size, unit='')).rstrip()}{weak}"
        for name, constant in constants:
            columns.setdefault(f"{first}\n{name}\n[{constant.unit}]", {})[effect.joint] = f"{constant.value:g}"
    title += " (*: mostly from the prior)" * any(e.from_data < result_pages.WEAK for e in effects)
    table = plain_table(title, ["joint"], list(columns))
    for joint in joints:
        table.add_row(joint, *(cells.get(joint, "") for cells in columns.values()))
    return table


def _errors_table(file: EstimateFile) -> Table:
    """Table of residual RMS per channel: URDF, estimate, written file alone, and file with sensor offsets."""
    headings = ["unit", "URDF", "identified", "remains", f"{file.description}\nalone", "with sensor\noffsets"]
    table = plain_table(f"RMS of the residual on {file.judged_on}", ["channel"], headings)
    for row in file.channels:
        errors = [f"{error:.3g}" for error in (row.urdf, row.identified, row.file, row.file_with_offsets)]
        table.add_row(row.channel, row.unit, *errors[:2], gap_words.percent(row.ratio), *errors[2:])
    return table


_BAR = 24  # characters
_AFTER, _INERTIAS, _BEFORE = "█", "▓", "░"


def show_gap(found: geomid_ros.Gap) -> None:
    """Print the verdict, the findings, the gap of every channel, candidates, and what to record next."""
    console = results_console()
    result, review = found.result, found.session.review
    print_verdict(console, recording_verdict(review.findings), review.warnings(), found.session.notes)
    say(console, result.verdict.upper(), f"  {gap_words.verdict_sentence(result)}")
    for sentence in gap_words.summary(result):
        say(console, "", sentence)
    if result.findings:
        console.print(_findings_table(result))
    for sentence in _sentences(result):
        say(console, "", sentence)
    console.print(*_ordinary_tables(result), _gaps_table(result), sep="")
    if found.handover is not None:
        _print_file(console, found.handover)
    for simulation in found.simulated:
        console.print(_simulated_table(simulation))
    if found.not_simulated:
        say(console, "No resimulation", f"  {found.not_simulated}")
    if result.ranking and result.verdict != "no gap":
        console.print(_candidates_table(result))
    record = gap_words.next_recordings(result)
    if record:
        say(console, "Next recording", "")
        for motion in record:
            say(console, "", f"- {motion}")


def _ordinary_tables(result: GapResult) -> Iterator[Table]:
    """Tables of the effects of a model that is written from a URDF, in the order of the joints."""
    places = {name: place for place, name in enumerate(result.channels)}
    ordinary = sorted(result.ordinary, key=lambda effect: places.get(effect.joint, len(places)))
    effects = [
        EffectEstimate(name=effect.effect, joint=effect.joint, parameters=effect.parameters, from_data=1.0)
        for effect in ordinary
    ]
    return _effects_tables(effects, ordinary, " of the written model (sure ones, and those of identify)")


def _print_file(console: Console, file: FileTest) -> None:
    """Print the prediction error of the written description, where the given one is better, and what it lacks."""
    say(console, "", file.sentence)
    notes = filter(None, [file.note])
    print_remarks(console, {DOUBTFUL.upper(): file.worse, "Warning": file.limited, "Note": notes})


def _findings_table(result: GapResult) -> Table:
    title = "Findings (sure ones are in the written model; ± is one standard deviation)"
    table = plain_table(title, ["effect", "where"])
    for heading, is_number in (("parameter", False), ("value", True), ("probability", False), ("closes", True)):
        table.add_column(heading, justify="right" if is_number else "left", no_wrap=True)
    for finding in result.findings:
        names = lines(name.replace("_", " ") for name in finding.parameters)
        values = lines(map(gap_words.measured, finding.parameters.values()))
        where = gap_words.place(finding.joint, finding.link)
        probability = f"{gap_words.percent(finding.probability):>5}, {gap_words.CONFIDENCE[finding.confidence][0]}"
        closes = gap_words.percent(finding.share)
        table.add_row(gap_words.headline(finding.effect), where, names, values, probability, closes)
    return table


def _sentences(result: GapResult) -> Iterator[str]:
    """Yield a sentence with the rivals of each ambiguous finding."""
    for finding in result.findings:
        rivals = [gap_words.compared(rival) for rival in finding.rivals[: gap_words.MOST_LISTED]]
        if finding.confidence == "ambiguous" and rivals:
            yield f"{finding.sentence} Rivals: {', '.join(rivals)}."


def _gaps_table(result: GapResult) -> Table:
    headings = ["\nfloor", "\nnominal", "inertias\nonly", "written\nmodel", "moving\nalone", "moving,\nexpected"]
    title = "Gap on all held-out samples, in units of the noise floor (no model can do better than 1)"
    bars = f"gap above the floor, logarithmic\n{_AFTER} after {_INERTIAS} inertias only {_BEFORE} nominal"
    table = plain_table(title, ["\nchannel"], headings, [bars])
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
    """Draw three bars in one line, the shortest in front."""
    bars = ((after, _AFTER), (inertias, _INERTIAS), (before, _BEFORE))
    lengths = sorted((_length(value, end), mark) for value, mark in bars)
    return "".join(mark * (length - shorter) for (shorter, _), (length, mark) in pairwise([(0, ""), *lengths]))


def _length(value: float, end: float) -> int:
    return round(_BAR * math.log(max(value, 1.0)) / math.log(end)) if math.isfinite(value) else 0


def _simulated_table(simulation: Resimulated) -> Table:
    mode = {"windows": "in short windows", "closed_loop": "in closed loop"}[simulation.kind]
    table = plain_table(f"Resimulation {mode} (error in units of the noise)", ["channel"], ["before", "after"])
    for name, before in simulation.before.items():
        table.add_row(name, gap_words.ratio(before), gap_words.ratio(simulation.after[name]))
    return table


def _candidates_table(result: GapResult) -> Table:
    table = plain_table("Candidates, best first", ["candidate"], ["score gain", "separable", "chosen"])
    for entry in result.ranking[: gap_words.MOST_CANDIDATES]:
        chosen = "yes" if entry.chosen else ""
        table.add_row(gap_words.title(entry), f"{entry.gain:.1f}", gap_words.percent(entry.separability), chosen)
    return table


def show_fleet(found: geomid_ros.FleetIdentification) -> None:
    """Print a table of the robots, and the bad and doubtful bags."""
    console = results_console()
    remarks = ["verdict", "differs from the others", "changed"]
    table = plain_table(f"{len(found.lines)} robots", ["robot"], ["bags", "links [kg]", "distance"], remarks)
    for line in found.lines:
        numbers = ("" if number is None else f"{number:.2f}" for number in (line.mass, line.distance))
        words = line.verdict, lines(line.unlike), lines(line.changed)
        table.add_row(line.name, f"{line.used} of {line.bags}", *numbers, *words)
    console.print(table)
    for line in found.lines:
        print_remarks(console, {line.name: line.reasons})
    print_remarks(
        console,
        {
            "Bad bag": [why if bag in why else f"{bag}: {why}" for bag, why in found.bad],
            "Doubtful bag": [f"{bag}: {reason}" for bag, reason in found.doubtful],
        },
    )
    console.print(f"\nWritten: {', '.join(map(str, found.files))}")
