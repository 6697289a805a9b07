"""Links, effects and channels of an identification, as tables."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from geomid_ros.api.identify import Identification
from geomid_ros.checks.verdict import USABLE
from geomid_ros.commands.terminal import lines, number_columns, plain_table, print_verdict, results_console, say
from geomid_ros.estimation.estimate import EffectEstimate, LinkEstimate, WeighedEstimate
from geomid_ros.estimation.uncertain_inertia import QUANTITIES
from geomid_ros.files.models.effects_file import is_coefficient
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.model.effects import EFFECTS, KnownEffect
from geomid_ros.report import gap_words, result_pages
from geomid_ros.signals.ledger import Account

if TYPE_CHECKING:
    from geomid_ros.resimulation.closed_loop import Tracking

_MOST_REASONS = 5


def _print_messages(console: Console, topics: Mapping[str, Account]) -> None:
    """Print of each topic how many messages were used, and why others were not."""
    for topic, account in topics.items():
        refused = account.rejected + account.dropped
        reasons = "".join(f"; {count} {reason}" for reason, count in refused.most_common(_MOST_REASONS))
        noted = "".join(f"; noted: {remark} ({count})" for remark, count in account.noted.most_common(_MOST_REASONS))
        say(console, "", f"{topic}: {account.accepted} of {account.received} messages used{reasons}{noted}")


def show(found: Identification) -> None:
    """Print links, effects and how well each channel is predicted, as estimate.json has them."""
    console, file = results_console(), EstimateFile.of(found.document, "estimate.json")
    links = file.link_estimates
    state = "converged" if file.converged else f"NOT converged ({file.reason})"
    print_verdict(console, file.judgement, file.warnings, file.notes)
    _print_messages(console, file.messages)
    console.print(f"{file.rows.accepted} rows, {state} in {file.seconds:.1f} s, prior weight {file.gamma:.1e}")
    console.print("In the tables ± is one standard deviation.")
    console.print(_links_table(file, links))
    if file.judgement.word == USABLE:
        say(console, "", " ".join(result_pages.identified(links)))
    if file.known:
        console.print(_known_table(file.known))
    of_joints = _at_every_joint(file.effect_estimates)
    if of_joints:
        console.print(_joint_effects_table(of_joints))
    said = {(effect.name, effect.joint) for effect in of_joints}
    others = [e for e in file.known_effects if (e.effect, e.joint) not in said or not is_coefficient(e)]
    if others:
        console.print(_other_effects_table(others))
    console.print(_channels_table(file))
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
    """Mass, centre of mass, their standard deviations and where they came from."""
    table = plain_table("Links")
    table.add_column("\nlink", overflow="fold", min_width=14)
    headings = ("mass [kg]\nURDF", "\nidentified", "centre of\nmass [m]", "from\ndata", "dist. to\nprior")
    number_columns(table, headings)
    table.add_column("not\nidentified", min_width=10)
    for link in links:
        names = lines([link.name, *(f"+ {name}" for name in link.merged)])
        masses = f"{file.urdf_masses[link.name]:.3f}", f"{link.mass:.3f} ± {link.std_mass:.3f}"
        com = lines(f"{c:+.3f} ± {s:.3f}" for c, s in zip(link.com, link.std_com, strict=True))
        shares = f"{100 * link.from_data:.0f} %", f"{link.distance_from_prior:.2f}"
        untold = [name for name in QUANTITIES if name not in link.identified]
        table.add_row(names, *masses, com, *shares, result_pages.cannot_tell(untold))
    return table


def _known_table(weighed: Sequence[WeighedEstimate]) -> Table:
    table = plain_table("Weighed masses", ["what"], ["weighed [kg]", "identified [kg]", "difference [std weighed]"])
    for known in weighed:
        table.add_row(
            known.name,
            f"{known.given:.3f} ± {known.given_std:.3f}",
            f"{known.mass:.3f} ± {known.std:.3f}",
            f"{(known.mass - known.given) / known.given_std:+.1f}",
        )
    return table


def _at_every_joint(effects: Sequence[EffectEstimate]) -> list[EffectEstimate]:
    """The effects of one number that most joints have, for a table with a row for each joint."""
    kinds = {name: EFFECTS[name] for name in {effect.name for effect in effects}}
    of_joints = [e for e in effects if kinds[e.name].place == "joint" and kinds[e.name].is_one_number()]
    joints, counts = {effect.joint for effect in of_joints}, Counter(effect.name for effect in of_joints)
    return [effect for effect in of_joints if 2 * counts[effect.name] > len(joints)]


def _other_effects_table(effects: Sequence[KnownEffect]) -> Table:
    """Those of several parameters, those at other places, and those that hold as the model says them."""
    table = plain_table("Other effects", ["effect", "where", "parameter"], ["value"])
    for effect in effects:
        names = lines(name.replace("_", " ") for name in effect.parameters)
        values = lines(map(gap_words.measured, effect.parameters.values()))
        table.add_row(gap_words.headline(effect.effect), gap_words.place(effect.joint), names, values)
    return table


def _joint_effects_table(effects: Sequence[EffectEstimate]) -> Table:
    """An empty cell where a joint does not have an effect that others have, or has it with the usual constant."""
    joints = list(dict.fromkeys(effect.joint for effect in effects))
    columns: dict[str, dict[str, str]] = {}
    for effect in effects:
        (_, own), *constants = effect.parameters.items()
        first, _, second = effect.name.partition("_")
        columns.setdefault(f"{first}\n{second}\n[{own.unit}]", {})[effect.joint] = f"{own.value:.3g} ± {own.std:.1g}"
        for name, constant in constants:
            columns.setdefault(f"{first}\n{name}\n[{constant.unit}]", {})[effect.joint] = f"{constant.value:g}"
    table = plain_table("Joint effects", ["joint"], list(columns))
    for joint in joints:
        table.add_row(joint, *(cells.get(joint, "") for cells in columns.values()))
    return table


def _channels_table(file: EstimateFile) -> Table:
    """RMS per channel of the URDF, of the estimate, and of the written file alone and with the offsets beside it."""
    headings = ["unit", "URDF", "identified", "explained", f"{file.description}\nalone", "with sensor\noffsets"]
    table = plain_table(f"RMS of the residual on {file.judged_on}", ["channel"], headings)
    for row in file.channels:
        share = f"{100.0 * (1.0 - row.ratio):.0f} %" if math.isfinite(row.ratio) else ""
        errors = [f"{error:.3g}" for error in (row.urdf, row.identified, row.file, row.file_with_offsets)]
        table.add_row(row.channel, row.unit, *errors[:2], share, *errors[2:])
    return table
