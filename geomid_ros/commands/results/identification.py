"""Links, effects and channels of an identification, as tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.table import Table

from geomid_ros.api.identify import Identification
from geomid_ros.checks.verdict import USABLE
from geomid_ros.commands.terminal import lines, number_columns, plain_table, print_verdict, results_console, say
from geomid_ros.estimation.estimate import QUANTITIES, EffectEstimate, Estimate
from geomid_ros.files.models.effect_forms import is_coefficient
from geomid_ros.files.models.estimate_file import model_effects
from geomid_ros.model.effects import EFFECTS, KnownEffect
from geomid_ros.report import gap_words, identification_words
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
    """Print links, effects and how well each channel is predicted, on held-out data where there are any."""
    console = results_console()
    estimate = found.estimate
    state = "converged" if estimate.converged else f"NOT converged ({estimate.reason})"
    print_verdict(console, found.verdict, found.warnings, found.session.notes)
    _print_messages(console, found.session.pipeline.ledger.topics)
    console.print(
        f"{estimate.rows_accepted} rows, {state} in {estimate.seconds:.1f} s, prior weight {estimate.gamma:.1e}",
    )
    console.print("In the tables ± is one standard deviation.")
    console.print(_links_table(found))
    if found.verdict.word == USABLE:
        say(console, "", " ".join(identification_words.identified(found.links)))
    if estimate.known:
        console.print(_known_table(estimate))
    of_joints = _at_every_joint(estimate.effects)
    if of_joints:
        console.print(_joint_effects_table(of_joints))
    said = {(effect.name, effect.joint) for effect in of_joints}
    every = model_effects(estimate, found.session.loaded.effects)
    others = [e for e in every if (e.effect, e.joint) not in said or not is_coefficient(e)]
    if others:
        console.print(_other_effects_table(others))
    console.print(_channels_table(found))
    if found.tracking is not None:
        say(console, "Closed loop:", f" {_tracking(found.tracking, found.written.name)}")


def _tracking(tracking: Tracking, name: str) -> str:
    if tracking.skipped:
        return f"not simulated: {tracking.skipped}"
    worst = max(tracking.rms, key=lambda joint: tracking.rms[joint])
    return (
        f"simulated under the recorded commands, {name} deviates from the measured positions by {tracking.total:.4f} "
        f"rad (m), RMS of {len(tracking.rms)} joints; the largest is '{worst}', {tracking.rms[worst]:.4f}"
    )


def _links_table(found: Identification) -> Table:
    """Mass, centre of mass, their standard deviations and where they came from."""
    model = found.session.model
    nominal = dict(zip(model.body_names, model.nominal_inertias.reshape(-1, 10)[:, 0], strict=True))
    table = plain_table("Links")
    table.add_column("\nlink", overflow="fold", min_width=14)
    headings = ("mass [kg]\nURDF", "\nidentified", "centre of\nmass [m]", "from\ndata", "dist. to\nprior")
    number_columns(table, headings)
    table.add_column("not\nidentified", min_width=10)
    for link in found.links:
        names = lines([link.name, *(f"+ {name}" for name in link.merged)])
        masses = f"{nominal[link.name]:.3f}", f"{link.mass:.3f} ± {link.std_mass:.3f}"
        com = lines(f"{c:+.3f} ± {s:.3f}" for c, s in zip(link.com, link.std_com, strict=True))
        shares = f"{100 * link.from_data:.0f} %", f"{link.distance_from_prior:.2f}"
        untold = [name for name in QUANTITIES if name not in link.identified]
        table.add_row(names, *masses, com, *shares, identification_words.cannot_tell(untold))
    return table


def _known_table(estimate: Estimate) -> Table:
    table = plain_table("Weighed masses", ["what"], ["weighed [kg]", "identified [kg]", "difference [std weighed]"])
    for known in estimate.known:
        table.add_row(
            known.name,
            f"{known.given:.3f} ± {known.given_std:.3f}",
            f"{known.mass:.3f} ± {known.std:.3f}",
            f"{(known.mass - known.given) / known.given_std:+.1f}",
        )
    return table


def _at_every_joint(effects: Sequence[EffectEstimate]) -> list[EffectEstimate]:
    """The effects that most joints have, for a table with a row for each joint."""
    of_joints = [effect for effect in effects if EFFECTS[effect.name].place == "joint"]
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


def _channels_table(found: Identification) -> Table:
    """RMS per channel of the URDF, of the estimate, and of the written file alone and with the offsets beside it."""
    file, judged_on = found.handover, "held-out data" if found.held_out else "the same data"
    headings = ["unit", "URDF", "identified", "explained", f"{file.name}\nalone", "with sensor\noffsets"]
    table = plain_table(f"RMS of the residual on {judged_on}", ["channel"], headings)
    for channel in found.session.model.channels:
        before, now = found.rms_nominal[channel.name], found.rms[channel.name]
        if np.isfinite(now):
            share = f"{100.0 * (1.0 - now / before):.0f} %" if before > 0 else ""
            written = file.alone[channel.name], file.corrected[channel.name]
            table.add_row(channel.name, channel.unit, *map(_digits, (before, now)), share, *map(_digits, written))
    return table


def _digits(value: float) -> str:
    return f"{value:.3g}"
