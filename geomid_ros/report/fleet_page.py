"""``fleet.html``: the robots of a fleet beside each other, and the bags that could not be used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from geomid_ros.report.page import write_page


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
