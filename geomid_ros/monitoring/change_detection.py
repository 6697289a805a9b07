"""CUSUM change detector: tests by the recursive residuals of every channel whether the robot has changed.

Least squares leave a sum of squares of the rows ``[A b]`` of one channel. Every block of new rows adds
``e^T (I + A P A^T)^-1 e`` to it, with e the errors of the prediction from the rows before and P its covariance
(recursive residuals; Brown, Durbin, Evans 1975). A new motion that excites new parameters adds no more than noise does,
however wrong the estimate was before; a changed robot adds more. No prior takes part.

No model is perfect. Its remainder is largest in motions unlike those before, to which least squares have fitted it.
Such blocks have a high leverage ``tr(A P A^T)``: they are learned from, but not tested. If most blocks are such, the
motion is of another kind, and the last blocks of the one before are forgotten. A motion that returns is no gap either:
for some twenty minutes, the noise floor is the highest of all stretches in which it was learned. Rows of a joint that
is slow, at rest or near a reversal, where dry friction is undetermined, must not be passed in: they differ more between
motions than a changed robot does.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from geomid_ros.estimation.channel_products import triangular, usable
from geomid_ros.estimation.estimate import STDS_OF_95
from geomid_ros.estimation.identifier import LONGEST_STEP
from geomid_ros.geometry import spd
from geomid_ros.model.channels import Channel
from geomid_ros.model.measurement_model import MeasurementModel, Rows
from geomid_ros.monitoring.payload_watch import REMEMBERED, ChannelNoise, PayloadWatch
from geomid_ros.signals.settings import MOST_WAITING_BYTES
from geomid_ros.types import FloatArray, IntArray

BLOCK = 40
"""Rows that are tested together: five periods of the filter's cutoff, if messages are frequent enough."""
PART = BLOCK // 4
"""Rows between searches for a payload."""
LATE = 2 * BLOCK
"""Rows before a suspect block that may be changed, too: a change in the last rows of a block does not show there, and
hardly in the next one, where an offset may explain it."""
ALARM = -float(np.log(1e-7))
"""Log evidence that opens or closes a gap. At most a fraction exp(-ALARM) of a channel's blocks opens one if its noise
is unchanged."""
_UNSETTLED = (REMEMBERED * PART + LATE) // BLOCK  # blocks that a payload may turn out to have been carried in
_FEWEST = 10  # rows for each parameter, which are not independent, and then blocks, before there is a noise floor
_MOST_BLOCKS = 60  # blocks of a stretch, about a minute
_RISE = 2.25  # times the noise floor: the gap that the test detects; times the mean leverage: another motion
_FEWEST_BAD = 3  # least number of blocks that open or close a gap: a push or a bump is none
_LEAST = 1e-4  # of a target's or a column's RMS; below, rounding and the filter's ripple dominate


_Sample: TypeAlias = tuple[int, int, FloatArray, FloatArray]
"""Index of a sample, its stamp [ns], and its rows: coefficients ``(C, D)`` and targets ``(C,)``."""


@dataclass(frozen=True)
class ChannelGap:
    """State of a monitored channel.

    ``times_floor``: RMS of its last residuals in units of the noise floor; ``since``: stamp [ns] since which there is a
    gap, None if there is none; ``first_sample``: index of the sample at that stamp.
    """

    channel: str
    times_floor: float
    since: int | None
    first_sample: int


class ChangeDetector:
    """Learns the noise floor from the first rows, and then detects which channels have changed.

    A change that a payload explains is no gap. While a payload is carried, gaps are not looked for: the load changes
    the model's remainder.

    One thread may call :meth:`add` while another calls everything else.
    """

    def __init__(
        self, channels: Sequence[Channel], forgetting_time: float = np.inf, payload: PayloadWatch | None = None
    ) -> None:
        """
        Args:
            channels: channels of the model, in the order of its rows.
            forgetting_time: [s] in which the noise floor is forgotten, but not before it is known.
            payload: looks for a payload in the same rows.
        """
        self.payload = payload
        self._forgetting_time = forgetting_time
        self._channels = [_Cusum(channel, forgetting_time) for channel in channels]
        bytes_per_sample = 8 * len(channels) * max((int(np.max(c.columns, initial=0)) + 2 for c in channels), default=1)
        most = max(BLOCK, MOST_WAITING_BYTES // bytes_per_sample)
        self._waiting: deque[_Sample] = deque(maxlen=most)
        self._block: list[_Sample] = []  # beginning of the next block, as payloads are searched for more often
        self._disturbed = False  # True if a payload was picked up or put down in it
        self.gaps: tuple[ChannelGap, ...] = ()
        """Monitored channels as of the last block."""
        self.searched_until = 0
        """Index of the first sample that was not searched for a payload yet."""
        self.searched_stamp = 0
        """Stamp [ns] of the last sample that was."""

    def add(self, first: int, stamps: IntArray, rows: Rows) -> bool:
        """Take the rows of a moving robot, in the order of time. If too many wait, the first are dropped. Return True
        if at least :data:`PART` rows wait.

        Args:
            first: index of the first sample.
            stamps: ``(N,)`` [ns].
            rows: rows of the ``N`` samples, with NaN for uninformative targets: see
                :meth:`~geomid_ros.estimation.identifier.Identifier.add`.
        """
        indices = range(first, first + len(stamps))
        self._waiting.extend(zip(indices, stamps.tolist(), rows.coefficients, rows.targets, strict=True))
        return len(self._waiting) >= PART

    def test(self) -> bool:
        """Test rows up to the end of the next block. Return True if there were enough of them."""
        while len(self._waiting) >= PART:
            self._block += [self._waiting.popleft() for _ in range(PART)]
            self._judge_payload(*_stacked(self._block[-PART:]))
            self.searched_until, self.searched_stamp = self._block[-PART][0] + PART, self._block[-1][1]
            if len(self._block) >= BLOCK:
                block, self._block = self._block, []
                self._judge_channels(*_stacked(block))
                return True
        return False

    def _judge_payload(self, first: int, stamps: IntArray, rows: Rows) -> None:
        if self.payload is None:
            return
        retained = float(np.exp(-1e-9 * float(stamps[-1] - stamps[0]) / self._forgetting_time))
        noise = [channel.noise for channel in self._channels]
        if self.payload.update(first, stamps, rows, noise, retained):
            self._disturbed = True
            began = first if self.payload.payload is None else self.payload.payload.first_sample
            for channel in self._channels:
                channel.clear_suspicion(began - LATE)

    def _judge_channels(self, first: int, stamps: IntArray, rows: Rows) -> None:
        disturbed, self._disturbed = self._disturbed, False
        if not disturbed and (self.payload is None or self.payload.payload is None):
            for index, channel in enumerate(self._channels):
                channel.judge(first, stamps, rows.coefficients[:, index], rows.targets[:, index])
        self.gaps = tuple(channel.gap for channel in self._channels if channel.ready)

    @property
    def changes(self) -> list[tuple[int, int]]:
        """Stamps [ns] and sample indices since which gaps are open, any payload is carried, and the present one is."""
        changes = [(gap.since, gap.first_sample) for gap in self.gaps if gap.since is not None]
        if (carried := None if self.payload is None else self.payload.payload) is not None:
            changes += [(stamp, carried.first_sample) for stamp in (carried.picked_up, carried.since)]
        return changes

    @property
    def weighed_before(self) -> int:
        """Index of the sample before which it is known that no payload was carried since the last one was put down."""
        if self.payload is not None and self.payload.payload is not None:
            return self.payload.payload.first_sample - LATE
        noticed = self.payload is not None and self.payload.notices
        return self.searched_until - (REMEMBERED * PART + LATE) * noticed

    def unchanged_before(self, channels: Sequence[int]) -> int:
        """Return the index of the sample before which these channels are known to be unchanged, without a payload.

        Later rows are untested, suspect, or in an open gap. An unconfirmed suspicion is forgotten after some blocks, so
        the index is never further back than that.
        """
        suspect = [self._channels[index].first_suspect for index in channels]
        judged = self._block[0][0] if self._block else self.searched_until
        begin = min([judged, *(first for first in suspect if first is not None)])
        return max(min(begin - LATE, self.weighed_before), judged - REMEMBERED * BLOCK)


def _stacked(samples: Sequence[_Sample]) -> tuple[int, IntArray, Rows]:
    """Index of the first of N samples, all stamps ``(N,)`` and all rows."""
    indices, stamps, coefficients, targets = zip(*samples, strict=True)
    return indices[0], np.array(stamps), Rows(np.array(coefficients), np.array(targets))


class _Normal(NamedTuple):
    """Noise floor: the mean energy per row of a block, and the shape of the energies' Gamma distribution."""

    level: float
    shape: float


class _Cusum:
    """One-sided cumulative sum test (Page 1954) of one channel: have the errors of its blocks risen by ``_RISE``?

    A block's energy per row is modelled as Gamma-distributed, with the mean of the blocks before and a shape from their
    variance. This allows for noise that is correlated or differs between parts of the motion. Then the mean time
    between false alarms is at least ``exp(ALARM)`` blocks (Lorden 1971). The evidence of a block is limited to a
    fraction of the alarm, which makes them rarer. A gap closes as it opened: by as much evidence for the contrary.
    """

    def __init__(self, channel: Channel, forgetting_time: float) -> None:
        self._channel = channel
        self._forgetting_time = forgetting_time
        self._factor = np.zeros((0, len(channel.columns) + 1))
        self._settled = self._factor  # without the blocks that may be taken back
        self._unsettled: deque[tuple[int, FloatArray]] = deque()  # index of the first sample, and rows
        self._rows = 0.0  # sum of their remaining weights
        self._last_stamp: int | None = None
        self._energies: deque[float] = deque(maxlen=_MOST_BLOCKS)
        self._learned = 0  # number of energies of this stretch
        self._earlier: deque[_Normal] = deque(maxlen=REMEMBERED)  # noise floors of earlier stretches
        self._suspect: deque[tuple[int, float, FloatArray, bool]] = deque(maxlen=REMEMBERED)
        # index of the first sample, energy, rows, True if typical
        self._ratios: deque[float] = deque(maxlen=_FEWEST_BAD)
        self._unlike: deque[bool] = deque(maxlen=_FEWEST)  # True for blocks of another motion
        self._evidence = 0.0  # log evidence for an opening or, if open, for its end
        self._since = self._first = 0
        self._open = False

    @property
    def ready(self) -> bool:
        """True if the noise floor is known."""
        return len(self._energies) >= _FEWEST

    @property
    def gap(self) -> ChannelGap:
        """State after the last block."""
        size = float(np.sqrt(np.mean(self._ratios))) if self._ratios else 1.0
        return ChannelGap(self._channel.name, size, self._since if self._open else None, self._first)

    @property
    def first_suspect(self) -> int | None:
        """Index of the first sample that is, or may be, in a gap; None if there is none."""
        return self._first if self._open or self._evidence > 0.0 else None

    @property
    def noise(self) -> ChannelNoise:
        """Noise floor as noise of independent rows."""
        level, shape = self._normal if self.ready else _Normal(0.0, 0.0)
        return ChannelNoise(level, 2.0 * shape / BLOCK) if level > 0.0 else ChannelNoise(1.0, 0.0)

    def clear_suspicion(self, began: int) -> None:
        """Close a gap that opened at sample ``began`` or later, and forget suspect rows and those learned since then:
        something else explains them."""
        self._open, self._evidence = self._open and self._first < began, 0.0
        self._suspect.clear()
        self._ratios.clear()
        while self._unsettled and self._unsettled[-1][0] + BLOCK > began:
            self._rows -= len(self._unsettled.pop()[1])
            self._factor = triangular(np.concatenate([self._settled, *(rows for _, rows in self._unsettled)]))

    @property
    def _moves_otherwise(self) -> bool:
        """True if the motion is of another kind, not only single blocks of it."""
        return 2 * sum(self._unlike) >= _FEWEST

    def judge(self, first: int, stamps: IntArray, coefficients: FloatArray, targets: FloatArray) -> None:
        """Test a block, ``stamps (N,)``, ``coefficients (N, D)`` and ``targets (N,)``; ``first`` is the index of its
        first sample."""
        retained = self._remaining(stamps)
        measured = usable(coefficients, targets)
        rows = np.column_stack([coefficients[:, self._channel.columns], targets])[measured]
        if len(rows) < BLOCK // 2:
            return
        moved_otherwise = self._moves_otherwise
        self._unlike.append(self.ready and self._leverage(rows[:, :-1]) > _RISE)
        self._factor, self._rows = np.sqrt(retained) * self._factor, retained * self._rows
        if retained < 1.0:
            self._settled = np.sqrt(retained) * self._settled
            self._unsettled = deque((begin, np.sqrt(retained) * old) for begin, old in self._unsettled)
            self._earlier = deque((_Normal(retained * floor.level, floor.shape) for floor in self._earlier), REMEMBERED)
        joined = triangular(np.concatenate([self._factor, rows]))
        energy = max(_unexplained(joined) - _unexplained(self._factor), 0.0) / len(rows)
        if self.ready and not self._unlike[-1] and not self._moves_otherwise:
            self._test(energy, first, int(stamps[0]))
        self._suspect.append((first, energy, rows, self._moves_otherwise or not self._unlike[-1]))
        if self._open:
            self._suspect.clear()
        elif self._evidence == 0.0 or self._moves_otherwise:
            self._evidence = 0.0
            self._learn(joined)
            if self._moves_otherwise and not moved_otherwise:
                self._energies.clear()
                self._learned = 0
        if self._open and np.isfinite(self._forgetting_time):
            self._factor = joined

    def _learn(self, joined: FloatArray) -> None:
        """Learn from suspect blocks as normal ones; ``joined`` is the factor with the last one."""
        alone = len(self._suspect) == 1
        while self._suspect:
            first, energy, rows, is_typical = self._suspect.popleft()
            if is_typical and self._rows >= _FEWEST * len(self._channel.columns):
                self._energies.append(energy)
                self._learned += 1
                if self._learned % _MOST_BLOCKS == 0:
                    self._earlier.append(self._recent)
            self._factor = joined if alone else triangular(np.concatenate([self._factor, rows]))
            self._rows += len(rows)
            self._unsettled.append((first, rows))
            if len(self._unsettled) > _UNSETTLED:
                self._settled = triangular(np.concatenate([self._settled, self._unsettled.popleft()[1]]))

    def _leverage(self, coefficients: FloatArray) -> float:
        """Mean leverage of new rows ``(N, d)`` relative to that of the rows before."""
        factor = self._factor[:, :-1]
        information = factor.T @ factor
        squares = np.diag(information)
        floor = _LEAST**2 * squares + np.finfo(float).eps * np.max(squares, initial=np.finfo(float).tiny)
        covariance = spd.inverse(information + np.diag(floor))
        new, old = np.sum((coefficients @ covariance) * coefficients), np.sum(information * covariance)
        return float(new / len(coefficients) / (old / self._rows))

    def _remaining(self, stamps: IntArray) -> float:
        """Weight that the rows before retain, bounded so that the noise floor stays known."""
        previous, self._last_stamp = self._last_stamp, int(stamps[-1])
        steps = np.diff(stamps, prepend=stamps[0] if previous is None else previous) * 1e-9
        elapsed = float(np.sum(np.clip(steps, 0.0, LONGEST_STEP)))
        fewest = 2.0 * _FEWEST * max(len(self._channel.columns), 1)
        return max(float(np.exp(-elapsed / self._forgetting_time)), 1.0 - BLOCK / fewest)

    def _test(self, energy: float, first: int, stamp: int) -> None:
        level, shape = self._normal
        if level == 0.0:  # all that was measured is zero
            return
        self._ratios.append(energy / level)
        highest = level * (1.0 + STDS_OF_95 / np.sqrt(shape * len(self._energies)))
        rise = shape * (energy / highest * (1.0 - 1.0 / _RISE**2) - 2.0 * np.log(_RISE))
        if not self._open and self._evidence == 0.0:
            self._first, self._since = first, stamp
        self._evidence = max(0.0, self._evidence + min(-rise if self._open else rise, ALARM / _FEWEST_BAD))
        if self._evidence >= ALARM:
            self._open, self._evidence = not self._open, 0.0

    @property
    def _normal(self) -> _Normal:
        """Noise floor of the last blocks, or of an earlier stretch if its motion left more."""
        return max([self._recent, *self._earlier])

    @property
    def _recent(self) -> _Normal:
        """Noise floor of the last blocks."""
        smallest = _LEAST**2 * float(np.sum(self._factor[:, -1] ** 2)) / self._rows
        level = max(float(np.mean(self._energies)), smallest)
        return _Normal(level, self._shape(level))

    def _shape(self, level: float) -> float:
        """Shape of the Gamma distribution, biased low, as few energies determine their variance only roughly."""
        variance = float(np.var(self._energies)) * (1.0 + 4.0 / np.sqrt(len(self._energies)))
        independent = 0.5 * BLOCK  # shape if all rows are independent
        return min(level**2 / variance, independent) if variance > 0.0 else independent


def _unexplained(factor: FloatArray) -> float:
    """Sum of squares that least squares leave, from the triangular factor of ``[A b]``."""
    return float(factor[-1, -1] ** 2) if len(factor) == factor.shape[1] else 0.0


def sensor_channels(model: MeasurementModel) -> dict[str, list[int]]:
    """Return the indices among the model's channels of each mounted sensor's axes, by its topic."""
    return {sensor.topic: list(model.layout.wrenches[sensor.topic]) for sensor in model.mounted}


def changed_sensors(gaps: Sequence[ChannelGap], model: MeasurementModel) -> dict[str, int] | None:
    """Return the mounted sensors that have changed.

    Other sensors and the joints depend on a payload, too. If any other channel has a gap, or no other is monitored, the
    robot may have changed instead.

    Args:
        gaps: states of the monitored channels.
        model: model with the sensors.

    Returns:
        For the topic of each changed sensor, the index of the sample before which it was unchanged; None if the robot
        may have changed.
    """
    mounted = _channels_by_topic(model)
    first = {gap.channel: gap.first_sample for gap in gaps if gap.since is not None}
    begin = {
        topic: min(first[name] for name in names if name in first) - LATE
        for topic, names in mounted.items()
        if not first.keys().isdisjoint(names)
    }
    other_channels = {gap.channel for gap in gaps}.difference(*mounted.values())
    return begin if other_channels and not robot_may_have_changed(gaps, model) else None


def robot_may_have_changed(gaps: Sequence[ChannelGap], model: MeasurementModel) -> bool:
    """True if there is a gap at a joint, or at several sensors. Joints that are not monitored yet show no gap."""
    mounted = _channels_by_topic(model)
    opened = {gap.channel for gap in gaps if gap.since is not None}
    return bool(opened.difference(*mounted.values())) or sum(map(bool, map(opened.intersection, mounted.values()))) > 1


def _channels_by_topic(model: MeasurementModel) -> dict[str, list[str]]:
    return {topic: [model.channels[place].name for place in places] for topic, places in sensor_channels(model).items()}
