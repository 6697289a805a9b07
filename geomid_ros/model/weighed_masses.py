"""Weighed masses: additional rows of the least-squares problem, with a known error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.options import numbers_in
from geomid_ros.types import FloatArray

TOTAL = "total"  # the whole robot, fixed links included
# No scale is more precise, and a smaller std costs solvers too many steps.
_MOST_PRECISE = 1e-5


@dataclass(frozen=True)
class WeighedMass:
    """``mass`` of ``links`` together, or of the whole robot (``total``), with its standard deviation ``std`` [kg]."""

    links: tuple[str, ...]
    mass: float
    std: float

    @staticmethod
    def parse(text: str) -> WeighedMass:
        """Parse ``total=23.4:0.05`` or ``link1+link2=2.1:0.01``. Raises InputError."""
        names, _, numbers = text.rpartition("=")
        links = tuple(name.strip() for name in names.split("+"))
        each_once = all(links) and len(set(links)) == len(links)
        match numbers_in(numbers, ":"):
            case [mass, std] if each_once and mass > 0.0 and std >= _MOST_PRECISE * mass:
                return WeighedMass(links, mass, std)
        raise InputError(
            f"the weighed mass '{text}' is not of the form LINK=MASS:STD, LINK+LINK=MASS:STD or {TOTAL}=MASS:STD "
            f"with positive numbers in kg, STD not below {_MOST_PRECISE:g} MASS, and every link once"
        )

    @property
    def name(self) -> str:
        """Names of its links."""
        return " + ".join(self.links)


@dataclass(frozen=True, eq=False)
class WeighedRows:
    """``rows (K, D) . parameters = targets (K,)`` with standard deviation 1: first the rows of weighed ``masses``, then
    those of a prior."""

    rows: FloatArray
    targets: FloatArray
    masses: tuple[WeighedMass, ...] = ()

    def plus(self, other: WeighedRows | None) -> WeighedRows:
        """Append prior rows; ``other`` has no masses."""
        if other is None:
            return self
        rows, targets = np.concatenate([self.rows, other.rows]), np.append(self.targets, other.targets)
        return WeighedRows(rows, targets, self.masses)

    @property
    def weighed(self) -> WeighedRows:
        """Rows of the masses only."""
        count = len(self.masses)
        return WeighedRows(self.rows[:count], self.targets[:count], self.masses)


def weighed_rows(model: MeasurementModel, weighed: Sequence[WeighedMass]) -> WeighedRows:
    """Build the rows of weighed masses: sums of the masses of identified bodies.

    The URDF's masses of bodies that are not identified (for ``total`` also of fixed links) are subtracted from the
    targets. Raises InputError if a weighed mass does not fit the model.
    """
    rows = np.zeros((len(weighed), model.dimension))
    targets = np.empty(len(weighed))
    for index, given in enumerate(weighed):
        bodies = _weighed_bodies(model.robot, given)
        columns = [10 * position for position, body in enumerate(model.identified) if body in bodies]
        unknown = given.mass - _known_mass(model, given, bodies)
        if not columns:
            raise InputError(f"the mass of {given.name} is given, but none of these links is identified")
        if unknown <= 0.0:
            raise InputError(
                f"{given.name}: weighed mass {given.mass:g} kg is not above the URDF mass {given.mass - unknown:g} kg "
                "of its links that are not identified"
            )
        rows[index, columns] = 1.0 / given.std
        targets[index] = unknown / given.std
    return WeighedRows(rows, targets, tuple(weighed))


def _weighed_bodies(robot: Robot, given: WeighedMass) -> list[int]:
    if given.links == (TOTAL,):
        return list(range(len(robot.bodies)))
    return [_body(robot, link) for link in given.links]


def _body(robot: Robot, link: str) -> int:
    """Return the body of a link. Refuse a link that is part of another body, or does not move (InputError)."""
    names = robot.body_names
    if link in names:
        return names.index(link)
    if link not in robot.tree.links:
        raise unknown_name("link of a weighed mass", link, (*names, TOTAL))
    carrier = robot.body_of(link)
    if carrier is not None:
        raise InputError(
            f"the mass of link '{link}' is given, but it is fixed to '{carrier}' and identified as one body with it: "
            f"give their total mass as {carrier}=MASS:STD"
        )
    raise InputError(
        f"the mass of link '{link}' is given, but it is not identified: it does not move, or has no mass in the URDF"
    )


def _known_mass(model: MeasurementModel, given: WeighedMass, bodies: Sequence[int]) -> float:
    """Return the URDF's mass [kg] of weighed links that are not identified."""
    if given.links == (TOTAL,):
        return model.unidentified_mass
    return sum(float(model.robot.bodies[body].parameters[0]) for body in bodies if body not in model.identified)
