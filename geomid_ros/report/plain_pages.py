"""Pages that are tables: ``compare.html``, two results of one robot side by side, and ``fleet.html``, many robots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from geomid_ros.estimation.comparison import Compared, Difference
from geomid_ros.estimation.uncertain_inertia import SURE
from geomid_ros.model.effects import Quantity
from geomid_ros.report import gap_words
from geomid_ros.report.page import write_page


@dataclass(frozen=True, kw_only=True)
class ChannelErrors:
    """RMS of what two results leave unexplained of a channel, in its ``unit``; NaN where one says nothing of it."""

    name: str
    unit: str
    first: float
    second: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparisonPage:
    """What the page is made of: the files ``first`` and ``second``, what was ``compared``, the ``errors`` of both by
    channel and what they are ``judged_on``, ``doubts`` and ``notes``."""

    first: str
    second: str
    compared: Compared
    errors: Sequence[ChannelErrors]
    judged_on: str
    doubts: Sequence[str]
    notes: Sequence[str]


def write_comparison_page(path: Path, page: ComparisonPage) -> None:
    """Write the page.

    Raises:
        GeomidError: the file cannot be written.
    """
    content = {
        "page": page,
        "verdict": verdict(page.compared),
        "sure": SURE,
        "differing": [row(each) for each in page.compared.differing],
        "all": [row(each) for each in page.compared.differences],
        "errors": [(e.name, e.unit, error(e.first), error(e.second)) for e in page.errors],
    }
    write_page(path, "comparison.html.j2", content)


def verdict(found: Compared) -> str:
    """Whether the results differ, in a sentence."""
    links = [link.sentence for link in found.changed]
    numbers = len(found.differing)
    parts = [*links, *([f"{numbers} number{'s' * (numbers > 1)} beyond the joint 95 % intervals"] if numbers else [])]
    return f"The results differ: {'; '.join(parts)}." if parts else "Nothing differs beyond the joint 95 % intervals."


def row(difference: Difference) -> tuple[str, str, str, str, str]:
    """Place, name, both values with their 95 % intervals, and the difference with its joint one."""
    name = gap_words.headline(difference.effect) + (" " if difference.effect else "") + difference.parameter
    change = Quantity(difference.value, difference.half_width, difference.unit)
    apart = gap_words.measured(change) if math.isfinite(difference.value) else ""
    before, after = _value(difference.first), _value(difference.second)
    return difference.place or "the whole robot", name.replace("_", " "), before, after, apart


def _value(quantity: Quantity | None) -> str:
    if quantity is None:
        return "none"
    return gap_words.measured(Quantity(quantity.value, SURE * quantity.std, quantity.unit))


def error(value: float) -> str:
    """An error, empty where it is not known."""
    return f"{value:.3g}" if math.isfinite(value) else ""


@dataclass(frozen=True, kw_only=True)
class RobotLine:
    """What the page says of a robot.

    Attributes:
        name: the robot's.
        bags, used: how many bags it has, and how many its estimate is from.
        verdict, reasons: of its estimate, or why there is none.
        unlike: in what it is unlike the others, in words.
        distance: from the others, in standard deviations; None where there are no others to compare with.
        changed: what has changed since an earlier run, in words.
        mass: of all links [kg].
    """

    name: str
    bags: int
    used: int
    verdict: str
    reasons: tuple[str, ...] = ()
    unlike: tuple[str, ...] = ()
    distance: float | None = None
    changed: tuple[str, ...] = ()
    mass: float | None = None

    @property
    def remarkable(self) -> tuple[bool, int, int, float]:
        """What robots are ordered by: without a usable result, unlike the others, changed."""
        return self.verdict != "usable", len(self.unlike), len(self.changed), self.distance or 0.0


@dataclass(frozen=True, kw_only=True)
class FleetPage:
    """What the page is made of: the robots, the most remarkable first, bags that could not be used, and such that
    something seems to be wrong with, each with why."""

    lines: Sequence[RobotLine]
    bad: Sequence[tuple[str, str]]
    doubtful: Sequence[tuple[str, str]]


def write_fleet_page(path: Path, page: FleetPage) -> None:
    """Write the page.

    Raises:
        GeomidError: the file cannot be written.
    """
    counts = {
        "differ from the others": sum(bool(line.unlike) for line in page.lines),
        "changed": sum(bool(line.changed) for line in page.lines),
        "not usable": sum(line.verdict != "usable" for line in page.lines),
        "bags that could not be read": len(page.bad),
    }
    write_page(path, "fleet.html.j2", {"page": page, "counts": counts})
