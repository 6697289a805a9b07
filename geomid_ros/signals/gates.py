"""First stage of the pipeline: gates decide which messages are admitted, in their order of arrival.

A gate decides by the messages before and after. A message that continues the one before passes at once. Any other waits
until later ones show what it is: a short fault, a clock that was set, or something real, which passes. All later
messages, on any topic, wait behind it. So the stages after the gates see one sequence, however messages are batched.

The gate for joint messages also refuses those that contradict their neighbours or the URDF's limits. There, up to
:data:`AHEAD` more messages are waited for.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import tau
from typing import TypeAlias

import numpy as np

from geomid_ros.signals.clocks import FEWEST, steps
from geomid_ros.signals.effort_quality import SpikeHeights
from geomid_ros.signals.ledger import Reason, driver_error
from geomid_ros.signals.message_batch import NO_MESSAGES, MessageBatch
from geomid_ros.signals.messages import JOINT_STATES
from geomid_ros.signals.settings import (
    BEST_POSITION_ACCURACY,
    CLEAR_RATIO,
    LARGEST_SPEED_LIMIT,
    MESSAGES_UNTIL_DECISION,
    SHORTEST_CONTACT,
)
from geomid_ros.types import BoolArray, FloatArray, IntArray

NOT_LATER = Reason("stamp not later than the one before", "repeated")
FROM_THE_FUTURE, TOO_OLD = "stamp from the future", "stamp too old"
_REASONS = (NOT_LATER, FROM_THE_FUTURE, TOO_OLD)
PAUSE = "pause: a new segment begins"
SET_BACK = "clock set back: a new segment begins"
FEW = 3  # messages of the longest fault; so many in order, each after a pause, show a slow topic
_TO_CONFIRM_A_RESET = 10  # messages, as a few late ones do not mean that a clock was set back

Source: TypeAlias = tuple[str, tuple[str, ...]]
"""A topic, and for joint messages their joints."""


@dataclass(frozen=True)
class GateDecision:
    """Decision on the first ``count`` suspicious messages: ``refused`` for a reason, or real. ``noted`` is a remark on
    the first; if it ``begins`` a new segment, nothing is compared across it."""

    count: int
    refused: str = ""
    noted: str = ""
    begins: bool = False


class Gate:
    """Decides on the messages of one source by the order of their stamps.

    Decisions depend on the messages and their order of arrival, not on their batches. A stamp that is ahead by more
    than ``max_gap`` follows a pause if the next one is later by less than that or, on a slow topic, if two more are
    later. A stamp that is behind by more shows a clock that was set back if ten are in order.
    """

    def __init__(self, max_gap: int) -> None:
        """
        Args:
            max_gap: [ns] messages further apart are not compared.
        """
        self._max_gap = max_gap
        self.waiting = NO_MESSAGES
        """Messages without a decision."""
        self._decided = 0  # stamp of the last decided message that is good by itself
        self._stamp = 0  # of the last message that passed

    def decide(self, new: MessageBatch, newest: int) -> tuple[MessageBatch, dict[int, GateDecision]]:
        """Take messages, and decide on those that can be decided.

        Args:
            new: messages; none to look again at the waiting ones.
            newest: arrival index of the last message of all topics.

        Returns:
            Decided messages, refused ones with the reason; and remarks by the arrival index of their message.
        """
        arrived, notes = MessageBatch.joined([self.waiting, new]), dict[int, GateDecision]()
        good = np.flatnonzero(arrived.is_usable)
        repeated = steps(arrived.stamps[good], self._decided) == 0
        arrived.refusals[good[repeated]] = NOT_LATER
        places = good[~repeated]
        plain = arrived if len(places) == len(arrived) else arrived.select(places)
        stamps, numbers, order = plain.stamps, plain.numbers, plain.order
        place = self._pass_plain(stamps, numbers)
        while place < len(places):
            last = order[place] + MESSAGES_UNTIL_DECISION
            window = slice(place, place + int(np.searchsorted(order[place:], last, side="right")))
            answer = self._answer(stamps[window], numbers[window], final=newest >= last)
            if answer is None:
                break
            if answer.refused:
                arrived.refusals[places[place : place + answer.count]] = answer.refused
            else:
                if answer.noted:
                    notes[int(order[place])] = answer
                if answer.begins:
                    self._compare_anew()
                self._pass(stamps[place : place + 1], numbers[place : place + 1])
            place += answer.count
            place += self._pass_plain(stamps[place:], numbers[place:])
        end = int(places[place]) if place < len(places) else len(arrived)
        decided_indices = good[good < end]
        self._decided = int(arrived.stamps[decided_indices[-1]]) if len(decided_indices) else self._decided
        decided, self.waiting = arrived.split_after(end)
        return decided, notes

    def begin_anew(self, decided: MessageBatch) -> MessageBatch:
        """Reset the gate. Return the ``decided`` messages, which must be decided on again, and the waiting ones,
        without its refusals."""
        arrived = MessageBatch.joined([decided, self.waiting])
        self.waiting, self._stamp, self._decided = NO_MESSAGES, 0, 0
        arrived.refusals[[refusal in _REASONS for refusal in arrived.refusals]] = None
        return arrived

    def _pass_plain(self, stamps: IntArray, numbers: FloatArray) -> int:
        """Pass messages that continue those before, up to the first that does not. Return how many passed."""
        place = 0
        while place < len(stamps):
            if not self._stamp:  # the first message of all has none to continue
                self._pass(stamps[:1], numbers[:1])
                place = 1
            part = slice(place, place + self._room)
            stops = np.flatnonzero(self._suspicious(stamps[part], numbers[part]))
            count = int(stops[0]) if len(stops) else len(stamps[part])
            self._pass(stamps[place : place + count], numbers[place : place + count])
            place += count
            if len(stops):
                break
        return place

    @property
    def _room(self) -> int:
        """Number of messages that can be compared at once: until something is learned of them."""
        return MESSAGES_UNTIL_DECISION

    def _suspicious(self, stamps: IntArray, numbers: FloatArray) -> BoolArray:  # noqa: ARG002
        """True for messages ``(N,)`` that do not continue the one before, assuming that it passes."""
        ahead = steps(stamps, self._stamp)
        return (ahead <= 0) | (ahead > self._max_gap)

    def _pass(self, stamps: IntArray, numbers: FloatArray) -> None:  # noqa: ARG002 for gates that compare numbers
        """Record messages that pass: they continue the one before, or are real although they do not."""
        if len(stamps):
            self._stamp = int(stamps[-1])

    def _compare_anew(self) -> None:
        """Restart comparisons: the next message is not compared with earlier ones."""

    def _answer(self, stamps: IntArray, numbers: FloatArray, *, final: bool) -> GateDecision | None:  # noqa: ARG002
        """Decide on the first of these messages, which does not continue the one before. Return None if more messages
        are needed and this call is not ``final``."""
        first, *later = stamps.tolist()
        back = first <= self._stamp
        if self._stamp - self._max_gap <= first <= self._stamp:
            return GateDecision(1, refused=NOT_LATER)
        wrong = GateDecision(1, refused=TOO_OLD if back else FROM_THE_FUTURE)
        real = GateDecision(1, noted=SET_BACK, begins=True) if back else GateDecision(1, noted=PAUSE)
        last, count = first, 1
        for stamp in later:
            if (stamp >= self._stamp - self._max_gap) if back else (stamp < first - self._max_gap):
                return wrong
            if not back and first < stamp <= first + self._max_gap:
                return real
            last, count = (stamp, count + 1) if stamp > last else (last, count)
            if count == (_TO_CONFIRM_A_RESET if back else FEW):
                return real
        return None if not final else wrong if back and count == 1 else real


@dataclass(eq=False)
class ReorderBuffer:
    """Admits the messages of several sources, with a gate for each.

    Attributes:
        new_gate: makes the gate of a source.
        note: ``note(topic, remark)`` receives changes and doubts as they are found.
    """

    new_gate: Callable[[Source], Gate]
    note: Callable[[str, str], None]
    _gates: dict[Source, Gate] = field(default_factory=dict)
    _decided: dict[Source, MessageBatch] = field(default_factory=dict)  # decided ones that wait behind undecided ones
    _notes: dict[int, tuple[Source, GateDecision]] = field(default_factory=dict)  # by their message's arrival index

    @property
    def waiting_counts(self) -> Counter[str]:
        """Number of waiting messages by topic."""
        counts = Counter[str]()
        for source, gate in self._gates.items():
            counts[source[0]] += len(gate.waiting) + len(self._decided[source])
        return counts

    def take(self, new: Mapping[Source, MessageBatch], newest: int) -> list[dict[Source, MessageBatch]]:
        """Take messages, and release those that are decided.

        Args:
            new: messages of each source, in their order of arrival.
            newest: arrival index of the last message of any source.

        Returns:
            The released messages; each part after the first begins a new segment, as a clock was set or positions
            leapt.
        """
        for source in [source for source in new if source not in self._gates]:
            self._gates[source], self._decided[source] = self.new_gate(source), NO_MESSAGES
        for source in self._gates:
            self._decide(source, new.get(source, NO_MESSAGES), newest)
        parts = []
        while (place := self._change(newest)) < self._end(newest):
            parts.append(self._before(place))
            changed, answer = self._notes.pop(place)
            self.note(changed[0], answer.noted)
            self._reconsider(changed, place, newest)
        return [*parts, self._before(self._end(newest))]

    def give_up(self) -> Counter[str]:
        """Drop the undecided messages, so that others no longer wait for them. Return their numbers by topic."""
        dropped = Counter[str]()
        for source, gate in self._gates.items():
            dropped[source[0]] += len(gate.waiting)
            gate.waiting = NO_MESSAGES
        return dropped

    def _change(self, newest: int) -> int:
        """Arrival index of the first message that begins a new segment."""
        return min((place for place, (_, answer) in self._notes.items() if answer.begins), default=newest + 1)

    def _end(self, newest: int) -> int:
        """Arrival index of the first undecided message."""
        waiting = [gate.waiting.order for gate in self._gates.values()]
        return min((int(order[0]) for order in waiting if len(order)), default=newest + 1)

    def _decide(self, source: Source, arrived: MessageBatch, newest: int) -> None:
        decided, notes = self._gates[source].decide(arrived, newest)
        self._notes |= {place: (source, answer) for place, answer in notes.items()}
        self._decided[source] = MessageBatch.joined([self._decided[source], decided])

    def _reconsider(self, changed: Source, place: int, newest: int) -> None:
        """Decide again on messages of other topics since a clock was set, as they may have the same clock."""
        for source, gate in self._gates.items():
            if source[0] in (changed[0], JOINT_STATES):  # joint states show their clock by the motion
                continue
            self._decided[source], since = self._decided[source].split(place)
            self._notes = {other: entry for other, entry in self._notes.items() if entry[0] != source}
            self._decide(source, gate.begin_anew(since), newest)

    def _before(self, place: int) -> dict[Source, MessageBatch]:
        """Release the decided messages that arrived before this one."""
        for noted in sorted(index for index in self._notes if index < place):
            (topic, _), answer = self._notes.pop(noted)
            self.note(topic, answer.noted)
        released = {}
        for source, decided in self._decided.items():
            released[source], self._decided[source] = decided.split(place)
        return released


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
