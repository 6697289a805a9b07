"""Gate on joint messages: those that neither their neighbours nor the URDF's limits allow are refused, too.

A message that does not go on from the one before waits until up to :data:`AHEAD` more have come, which show what it
was: a fault that is over after three messages, a clock that was set, or something real, which passes.
"""

from __future__ import annotations

from math import tau

import numpy as np

from geomid_ros.signals.admission import FEW, Answer, Gate
from geomid_ros.signals.clocks import FEWEST, steps
from geomid_ros.signals.effort_quality import SpikeHeights
from geomid_ros.signals.ledger import Reason, driver_error
from geomid_ros.signals.settings import CLEAR, FASTEST, FINEST, SHORTEST_CONTACT
from geomid_ros.types import BoolArray, FloatArray, IntArray

AHEAD = 5
"""Messages that a suspicious one waits for, 50 ms at 100 Hz; others do not wait."""

EARLY = "stamp ahead of its time"
SPIKE = "is a spike"
SPIKE_OR_CONTACT = "is a spike, or a contact that messages as slow cannot tell from one"
CLOCK_SET = Reason("clock set: a new segment begins", "told")
LEAP = driver_error(
    "positions leap farther than joints can move: a simulation was reset, an encoder was frozen or lost its count, or "
    "recordings were joined; a new segment begins"
)
_USUAL_STEP = 1.9  # periods between two stamps, above which one may be ahead
_TOO_FAST = 1.5  # times the limit
_LEAST_SET = 20e-3  # [s] that a clock is set by
_MUCH_LESS_LIKELY = 25.0  # square of standard deviations, of all joints


class JointGate(Gate):
    """Refuses joint messages by their neighbours, too; see the module."""

    def __init__(self, joints: tuple[str, ...], limits: FloatArray, turning: BoolArray, max_gap: int) -> None:
        """
        Args:
            joints: those of the messages.
            limits: ``(2, joints)`` the URDF's of speeds and of efforts, infinite where it has none.
            turning: ``(joints,)`` which are revolute: a whole turn is no jump.
            max_gap: [ns] what is further apart is not compared.
        """
        super().__init__(max_gap)
        self._joints = joints
        self._turn = np.where(turning, tau, 0.0)
        self._speed = _TOO_FAST * np.minimum(limits[0], FASTEST)
        self._efforts = SpikeHeights(limits[1])
        self._period_before = np.inf
        self._usual_step = 0.0  # [s] between stamps, where they are uneven
        self._stamps = np.zeros(0, dtype=np.int64)  # of the last messages that passed, of one segment
        self._late = 0  # stamp of the first of late messages that no clock explains; that of the last that passed else
        self._last = np.zeros((0, 3, len(joints)))  # numbers of the very last ones

    def _pass_plain(self, stamps: IntArray, numbers: FloatArray) -> int:
        """Let messages pass that go on from those before, up to the first that does not. Returns how many passed."""
        place = 0
        while place < len(stamps):
            if not len(self._stamps):
                self._pass(stamps[place : place + 1], numbers[place : place + 1])
                place += 1
            part = slice(place, place + self._efforts.room)
            stops = np.flatnonzero(self._suspicious(stamps[part], numbers[part]))
            count = int(stops[0]) if len(stops) else len(stamps[part])
            self._pass(stamps[place : place + count], numbers[place : place + count])
            place += count
            if len(stops):
                break
        return place

    @property
    def _period(self) -> float:
        """Time between messages [s], from the span of the last ones; infinite until it is known."""
        count = len(self._stamps) - 1
        if count < FEWEST:
            return self._period_before
        return 1e-9 * float(self._stamps[-1] - self._stamps[0]) / count

    def _compare_anew(self) -> None:
        """Compare stamps with those that come alone; the period is what it was."""
        self._period_before = self._period
        self._stamps = self._stamps[:0]

    def _suspicious(self, stamps: IntArray, numbers: FloatArray) -> BoolArray:
        """Which messages do not go on from the one before ``(N,)``; as if all passed."""
        every, passed = np.concatenate([self._stamps, stamps]), len(self._stamps)
        before = every[passed - 1 : -1]
        ends = np.arange(passed - 1, len(every) - 1)  # of the spans before each message
        begins = np.maximum(ends - 2 * FEWEST, 0)
        counts = ends - begins
        periods = 1e-9 * (before - every[begins]) / np.maximum(counts, 1)
        periods[counts < FEWEST] = self._period_before
        ahead = stamps - before
        seconds = 1e-9 * ahead
        reach = np.maximum(seconds, periods)[:, None] * self._speed
        found: BoolArray = (seconds > np.maximum(_USUAL_STEP * periods, self._usual_step)) | (ahead <= 0)
        found |= ahead > self._max_gap
        found |= (self._size(steps(numbers[:, 0], self._last[-1, 0])) > reach).any(axis=1)
        found |= (np.abs(steps(numbers[:, 2], self._last[-1, 2])) > self._efforts.least).any(axis=1)
        return found

    def _distance(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """How far positions ``(..., joints)`` are apart, but for whole turns."""
        return self._size(first - second)

    def _size(self, apart: FloatArray) -> FloatArray:
        """The sizes of steps between positions ``(..., joints)``, but for whole turns."""
        return np.asarray(np.abs(apart - self._turn * np.rint(apart / tau)))

    def _pass(self, stamps: IntArray, numbers: FloatArray) -> None:
        if not len(stamps):
            return
        if abs(int(stamps[0]) - self._stamp) > self._max_gap:
            self._compare_anew()
            self._last = self._last[:0]
        self._stamps = np.concatenate([self._stamps, stamps])[-2 * FEWEST - 1 :]
        self._last = np.concatenate([self._last, numbers[-AHEAD - 1 :]])[-AHEAD - 1 :]
        super()._pass(stamps, numbers)
        self._late = self._stamp
        if self._efforts.add(numbers[:, 2]) and len(self._stamps) > 2 * FEWEST:
            self._usual_step = 1e-9 * float(np.partition(np.diff(self._stamps), -FEW)[-FEW])

    def _answer(self, stamps: IntArray, numbers: FloatArray, *, whole: bool) -> Answer | None:
        in_order = super()._answer
        is_late = self._late < stamps[0] <= self._stamp or (len(stamps) > 1 and stamps[0] <= self._stamp < stamps[1])
        if is_late or abs(stamps[0] - self._stamp) > self._max_gap:
            return in_order(stamps, numbers, whole=whole)
        stamps, numbers = stamps[: AHEAD + 1], numbers[: AHEAD + 1]
        for count in range(1, min(FEW, len(stamps) - 2) + 1):
            reason = self._early(stamps, count) or self._position_jumps(stamps, numbers, count)
            if reason:
                return Answer(count, refused=reason)
            spiking = self._effort_spikes(numbers, count)
            if spiking:
                return self._spike(spiking, count, self._elapsed(stamps, count))
        if len(stamps) <= AHEAD and not whole:
            return None
        if self._clock_was_set(stamps, numbers):
            return Answer(noted=CLOCK_SET, begins=True)
        if stamps[0] <= self._stamp:
            self._late = int(stamps[0])
            return in_order(stamps, numbers, whole=whole)
        return Answer(noted=LEAP, begins=True) if self._position_leaps(stamps, numbers) else Answer()

    @staticmethod
    def _spike(effort: str, count: int, elapsed: float) -> Answer:
        """What an effort is that is back within so many seconds. That of a short contact is not the robot's either; for
        what lasts longer the robot may have moved as never before."""
        if elapsed <= SHORTEST_CONTACT:
            return Answer(count, refused=f"{effort} {SPIKE}")
        if count == 1 and elapsed <= 2.0 * SHORTEST_CONTACT:
            return Answer(count, refused=f"{effort} {SPIKE_OR_CONTACT}")
        return Answer(noted=Reason(f"{effort} {SPIKE_OR_CONTACT}: kept", "told"))

    def _early(self, stamps: IntArray, length: int) -> str:
        """The next two messages are later than the last good one, and not later than these."""
        then, after = stamps[length : length + 2].tolist()
        is_early = self._stamp < then < after <= int(np.min(stamps[:length]))
        return EARLY if is_early else ""

    def _elapsed(self, stamps: IntArray, length: int) -> float:
        """Time [s] from the last good message to the first after these; infinite until the period is known."""
        return max(1e-9 * float(stamps[length] - self._stamp), (length + 1) * self._period)

    def _position_jumps(self, stamps: IntArray, numbers: FloatArray, length: int) -> str:
        """Positions that jump away and come back faster than the joint can move."""
        last, reach = self._last[-1], self._elapsed(stamps, length) * self._speed
        away, back, later = numbers[:length], numbers[length], numbers[length + 1]
        far = np.min(np.minimum(self._distance(away[:, 0], last[0]), self._distance(away[:, 0], back[0])), axis=0)
        jumps = far > reach
        if not jumps.any():  # of nearly all that are suspicious
            return ""
        jumps &= self._distance(back[0], last[0]) < reach
        jumps &= self._distance(later[0], last[0]) < 2.0 * reach
        jumps &= far > CLEAR * np.maximum(self._largest_step(self._last), self._largest_step(numbers[length:]))
        return (
            f"position of '{self._joints[int(np.argmax(jumps))]}' jumps, and back, faster than it can move"
            if jumps.any()
            else ""
        )

    def _position_leaps(self, stamps: IntArray, numbers: FloatArray) -> bool:
        """Whether a position goes on elsewhere, farther than the joint can move."""
        reach = self._elapsed(stamps, 0) * self._speed
        far = self._distance(numbers[0, 0], self._last[-1, 0])
        if not (far > reach).any():
            return False
        usual = np.maximum(self._largest_step(self._last), self._largest_step(numbers))
        return bool(np.any((far > reach) & (far > CLEAR * usual)))

    def _effort_spikes(self, numbers: FloatArray, length: int) -> str:
        """The effort that leaves what is usual, and comes back."""
        last, away, back, later = self._last[-1, 2], numbers[:length, 2], numbers[length, 2], numbers[length + 1, 2]
        height = np.min(np.minimum(np.abs(away - last), np.abs(away - back)), axis=0)
        spikes = height > self._efforts.least
        if not spikes.any():
            return ""
        spikes &= np.maximum(np.abs(back - last), np.abs(later - last)) < height / CLEAR
        return f"effort of '{self._joints[int(np.argmax(spikes))]}'" if spikes.any() else ""

    def _largest_step(self, numbers: FloatArray) -> FloatArray:
        """Between positions of messages in a row ``(joints,)``: what moves fast anyway may be faster than thought."""
        moved = self._distance(numbers[1:, 0], numbers[:-1, 0])
        return np.asarray(np.max(moved, axis=0, initial=0.0))

    def _clock_was_set(self, stamps: IntArray, numbers: FloatArray) -> bool:
        """Whether by the motion only a period has passed between the last good message and the first of these, from
        which the stamps go on as before."""
        period, count = self._period, AHEAD + 1
        periods = 1e-9 * np.diff(stamps)
        step = 1e-9 * float(stamps[0] - self._stamp)
        if not _LEAST_SET < abs(step - period) < np.inf or min(len(self._stamps), len(self._last), len(stamps)) < count:
            return False
        if np.any((periods < period / CLEAR) | (periods > _USUAL_STEP * period)):
            return False
        left, right = self._without_turns(self._last[-count:, 0], numbers[:, 0])
        ends = _end(self._stamps[-count:] - self._stamps[-1], left), _end(stamps - stamps[0], right)
        return _unlikely(*ends, step) > _unlikely(*ends, period) + _MUCH_LESS_LIKELY

    def _without_turns(self, left: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions relative to the last of the first ones."""
        apart = np.concatenate([left, right]) - left[-1]
        whole = apart - self._turn * np.round(apart / tau)
        return whole[: len(left)], whole[len(left) :]


def _end(stamps: IntArray, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Place and speed where a piece of a motion ends, or begins, and the variances of both, each ``(2, joints)``: at
    time zero of parabolas through ``positions (N, joints)``."""
    terms = np.vander(1e-9 * stamps, 3, increasing=True)
    fitted, *_ = np.linalg.lstsq(terms, positions, rcond=None)
    noise = np.sum((positions - terms @ fitted) ** 2, axis=0) / (len(stamps) - 3) + FINEST**2
    spread = np.diag(np.linalg.inv(terms.T @ terms))
    return fitted[:2], spread[:2, None] * noise


def _unlikely(left: tuple[FloatArray, FloatArray], right: tuple[FloatArray, FloatArray], time: float) -> float:
    """How unlikely it is that a time [s] has passed from the end of a motion to its next beginning: the sum of squares
    of the joints' ways by the mean of the speeds, in standard deviations."""
    (place, speed), (variance, of_speed) = left
    (next_place, next_speed), (next_variance, of_next_speed) = right
    error = next_place - place - 0.5 * time * (speed + next_speed)
    return float(np.sum(error**2 / (variance + next_variance + 0.25 * time**2 * (of_speed + of_next_speed))))
