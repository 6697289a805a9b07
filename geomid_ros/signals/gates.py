"""Gates on joint messages: those that neither their neighbours nor the URDF's limits allow are refused.

What is refused depends on the messages of this stream alone, in the order in which they came; not on how many come at
once. A message that goes on from the one before passes at once. One that does not waits until up to :data:`AHEAD` more
have come, which show what it was: a fault that is over after three messages, a clock that was set, or something real,
which passes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from geomid_ros.signals.arrived import Arrived
from geomid_ros.signals.ledger import Reason, driver_error
from geomid_ros.signals.motion_time import end_of, unlikely
from geomid_ros.signals.periods import SHORT
from geomid_ros.signals.usual_efforts import CLEAR, UsualEfforts
from geomid_ros.types import BoolArray, FloatArray, IntArray

AHEAD = 5
"""Messages that a suspicious one waits for, 50 ms at 100 Hz; others do not wait."""
PATIENCE = 1000
"""Messages of all topics: after so many a suspicious one passes, though fewer of its own have come."""

EARLY = "stamp ahead of its time"
SPIKE = "is a spike"
SPIKE_OR_CONTACT = "is a spike, or a contact that messages as slow cannot tell from one"
CLOCK_SET = Reason("clock set: a new segment begins", "told")
UNIT_CHANGED = (
    "efforts change at once by a factor of about {:g}, at all joints: another unit or sign begins; use one of the two "
    "parts, with effort_gain for its unit"
)
_MOST = 3  # messages in a row that a fault lasts
_USUAL_STEP = 1.9  # periods between two stamps, above which one may be ahead
_PERIODS, _FEWEST_PERIODS = 64, 32  # over which the period is measured; fewer may be one burst
_TURN = 2.0 * np.pi
_FASTEST = 2.0 * np.pi  # [rad/s, m/s] no limit above is believed, as many URDFs have placeholders
_TOO_FAST = 1.5  # times the limit
_BACK = 0.25  # of its height, that is left after a spike
_SHORTEST_CONTACT = 33e-3  # [s] a collision of 40 ms is larger than a quarter of its height for so long
_LEAST_SET = 20e-3  # [s] that a clock is set by
_MUCH_LESS_LIKELY = 25.0  # square of standard deviations, of all joints


@dataclass(frozen=True)
class Limits:
    """The URDF's limits ``(joints,)`` of speeds and of efforts, infinite where it has none."""

    speed: FloatArray
    effort: FloatArray

    @staticmethod
    def none(joints: int) -> Limits:
        """No limits."""
        return Limits(np.full(joints, np.inf), np.full(joints, np.inf))

    def of(self, places: list[int]) -> Limits:
        """Those of some joints."""
        return Limits(self.speed[places], self.effort[places])


@dataclass(frozen=True)
class _Answer:
    """What the first suspicious messages are, ``count`` of them: ``refused`` or, from the first one on, something
    ``changed``, and in what way; else they are real, unless they are ``late``, which their stamps say. What is real may
    be ``noted``."""

    count: int = 1
    refused: str = ""
    changed: str = ""
    noted: str = ""
    late: bool = False


@dataclass(frozen=True, eq=False)
class Decided:
    """Messages that are decided on, refused ones with the reason; ``changed`` says by the place, as they came, of the
    first message that is different what has changed: nothing is to be compared across it."""

    messages: Arrived
    changed: dict[int, str]


class JointGate:
    """Refuses joint messages by their neighbours; see the module."""

    def __init__(
        self, joints: tuple[str, ...], limits: Limits, turning: BoolArray, max_gap: int, note: Callable[[str], None]
    ) -> None:
        """
        Args:
            joints: those of the messages.
            limits: of these.
            turning: ``(joints,)`` which are revolute: a whole turn is no jump.
            max_gap: [ns] what is further apart is not compared.
            note: is told of what is doubtful, and passes.
        """
        self._joints = joints
        self._note = note
        self._turn = np.where(turning, _TURN, 0.0)
        self._speed = _TOO_FAST * np.minimum(limits.speed, _FASTEST)
        self._efforts = UsualEfforts(limits.effort)
        self._max_gap = max_gap
        self._held: Arrived | None = None
        self._decided = 0  # stamp of the last message, good by itself, that was decided on
        self._period_before = np.inf
        self._usual_step = 0.0  # [s] between stamps, where they are uneven
        self._stamps = np.zeros(0, dtype=np.int64)  # of the last messages that passed, of one segment
        self._last = np.zeros((0, 3, len(joints)))  # numbers of the very last ones

    @property
    def held(self) -> int:
        """Number of messages that are held."""
        return 0 if self._held is None else len(self._held)

    @property
    def first_held(self) -> int:
        """The place of the first message that is held, if any is."""
        return int(self._held.order[0]) if self._held is not None else -1

    def judge(self, new: Arrived | None, newest: int) -> Decided | None:
        """Take messages, and decide on those that can be decided on.

        Args:
            new: messages; None to look again at those that are held.
            newest: the place of the last message of all topics.

        Returns:
            None if there is nothing to be decided on.
        """
        parts = [part for part in (self._held, new) if part is not None]
        if not parts:
            return None
        arrived, changed = Arrived.joined(parts), dict[int, str]()
        good = np.flatnonzero(arrived.good & (arrived.stamps > 0))
        places = good[np.diff(arrived.stamps[good], prepend=self._decided) != 0]
        stamps, numbers, order = arrived.stamps[places], arrived.numbers[places], arrived.order[places]
        place = self._pass_plain(stamps, numbers)
        while place < len(places):
            last = order[place] + PATIENCE
            window = slice(place, place + min(AHEAD + 1, int(np.searchsorted(order[place:], last, side="right"))))
            answer = self._answer(stamps[window], numbers[window], whole=newest >= last)
            if answer is None:
                break
            if answer.refused:
                arrived.refusals[places[place : place + answer.count]] = answer.refused
            elif not answer.late:
                if answer.changed:
                    changed[int(order[place])] = answer.changed
                    self._begin_anew()
                if answer.noted:
                    self._note(answer.noted)
                self._pass(stamps[place : place + 1], numbers[place : place + 1])
            place += answer.count
            place += self._pass_plain(stamps[place:], numbers[place:])
        end = int(places[place]) if place < len(places) else len(arrived)
        decided = good[good < end]
        self._decided = int(arrived.stamps[decided[-1]]) if len(decided) else self._decided
        self._held = arrived.select(slice(end, None)) if end < len(arrived) else None
        return Decided(arrived.select(slice(end)), changed)

    def forget(self) -> None:
        """Give up the messages that are held."""
        self._held = None

    def _pass_plain(self, stamps: IntArray, numbers: FloatArray) -> int:
        """Let messages pass that go on from those before, up to the first that does not. Returns how many passed."""
        place = 0
        while place < len(stamps):
            if not len(self._stamps):
                self._pass(stamps[place : place + 1], numbers[place : place + 1])
                place += 1
            part = slice(place, place + self._efforts.room)
            suspicious, apart = self._suspicious(stamps[part], numbers[part])
            stops = np.flatnonzero(suspicious | apart)
            count = int(stops[0]) if len(stops) else len(suspicious)
            self._pass(stamps[place : place + count], numbers[place : place + count])
            place += count
            if len(stops) and suspicious[count]:
                break
            if len(stops):
                self._begin_anew()
                self._last = self._last[:0]
        return place

    @property
    def _period(self) -> float:
        """Time between messages [s], from the span of the last ones; infinite until it is known."""
        count = len(self._stamps) - 1
        if count < _FEWEST_PERIODS:
            return self._period_before
        return 1e-9 * float(self._stamps[-1] - self._stamps[0]) / count

    def _begin_anew(self) -> None:
        """Compare stamps with those that come alone; the period is what it was."""
        self._period_before = self._period
        self._stamps = self._stamps[:0]

    def _suspicious(self, stamps: IntArray, numbers: FloatArray) -> tuple[BoolArray, BoolArray]:
        """Which messages do not go on from the one before, and which are further from it than the longest gap, both
        ``(N,)``; as if all passed."""
        passed = self._stamps
        before = np.concatenate([self._last[-1:], numbers[:-1]])
        every = np.concatenate([passed, stamps])
        ends = np.arange(len(passed) - 1, len(every) - 1)  # of the spans before each message
        begins = np.maximum(ends - _PERIODS, 0)
        periods = 1e-9 * (every[ends] - every[begins]) / np.maximum(ends - begins, 1)
        periods[ends - begins < _FEWEST_PERIODS] = self._period_before
        steps = stamps - every[ends]
        seconds = 1e-9 * steps
        reach = np.maximum(seconds, periods)[:, None] * self._speed
        apart = np.abs(steps) > self._max_gap
        found: BoolArray = (seconds > np.maximum(_USUAL_STEP * periods, self._usual_step)) | (steps < 0)
        found |= (self._distance(numbers[:, 0], before[:, 0]) > reach).any(axis=1)
        found |= self._efforts.jump(before[:, 2], numbers[:, 2])
        return found & ~apart, apart

    def _distance(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """How far positions ``(..., joints)`` are apart, but for whole turns."""
        apart = np.abs(first - second)
        return np.asarray(np.abs(apart - self._turn * np.round(apart / _TURN)))

    def _pass(self, stamps: IntArray, numbers: FloatArray) -> None:
        """Note messages that go on from the one before, or are real though they do not."""
        if not len(stamps):
            return
        if len(self._stamps) and stamps[0] < self._stamps[-1]:  # other than it was, the clock says nothing of periods
            self._begin_anew()
        self._stamps = np.concatenate([self._stamps, stamps])[-_PERIODS - 1 :]
        self._last = np.concatenate([self._last, numbers])[-AHEAD - 1 :]
        if self._efforts.add(numbers[:, 2]) and len(self._stamps) > _PERIODS:
            self._usual_step = 1e-9 * float(np.partition(np.diff(self._stamps), -_MOST)[-_MOST])

    def _answer(self, stamps: IntArray, numbers: FloatArray, *, whole: bool) -> _Answer | None:
        """What the first of these messages, which is suspicious, is; None if more have to come, and ``whole`` is not
        said."""
        if len(stamps) > 1 and stamps[0] <= self._stamps[-1] < stamps[1]:
            return _Answer(late=True)
        for count in range(1, min(_MOST, len(stamps) - 2) + 1):
            reason = self._early(stamps, count) or self._position_jumps(stamps, numbers, count)
            if reason:
                return _Answer(count, refused=reason)
            spiking = self._effort_spikes(numbers, count)
            if spiking:
                return self._spike(spiking, count, self._elapsed(stamps, count))
        if len(stamps) <= AHEAD:
            return _Answer() if whole else None
        if self._clock_was_set(stamps, numbers):
            return _Answer(changed=CLOCK_SET)
        soon = 1e-9 * float(stamps[0] - self._stamps[-1]) <= _USUAL_STEP * self._period
        factor = self._efforts.factor(self._last[:, 2], numbers[:, 2])
        if not factor or not soon:
            return _Answer()
        self._efforts.forget()
        return _Answer(changed=driver_error(UNIT_CHANGED.format(factor)))

    @staticmethod
    def _spike(effort: str, count: int, elapsed: float) -> _Answer:
        """What an effort is that is back within so many seconds. That of a short contact is not the robot's either; for
        what lasts longer the robot may have moved as never before."""
        if elapsed <= _SHORTEST_CONTACT:
            return _Answer(count, refused=f"{effort} {SPIKE}")
        if count == 1 and elapsed <= 2.0 * _SHORTEST_CONTACT:
            return _Answer(count, refused=f"{effort} {SPIKE_OR_CONTACT}")
        return _Answer(noted=Reason(f"{effort} {SPIKE_OR_CONTACT}: kept", "told"))

    def _early(self, stamps: IntArray, length: int) -> str:
        """The next two messages are later than the last good one, and not later than these."""
        then, after = stamps[length : length + 2].tolist()
        is_early = self._stamps[-1] < then < after <= int(np.min(stamps[:length]))
        return EARLY if is_early else ""

    def _elapsed(self, stamps: IntArray, length: int) -> float:
        """Time [s] from the last good message to the first after these; infinite until the period is known."""
        return max(1e-9 * float(stamps[length] - self._stamps[-1]), (length + 1) * self._period)

    def _position_jumps(self, stamps: IntArray, numbers: FloatArray, length: int) -> str:
        """Positions that jump away and come back faster than the joint can move."""
        last, reach = self._last[-1], self._elapsed(stamps, length) * self._speed
        away, back, later = numbers[:length], numbers[length], numbers[length + 1]
        far = np.min(np.minimum(self._distance(away[:, 0], last[0]), self._distance(away[:, 0], back[0])), axis=0)
        jumps = (far > reach) & (self._distance(back[0], last[0]) < reach)
        jumps &= self._distance(later[0], last[0]) < 2.0 * reach
        jumps &= far > CLEAR * np.maximum(self._largest_step(self._last), self._largest_step(numbers[length:]))
        return (
            f"position of '{self._joints[int(np.argmax(jumps))]}' jumps, and back, faster than it can move"
            if jumps.any()
            else ""
        )

    def _effort_spikes(self, numbers: FloatArray, length: int) -> str:
        """The effort that leaves what is usual, and comes back."""
        last, away, back, later = self._last[-1, 2], numbers[:length, 2], numbers[length, 2], numbers[length + 1, 2]
        height = np.min(np.minimum(np.abs(away - last), np.abs(away - back)), axis=0)
        left = np.maximum(np.abs(back - last), np.abs(later - last))
        spikes = (height > self._efforts.spike) & (left < _BACK * height)
        return f"effort of '{self._joints[int(np.argmax(spikes))]}'" if spikes.any() else ""

    def _largest_step(self, numbers: FloatArray) -> FloatArray:
        """Between positions of messages in a row ``(joints,)``: what moves fast anyway may be faster than thought."""
        steps = self._distance(numbers[1:, 0], numbers[:-1, 0])
        return np.asarray(np.max(steps, axis=0, initial=0.0))

    def _clock_was_set(self, stamps: IntArray, numbers: FloatArray) -> bool:
        """Whether by the motion only a period has passed between the last good message and the first of these, from
        which the stamps go on as before."""
        period, count = self._period, len(stamps)
        steps = 1e-9 * np.diff(stamps)
        step = 1e-9 * float(stamps[0] - self._stamps[-1])
        if not _LEAST_SET < abs(step - period) < np.inf or min(len(self._stamps), len(self._last)) < count:
            return False
        if np.any((steps < SHORT * period) | (steps > _USUAL_STEP * period)):
            return False
        before = 1e-9 * (self._stamps[-count:] - self._stamps[-1])
        left, right = self._without_turns(self._last[-count:, 0], numbers[:, 0])
        ends = end_of(before, left), end_of(1e-9 * (stamps - stamps[0]), right)
        as_set, as_stamped = (unlikely(*ends, time) for time in (period, step))
        return as_stamped > as_set + _MUCH_LESS_LIKELY

    def _without_turns(self, left: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions relative to the last of the first ones."""
        apart = np.concatenate([left, right]) - left[-1]
        whole = apart - self._turn * np.round(apart / _TURN)
        return whole[: len(left)], whole[len(left) :]
