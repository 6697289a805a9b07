"""Gate for joint messages: also refuses those that contradict their neighbours or the URDF's limits.

A message that does not continue the one before waits for up to :data:`AHEAD` more. They show what it is: a fault of at
most three messages, a clock that was set, or something real, which passes.
"""

from __future__ import annotations

from math import tau

import numpy as np

from geomid_ros.signals.clocks import FEWEST, steps
from geomid_ros.signals.effort_quality import SpikeHeights
from geomid_ros.signals.ledger import Reason, driver_error
from geomid_ros.signals.reorder_buffer import FEW, Gate, GateDecision
from geomid_ros.signals.settings import BEST_POSITION_ACCURACY, CLEAR_RATIO, LARGEST_SPEED_LIMIT, SHORTEST_CONTACT
from geomid_ros.types import BoolArray, FloatArray, IntArray

AHEAD = 5
"""Messages that a suspicious one waits for, 50 ms at 100 Hz; others do not wait."""

EARLY = "stamp ahead of its time"
SPIKE = "is a spike"
SPIKE_OR_CONTACT = "is a spike or a contact; the message rate is too low to distinguish them"
CLOCK_SET = Reason("clock set: a new segment begins", "told")
LEAP = driver_error(
    "positions leap farther than joints can move: a simulation was reset, an encoder was frozen or lost its count, or "
    "recordings were joined; a new segment begins"
)
_USUAL_STEP = 1.9  # periods; after a longer step a stamp may be ahead of its time
_TOO_FAST = 1.5  # times the speed limit
_LEAST_SET = 20e-3  # [s] smallest clock step that is detected
_MUCH_LESS_LIKELY = 25.0  # difference in chi square, summed over joints


class JointGate(Gate):
    """Refuses joint messages that contradict their neighbours; see the module."""

    def __init__(self, joints: tuple[str, ...], limits: FloatArray, turning: BoolArray, max_gap: int) -> None:
        """
        Args:
            joints: joints of the messages.
            limits: ``(2, joints)`` the URDF's limits of speeds and efforts, infinite where it has none.
            turning: ``(joints,)`` True for revolute joints, for which a whole turn is no jump.
            max_gap: [ns] messages further apart are not compared.
        """
        super().__init__(max_gap)
        self._joints = joints
        self._turn = np.where(turning, tau, 0.0)
        self._speed = _TOO_FAST * np.minimum(limits[0], LARGEST_SPEED_LIMIT)
        self._efforts = SpikeHeights(limits[1])
        self._period_before = np.inf
        self._usual_step = 0.0  # [s] long step between uneven stamps
        self._stamps = np.zeros(0, dtype=np.int64)  # of the last messages that passed in this segment
        self._late = 0  # stamp of the first late message that no clock explains, else of the last that passed
        self._last = np.zeros((0, 3, len(joints)))  # numbers of the last few messages

    @property
    def _room(self) -> int:
        return self._efforts.room

    @property
    def _period(self) -> float:
        """Mean time between the last messages [s]; infinite until it is known."""
        count = len(self._stamps) - 1
        if count < FEWEST:
            return self._period_before
        return 1e-9 * float(self._stamps[-1] - self._stamps[0]) / count

    def _compare_anew(self) -> None:
        """Restart comparisons of stamps; the period is kept."""
        self._period_before = self._period
        self._stamps = self._stamps[:0]

    def _suspicious(self, stamps: IntArray, numbers: FloatArray) -> BoolArray:
        all_stamps, passed = np.concatenate([self._stamps, stamps]), len(self._stamps)
        before = all_stamps[passed - 1 : -1]
        ends = np.arange(passed - 1, len(all_stamps) - 1)  # last stamp of the span before each message
        begins = np.maximum(ends - 2 * FEWEST, 0)
        counts = ends - begins
        periods = 1e-9 * (before - all_stamps[begins]) / np.maximum(counts, 1)
        periods[counts < FEWEST] = self._period_before
        seconds = 1e-9 * (stamps - before)
        reach = np.maximum(seconds, periods)[:, None] * self._speed
        suspicious = super()._suspicious(stamps, numbers)
        suspicious |= seconds > np.maximum(_USUAL_STEP * periods, self._usual_step)
        suspicious |= (self._size(steps(numbers[:, 0], self._last[-1, 0])) > reach).any(axis=1)
        suspicious |= (np.abs(steps(numbers[:, 2], self._last[-1, 2])) > self._efforts.least).any(axis=1)
        return suspicious

    def _size(self, step: FloatArray) -> FloatArray:
        """Sizes of position steps ``(..., joints)``, modulo whole turns."""
        return np.asarray(np.abs(step - self._turn * np.rint(step / tau)))

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

    def _answer(self, stamps: IntArray, numbers: FloatArray, *, final: bool) -> GateDecision | None:
        in_order = super()._answer
        is_late = self._late < stamps[0] <= self._stamp or (len(stamps) > 1 and stamps[0] <= self._stamp < stamps[1])
        if is_late or abs(stamps[0] - self._stamp) > self._max_gap:
            return in_order(stamps, numbers, final=final)
        stamps, numbers = stamps[: AHEAD + 1], numbers[: AHEAD + 1]
        for count in range(1, min(FEW, len(stamps) - 2) + 1):
            reason = self._early(stamps, count) or self._position_jumps(stamps, numbers, count)
            if reason:
                return GateDecision(count, refused=reason)
            spike = self._effort_spikes(numbers, count)
            if spike:
                return self._spike(spike, count, self._elapsed(stamps, count))
        if len(stamps) <= AHEAD and not final:
            return None
        if self._clock_was_set(stamps, numbers):
            return GateDecision(1, noted=CLOCK_SET, begins=True)
        if stamps[0] <= self._stamp:
            self._late = int(stamps[0])
            return in_order(stamps, numbers, final=final)
        return GateDecision(1, noted=LEAP, begins=True) if self._position_leaps(stamps, numbers) else GateDecision(1)

    @staticmethod
    def _spike(effort: str, count: int, elapsed: float) -> GateDecision:
        """Decide on an effort that returns within ``elapsed`` [s]. Short contacts are refused, too, as they are not the
        robot's dynamics. Longer peaks are kept, as the robot may move in a new way."""
        if elapsed <= SHORTEST_CONTACT:
            return GateDecision(count, refused=f"{effort} {SPIKE}")
        if count == 1 and elapsed <= 2.0 * SHORTEST_CONTACT:
            return GateDecision(count, refused=f"{effort} {SPIKE_OR_CONTACT}")
        return GateDecision(1, noted=Reason(f"{effort} {SPIKE_OR_CONTACT}: kept", "told"))

    def _early(self, stamps: IntArray, length: int) -> str:
        """EARLY if the first ``length`` stamps are ahead of the next two, which continue the last good one; else
        empty."""
        next_stamp, second_next = stamps[length : length + 2].tolist()
        is_early = self._stamp < next_stamp < second_next <= int(np.min(stamps[:length]))
        return EARLY if is_early else ""

    def _elapsed(self, stamps: IntArray, length: int) -> float:
        """Time [s] from the last good message to the first after these; infinite until the period is known."""
        return max(1e-9 * float(stamps[length] - self._stamp), (length + 1) * self._period)

    def _position_jumps(self, stamps: IntArray, numbers: FloatArray, length: int) -> str:
        """Describe a position that jumps away and back faster than the joint can move; empty if none does."""
        last, reach = self._last[-1], self._elapsed(stamps, length) * self._speed
        away, back, later = numbers[:length], numbers[length], numbers[length + 1]
        far = np.min(np.minimum(self._size(away[:, 0] - last[0]), self._size(away[:, 0] - back[0])), axis=0)
        jumps = far > reach
        jumps &= self._size(back[0] - last[0]) < reach
        jumps &= self._size(later[0] - last[0]) < 2.0 * reach
        jumps &= far > CLEAR_RATIO * np.maximum(self._largest_step(self._last), self._largest_step(numbers[length:]))
        return (
            f"position of '{self._joints[int(np.argmax(jumps))]}' jumps, and back, faster than it can move"
            if jumps.any()
            else ""
        )

    def _position_leaps(self, stamps: IntArray, numbers: FloatArray) -> bool:
        """True if a position continues elsewhere, farther than the joint can move."""
        reach = self._elapsed(stamps, 0) * self._speed
        far = self._size(numbers[0, 0] - self._last[-1, 0])
        largest_step = np.maximum(self._largest_step(self._last), self._largest_step(numbers))
        return bool(np.any((far > reach) & (far > CLEAR_RATIO * largest_step)))

    def _effort_spikes(self, numbers: FloatArray, length: int) -> str:
        """Name the effort that leaves its usual range and returns; empty if none does."""
        last, away, back, later = self._last[-1, 2], numbers[:length, 2], numbers[length, 2], numbers[length + 1, 2]
        height = np.min(np.minimum(np.abs(away - last), np.abs(away - back)), axis=0)
        spikes = height > self._efforts.least
        spikes &= np.maximum(np.abs(back - last), np.abs(later - last)) < height / CLEAR_RATIO
        return f"effort of '{self._joints[int(np.argmax(spikes))]}'" if spikes.any() else ""

    def _largest_step(self, numbers: FloatArray) -> FloatArray:
        """Largest step between consecutive positions ``(joints,)``: a fast joint may exceed its assumed limit."""
        moved = self._size(numbers[1:, 0] - numbers[:-1, 0])
        return np.asarray(np.max(moved, axis=0, initial=0.0))

    def _clock_was_set(self, stamps: IntArray, numbers: FloatArray) -> bool:
        """True if the stamps step but the motion shows that one period passed, and the stamps go on as before."""
        period, count = self._period, AHEAD + 1
        periods = 1e-9 * np.diff(stamps)
        step = 1e-9 * float(stamps[0] - self._stamp)
        if not _LEAST_SET < abs(step - period) < np.inf or min(len(self._stamps), len(self._last), len(stamps)) < count:
            return False
        if np.any((periods < period / CLEAR_RATIO) | (periods > _USUAL_STEP * period)):
            return False
        before = self._last[-count:, 0]
        relative = np.concatenate([before, numbers[:, 0]]) - before[-1]
        relative -= self._turn * np.round(relative / tau)
        end = _edge_state(self._stamps[-count:] - self._stamps[-1], relative[:count])
        start = _edge_state(stamps - stamps[0], relative[count:])
        return _chi_square(end, start, step) > _chi_square(end, start, period) + _MUCH_LESS_LIKELY


def _edge_state(stamps: IntArray, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Position and velocity at time zero and their variances, each ``(2, joints)``, of parabolas through
    ``positions (N, joints)``."""
    terms = np.vander(1e-9 * stamps, 3, increasing=True)
    coefficients, *_ = np.linalg.lstsq(terms, positions, rcond=None)
    noise = np.sum((positions - terms @ coefficients) ** 2, axis=0) / (len(stamps) - 3) + BEST_POSITION_ACCURACY**2
    variances = np.diag(np.linalg.inv(terms.T @ terms))
    return coefficients[:2], variances[:2, None] * noise


def _chi_square(end: tuple[FloatArray, FloatArray], start: tuple[FloatArray, FloatArray], time: float) -> float:
    """Chi square, summed over joints, of the hypothesis that ``time`` [s] passed between the end of one motion and the
    start of the next. The displacement is predicted with the mean of the velocities."""
    (x, v), (var_x, var_v) = end
    (next_x, next_v), (next_var_x, next_var_v) = start
    error = next_x - x - 0.5 * time * (v + next_v)
    return float(np.sum(error**2 / (var_x + next_var_x + 0.25 * time**2 * (var_v + next_var_v))))
