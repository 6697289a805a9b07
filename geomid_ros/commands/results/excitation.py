"""A designed motion: its margins and what it is expected to teach, as tables."""

from __future__ import annotations

import numpy as np
from rich.table import Table

from geomid_ros.commands.terminal import plain_table, results_console, say
from geomid_ros.report import gap_words
from geomid_ros.session.excitation import Excitation

_MOTIONS = ("before", "designed", "random", "designed,\ntwice")


def show(found: Excitation) -> None:
    """Print notes, margins and expected standard deviations."""
    console = results_console()
    for note in found.task.notes:
        say(console, "Note:", f" {note}")
    form = found.motion.form
    console.print(f"{form.repeats} x {form.period:g} s = {form.duration:g} s")
    console.print(_margins(found))
    if found.closest:
        say(console, "Smallest distance:", f" {found.closest}")
    console.print(_links(found))
    if found.task.knowledge.posterior.effects:
        console.print(_effects(found))
    for decision in found.decisions:
        say(console, "Discriminates:" if decision.is_sure else "Does not discriminate:", f" {decision.sentence}")
    say(console, "Expected error", f" {found.error}:")
    for sentence in found.learning.sentences:
        say(console, "", f"- {sentence}")


def _margins(found: Excitation) -> Table:
    headings = ["lowest", "highest", "to limit", "speed", "acceleration", "jerk", "effort with margin"]
    table = plain_table("Use of each limit", ["joint"], headings)
    margins, positions = found.margins, found.trajectory.positions
    for index, name in enumerate(found.task.feasibility.names):
        used = (margins.velocity, margins.acceleration, margins.jerk, margins.effort)
        ends = np.min(positions[:, index]), np.max(positions[:, index]), margins.position[index]
        numbers = (*(f"{end:.3f}" for end in ends), *(gap_words.percent(share[index]) for share in used))
        table.add_row(name, *numbers)
    return table


def _links(found: Excitation) -> Table:
    learning = found.learning
    table = plain_table("Standard deviation of the mass [kg]", ["link"], ["mass", *_MOTIONS])
    masses = found.task.knowledge.posterior.parameters
    for index, name in enumerate(found.task.knowledge.posterior.links):
        kinds = (learning.before, learning.designed, learning.random, learning.twice)
        table.add_row(name, f"{masses[10 * index]:.3f}", *(f"{kind.links[index, 0]:.2g}" for kind in kinds))
    return table


def _effects(found: Excitation) -> Table:
    learning = found.learning
    table = plain_table("Standard deviation of the effects", ["effect", "at"], _MOTIONS)
    table.add_column("unit")
    for index, effect in enumerate(found.task.knowledge.posterior.effects):
        kinds = (learning.before, learning.designed, learning.random, learning.twice)
        table.add_row(
            gap_words.headline(effect.name),
            effect.place,
            *(f"{kind.effects[index]:.2g}" for kind in kinds),
            effect.unit,
        )
    return table
