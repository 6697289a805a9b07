"""Gates on joint messages: those that neither their neighbours nor the URDF's limits allow are refused.

What is refused depends on the messages of this stream alone, in the order in which they came; not on how many come at
once. A message that goes on from the one before passes at once. One that does not is held until :data:`AHEAD` more have
come, which show what it was: a fault that is over after three messages, or something real, which passes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.signals.arrived import Arrived
from geomid_ros.types import BoolArray, FloatArray, IntArray

AHEAD = 5
"""Messages: a suspicious one waits for so many others, 50 ms at 100 Hz; others do not wait."""

EARLY = "stamp ahead of its time"
_MOST = 3  # messages in a row that a fault lasts
_USUAL_STEP = 1.9  # periods between two stamps, above which one may be ahead
_PERIODS, _FEWEST_PERIODS = 64, 4  # over which the period is measured
_TURN = 2.0 * np.pi
_FASTEST = 2.0 * np.pi  # [rad/s, m/s] no limit above is believed, as many URDFs have placeholders
_TOO_FAST = 1.5  # times the limit
_IN_BURSTS = 0.2
_CHUNK = 128  # messages, of which the efforts' usual size and change are measured
_FEWEST_CHUNKS = 2
_TAIL = 6  # messages of a chunk, at either end, that do not count
_SPIKE_IN_RANGE, _SPIKE_IN_CHANGES, _SPIKE_IN_LIMIT = 1.5, 8.0, 0.02
_BACK = 0.25  # of its height, that is left after a spike
_SHORTEST_CONTACT = 33e-3  # [s] a collision of 40 ms is larger than a quarter of its height for so long


def in_bursts(stamps: IntArray) -> bool:
    """Whether more than a fifth of the steps between increasing stamps are shorter than a quarter of the mean step."""
    steps = np.diff(stamps)
    return bool(np.mean(steps < 0.25 * np.mean(steps)) > _IN_BURSTS)


@dataclass(frozen=True)
class Limits:
    """The URDF's limits ``(joints,)``: of speeds and of efforts, infinite or zero where it has none."""

    speed: FloatArray
    effort: FloatArray

    @staticmethod
    def none(joints: int) -> Limits:
        """No limits."""
        return Limits(np.full(joints, np.inf), np.full(joints, np.inf))


class JointGate:
    """Refuses joint messages by their neighbours; see the module."""

    def __init__(self, joints: tuple[str, ...], limits: Limits, turning: BoolArray) -> None:
        """
        Args:
            joints: the robot's, in its order.
            limits: of these.
            turning: ``(joints,)`` which are revolute: a whole turn is no jump.
        """
        self._joints = joints
        self._turn = np.where(turning, _TURN, 0.0)
        speed = np.where(limits.speed > 0.0, np.minimum(limits.speed, _FASTEST), _FASTEST)
        self._speed = _TOO_FAST * speed
        self._least_spike = np.where(np.isfinite(limits.effort), _SPIKE_IN_LIMIT * limits.effort, 0.0)
        self._held: Arrived | None = None
        self._stamps = np.zeros(0, dtype=np.int64)  # of the last messages that passed
        self._last: FloatArray | None = None  # numbers of the last one
        self._efforts: list[FloatArray] = []  # of the present chunk
        self._chunks = 0
        self._low = np.full(len(self._joints), np.inf)
        self._high = np.full(len(self._joints), -np.inf)
        self._change = np.zeros(len(self._joints))

    @property
    def held(self) -> int:
        """Number of messages that are held."""
        return 0 if self._held is None else len(self._held)

    def release(self) -> Arrived | None:
        """The messages that are held: no more will come to judge them by."""
        held, self._held = self._held, None
        return held

    def judge(self, new: Arrived) -> Arrived:
        """Take messages. Returns those that are decided on, with the reasons why some are refused."""
        arrived = new if self._held is None else Arrived.joined([self._held, new])
        places = np.flatnonzero(arrived.good & (arrived.stamps > 0))
        stamps, numbers = arrived.stamps[places], arrived.numbers[places]
        place, order = 0, arrived.order.copy()
        while place < len(places):
            room = _CHUNK - sum(map(len, self._efforts))
            part = slice(place, place + room)
            suspicious = np.flatnonzero(self._suspicious(stamps[part], numbers[part]))
            count = int(suspicious[0]) if len(suspicious) else min(room, len(places) - place)
            self._pass(stamps[place : place + count], numbers[place : place + count])
            place += count
            if not len(suspicious):
                continue
            window = slice(place, place + AHEAD + 1)
            if len(stamps[window]) <= AHEAD:
                break
            # Messages of other topics have their turn while these wait.
            waiting = order[places[place] :]
            np.maximum(waiting, arrived.order[places[place + AHEAD]], out=waiting)
            length, reason = self._fault(stamps[window], numbers[window])
            if length:
                arrived.refusals[places[place : place + length]] = reason
            else:
                length = 1
                self._pass(stamps[place : place + 1], numbers[place : place + 1])
            place += length
        end = int(places[place]) if place < len(places) else len(arrived)
        self._held = arrived.select(slice(end, None)) if end < len(arrived) else None
        return replace(arrived, order=order).select(slice(end))

    @property
    def _period(self) -> float:
        """Time between messages [s], from the span of the last ones; 0 until it is known."""
        count = len(self._stamps) - 1
        return 1e-9 * float(self._stamps[-1] - self._stamps[0]) / count if count >= _FEWEST_PERIODS else 0.0

    def _suspicious(self, stamps: IntArray, numbers: FloatArray) -> BoolArray:
        """Which messages do not go on from the one before ``(N,)``."""
        if self._last is None:
            return np.zeros(len(stamps), dtype=np.bool_)
        before = np.concatenate([self._last[None], numbers[:-1]])
        all_stamps = np.concatenate([self._stamps, stamps])
        ends = np.arange(len(self._stamps) - 1, len(all_stamps) - 1)  # of the spans before each message
        begins = np.maximum(ends - _PERIODS, 0)
        periods = 1e-9 * (all_stamps[ends] - all_stamps[begins]) / np.maximum(ends - begins, 1)
        periods[ends - begins < _FEWEST_PERIODS] = np.inf
        steps = 1e-9 * (stamps - all_stamps[ends])
        reach = np.maximum(steps, periods)[:, None] * self._speed
        found: BoolArray = (steps > _USUAL_STEP * periods) | (steps < 0.0)
        found |= (self._apart(numbers[:, 0], before[:, 0]) > reach).any(axis=1)
        found |= (np.abs(numbers[:, 2] - before[:, 2]) > self._spike).any(axis=1)
        return found

    def _apart(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """How far positions ``(..., joints)`` are apart, but for whole turns."""
        apart = np.abs(first - second)
        return np.asarray(np.abs(apart - self._turn * np.round(apart / _TURN)))

    @property
    def _spike(self) -> FloatArray:
        """The least height of an effort's spike ``(joints,)``; infinite until it is known what is usual."""
        if self._chunks < _FEWEST_CHUNKS:
            return np.full(len(self._joints), np.inf)
        usual = np.maximum(_SPIKE_IN_RANGE * (self._high - self._low), _SPIKE_IN_CHANGES * self._change)
        return np.asarray(np.maximum(usual, self._least_spike))

    def _pass(self, stamps: IntArray, numbers: FloatArray) -> None:
        """Note messages that go on from the one before, or are real though they do not."""
        if not len(stamps):
            return
        if len(self._stamps) and stamps[0] < self._stamps[-1]:  # other than it was, the clock says nothing of periods
            self._stamps = self._stamps[:0]
        self._stamps = np.concatenate([self._stamps, stamps])[-_PERIODS - 1 :]
        self._last = numbers[-1]
        self._efforts.append(numbers[:, 2])
        if sum(map(len, self._efforts)) >= _CHUNK:
            self._learn(np.concatenate(self._efforts))
            self._efforts = []

    def _learn(self, efforts: FloatArray) -> None:
        """Learn how large efforts are, and how they change from one message to the next."""
        measured = ~np.isnan(efforts).any(axis=0)
        ends = np.partition(efforts, (_TAIL, len(efforts) - 1 - _TAIL), axis=0)
        change = np.partition(np.abs(np.diff(efforts, axis=0)), len(efforts) - 2 - _TAIL, axis=0)[-1 - _TAIL]
        self._low[measured] = np.minimum(self._low, ends[_TAIL])[measured]
        self._high[measured] = np.maximum(self._high, ends[-1 - _TAIL])[measured]
        self._change[measured] = np.maximum(self._change, change)[measured]
        self._chunks += 1

    def _fault(self, stamps: IntArray, numbers: FloatArray) -> tuple[int, str]:
        """How many of the first of these messages are faulty, and why; none if what is suspicious is real."""
        for length in range(1, _MOST + 1):
            reason = self._early(stamps, length) or self._excursion(stamps, numbers, length)
            if reason:
                return length, reason
        return 0, ""

    def _early(self, stamps: IntArray, length: int) -> str:
        """The next two messages are later than the last good one, and not later than these."""
        then, after = stamps[length : length + 2].tolist()
        is_early = self._stamps[-1] < then < after <= int(np.min(stamps[:length]))
        return EARLY if is_early else ""

    def _excursion(self, stamps: IntArray, numbers: FloatArray, length: int) -> str:
        """Positions that jump away and come back faster than the joint can move, or efforts that do within less than a
        contact takes."""
        last, period = self._last, self._period
        if last is None or not period:
            return ""
        away, back, later = numbers[:length], numbers[length], numbers[length + 1]
        elapsed = max(1e-9 * float(stamps[length] - self._stamps[-1]), (length + 1) * period)
        reach = elapsed * self._speed
        far = np.min(np.minimum(self._apart(away[:, 0], last[0]), self._apart(away[:, 0], back[0])), axis=0)
        jumps = (far > reach) & (self._apart(back[0], last[0]) < reach)
        jumps &= self._apart(later[0], last[0]) < 2.0 * reach
        if jumps.any():
            return f"position of '{self._joints[int(np.argmax(jumps))]}' jumps, and back, faster than it can move"
        if elapsed > _SHORTEST_CONTACT:
            return ""
        height = np.min(np.minimum(np.abs(away[:, 2] - last[2]), np.abs(away[:, 2] - back[2])), axis=0)
        left = np.maximum(np.abs(back[2] - last[2]), np.abs(later[2] - last[2]))
        spikes = (height > self._spike) & (left < _BACK * height)
        return f"effort of '{self._joints[int(np.argmax(spikes))]}' is a spike" if spikes.any() else ""
