"""Short bags of a fleet: pieces of the shipped recordings."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from files.recordings import BAGS, Recorded, recorded, write_bag

URDF = BAGS / "arm3.urdf"
SECONDS = 4.5


@cache
def messages(robot: str) -> tuple[Recorded, ...]:
    """Those of a shipped bag."""
    return tuple(recorded(BAGS / robot))


def piece(folder: Path, begin: float, robot: str = "arm3", seconds: float = SECONDS) -> Path:
    """A bag of so many seconds of a shipped recording, from ``begin`` [s] on."""
    start = messages(robot)[0].time + 1e9 * begin
    folder.parent.mkdir(parents=True, exist_ok=True)
    return write_bag(folder, (m for m in messages(robot) if start <= m.time < start + 1e9 * seconds))


def without_efforts(folder: Path) -> Path:
    """A bag in which no effort is measured."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    end = messages("arm3")[0].time + 1e9 * SECONDS
    bare = (m.changed(effort=m.message.effort[:0]) if m.topic == "/joint_states" else m for m in messages("arm3"))
    return write_bag(folder, (m for m in bare if m.time < end))


def torn(folder: Path) -> Path:
    """A bag that ends in its first record."""
    bag = piece(folder, 0.0)
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:2000])
    return bag
