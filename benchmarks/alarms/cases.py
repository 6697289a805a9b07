"""One case from its seed to what the alarm did."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.alarms.recording import REST, Change, Part, messages
from benchmarks.alarms.watching import TOGETHER, Watched, watched
from benchmarks.blind.case import robot_file
from geomid_ros.errors import InputError
from geomid_ros.simulation import Hidden, SimulationOptions
from geomid_ros.simulation.description import read_description
from geomid_ros.simulation.robots import robot_description

WHATS = ("quiet", "friction", "payload")
"""Nothing changes, friction of a joint grows, a payload comes."""
MASS = 1.0  # [kg]
GROWS = 0.5
RAMP = 5.0  # [s]
BEFORE, AFTER = 120.0, 30.0  # [s]
_KINDS = ("sines", "aperiodic", "points")
_STOP_AND_GO: tuple[Part, ...] = 6 * (("sines", 9.0), (REST, 3.5))
_QUIET: tuple[Part, ...] = 2 * (*((kind, 75.0) for kind in _KINDS), *_STOP_AND_GO)
_ATTEMPTS = 4
_SLOWER = 0.7


@dataclass(frozen=True)
class Case:
    """``what`` happens to a ``robot`` of a ``seed``; ``joint`` whose friction grows, ``kind`` of the motion."""

    what: str
    robot: str
    seed: int
    joint: str = ""
    kind: str = ""

    @property
    def parts(self) -> tuple[Part, ...]:
        """Of the motion."""
        return ((self.kind, BEFORE + RAMP + AFTER),) if self.kind else _QUIET

    @property
    def change(self) -> Change | None:
        """What changes."""
        if self.what == "friction":
            return Change(BEFORE, RAMP, joint=self.joint, grows=GROWS)
        if self.what == "payload":
            return Change(BEFORE, payload=Hidden("payload", self.joint, MASS))
        return None

    @property
    def unchanged(self) -> float:
        """How long nothing changes [s]."""
        return sum(time for _, time in self.parts) if self.change is None else self.change.at

    @property
    def complete(self) -> float:
        """When the change is, or the recording ends [s]."""
        return self.unchanged + (0.0 if self.change is None else self.change.ramp)


@dataclass(frozen=True)
class Alarm:
    """Channel and time since the beginning [s] of a gap that opens."""

    channel: str
    time: float


@dataclass(frozen=True)
class Outcome:
    """``alarms``: all gaps that opened; ``floors``: how many times the floor the widest channel was after the change,
    median; ``watched``: seconds before the change in which it was known of all channels what is normal; ``speed``: of
    the motion, as a share of the usual one."""

    case: Case
    alarms: tuple[Alarm, ...]
    floors: float
    watched: float
    speed: float

    @property
    def false(self) -> tuple[Alarm, ...]:
        """Those while nothing changed."""
        return tuple(alarm for alarm in self.alarms if self.case.change is None or alarm.time < self.case.unchanged)

    @property
    def first(self) -> Alarm | None:
        """The first after the change began."""
        return next((alarm for alarm in self.alarms if alarm not in self.false), None)

    @property
    def seconds(self) -> float:
        """From when the change was complete to the alarm; infinite without one."""
        return np.inf if self.first is None else self.first.time - self.case.complete


def cases(what: str, robot: str, seed: int) -> Iterator[Case]:
    """Those of a robot of one seed; motions take turns. Friction grows at the first, the middle and the last joint."""
    description = read_description(robot_description(robot_file(robot)))
    if what == "quiet":
        yield Case(what, robot, seed)
    elif what == "payload":
        link = [body.name for body in description.inertias if description.moved_by(body.name)][-1]
        yield Case(what, robot, seed, link, _KINDS[seed % len(_KINDS)])
    else:
        joints = [joint.name for joint in description.joints]
        for place, joint in enumerate((joints[0], joints[len(joints) // 2], joints[-1])):
            yield Case(what, robot, seed, joint, _KINDS[(seed + place) % len(_KINDS)])


def outcome(case: Case) -> Outcome:
    """Record and watch. Motions that the drives cannot follow are tried again, slower."""
    robot = robot_file(case.robot)
    options = SimulationOptions(
        robot=robot,
        seed=case.seed,
        motion_seed=300_000 + case.seed,
        realistic=True,
        duration=sum(time for _, time in case.parts),
        rate=125.0,
        hide=(),
        longest_step=1e-3,
    )
    speed = options.motion_speed
    for _ in range(_ATTEMPTS):
        try:
            recorded = list(messages(options, case.parts, case.change))
            break
        except InputError:
            options = replace(options, motion_speed=_SLOWER * options.motion_speed)
    else:
        raise InputError(f"{case.robot}, seed {case.seed}: its drives are too weak")
    seen = list(watched(robot_description(robot), recorded))
    return Outcome(
        case,
        tuple(_alarms(seen)),
        _floors(seen, case.complete),
        _known(seen, case.unchanged),
        options.motion_speed / speed,
    )


def _alarms(seen: list[Watched]) -> Iterator[Alarm]:
    known: set[str] = set()
    for state in seen:
        now = {gap.channel for gap in state.gaps if gap.since is not None}
        yield from (Alarm(channel, state.time) for channel in sorted(now - known))
        known = now


def _floors(seen: list[Watched], begin: float) -> float:
    widest = [max((gap.times_floor for gap in state.gaps), default=np.nan) for state in seen if state.time > begin]
    return float(np.nanmedian(widest)) if widest else np.nan


def _known(seen: list[Watched], end: float) -> float:
    most = max(len(state.gaps) for state in seen)
    return TOGETHER * sum(most == len(state.gaps) > 0 and state.time <= end for state in seen)
