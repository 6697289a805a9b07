"""One case from its seed to what the alarm did."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.alarms.recording import REST, Change, Part, messages
from benchmarks.alarms.watching import TOGETHER, Watched, watched
from benchmarks.blind.realistic.case import ROBOTS as REALISTIC
from benchmarks.feedforward import described
from geomid_ros.errors import InputError
from geomid_ros.simulation.bag import START
from geomid_ros.simulation.description import read_description, robot_description
from geomid_ros.simulation.options import Hidden, SimulationOptions

ROBOTS = ("panda.urdf", *REALISTIC)
WHATS = ("quiet", "place", "friction", "payload")
"""Nothing changes, in all kinds of motion or in pick and place; friction of a joint grows; a payload comes and goes."""
MASS = 1.5  # [kg]
PAYLOAD = "payload"
"""What names an alarm that is a payload's; the others are channels' gaps."""
GROWS = 0.5
RAMP = 5.0  # [s]
BEFORE, AFTER, DOWN = 120.0, 30.0, 18.0  # [s]
SETTLED = 3.0
"""[s] after the alarm, when the payload's mass is looked at."""
_PLACE = "pick and place"
_KINDS = ("sines", "aperiodic", "points")
_STOP_AND_GO: tuple[Part, ...] = 6 * (("sines", 9.0), (REST, 3.5))
_PICK_AND_PLACE: tuple[Part, ...] = (("points", 9.0), (REST, 3.0))
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
        if self.what == "place":
            return 50 * _PICK_AND_PLACE
        if self.kind == _PLACE:
            return 14 * _PICK_AND_PLACE
        down = DOWN if self.what == PAYLOAD else RAMP
        return ((self.kind, BEFORE + AFTER + down),) if self.kind else _QUIET

    @property
    def change(self) -> Change | None:
        """What changes."""
        if self.what == "friction":
            return Change(BEFORE, RAMP, joint=self.joint, grows=GROWS)
        if self.what == PAYLOAD:
            return Change(BEFORE, payload=Hidden(PAYLOAD, self.joint, MASS), until=BEFORE + AFTER)
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
    """Channel, or :data:`PAYLOAD`, and time since the beginning [s] of a gap that opens."""

    channel: str
    time: float


@dataclass(frozen=True)
class Outcome:
    """What the watch did.

    - ``alarms``: all gaps that opened, and payloads that were taken up; ``floors``: how many times the floor the widest
      channel was after the change, median.
    - ``watched``: seconds before the change in which it was known of all channels what is normal; ``speed``: of the
      motion, as a share of the usual one.
    - ``mass``: error of a payload's, as a share, ``SETTLED`` after the alarm; ``since``: from the change to when it
      began, as the watch says [s]; ``closed``: from when the payload is off until no gap is open and nothing is carried
      [s].
    """

    case: Case
    alarms: tuple[Alarm, ...]
    floors: float
    watched: float
    speed: float
    mass: float = np.nan
    since: float = np.nan
    closed: float = np.nan

    @property
    def false(self) -> tuple[Alarm, ...]:
        """Those while nothing was changed: before a change, and after the payload is off."""
        change = self.case.change
        return tuple(each for each in self.alarms if change is None or not change.at <= each.time <= change.until)

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
    with TemporaryDirectory(prefix="geomid_") as folder:
        description = read_description(robot_description(described(robot, Path(folder))))
    if what in {"quiet", "place"}:
        yield Case(what, robot, seed)
    elif what == PAYLOAD:
        link = [body.name for body in description.inertias if description.moved_by(body.name)][-1]
        yield Case(what, robot, seed, link, (*_KINDS[1:], _PLACE)[seed % len(_KINDS)])
    else:
        joints = [joint.name for joint in description.joints]
        for place, joint in enumerate((joints[0], joints[len(joints) // 2], joints[-1])):
            yield Case(what, robot, seed, joint, _KINDS[(seed + place) % len(_KINDS)])


def outcome(case: Case) -> Outcome:
    """Record and watch. Motions that the drives cannot follow are tried again, slower."""
    with TemporaryDirectory(prefix="geomid_") as folder:
        return _outcome(case, described(case.robot, Path(folder)))


def _outcome(case: Case, robot: str) -> Outcome:
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
        **(_payload(seen) if case.what == PAYLOAD else {}),
    )


def _payload(seen: list[Watched]) -> dict[str, float]:
    """``mass``, ``since`` and ``closed`` of an outcome."""
    carrying = [state for state in seen if state.carried is not None and state.time > BEFORE]
    if not carrying or carrying[0].carried is None:
        return {}
    settled = next((s.carried for s in carrying if s.time >= carrying[0].time + SETTLED and s.carried), None)
    after = [state for state in seen if state.time > BEFORE + AFTER]
    shut = [s.time for s in after if s.carried is None and all(gap.since is None for gap in s.gaps)]
    return {
        "mass": np.nan if settled is None else settled.mass / MASS - 1.0,
        "since": 1e-9 * carrying[0].carried.since - START - BEFORE,
        "closed": shut[0] - BEFORE - AFTER if shut else np.inf,
    }


def _alarms(seen: list[Watched]) -> Iterator[Alarm]:
    known: set[str] = set()
    for state in seen:
        now = {gap.channel for gap in state.gaps if gap.since is not None}
        now |= set() if state.carried is None else {PAYLOAD}
        yield from (Alarm(channel, state.time) for channel in sorted(now - known))
        known = now


def _floors(seen: list[Watched], begin: float) -> float:
    widest = [max((gap.times_floor for gap in state.gaps), default=np.nan) for state in seen if state.time > begin]
    return float(np.nanmedian(widest)) if widest else np.nan


def _known(seen: list[Watched], end: float) -> float:
    most = max(len(state.gaps) for state in seen)
    return TOGETHER * sum(most == len(state.gaps) > 0 and state.time <= end for state in seen)
