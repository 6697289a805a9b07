"""CUSUM change detector: is the robot still what it was, judged by the recursive residuals of every channel.

Least squares leave a sum of squares of the rows ``[A b]`` of one channel. Every block of new rows adds
``e^T (I + A P A^T)^-1 e`` to it, with e the errors of the prediction from the rows before and P its covariance
(recursive residuals; Brown, Durbin, Evans 1975). A new motion that shows new parameters adds no more than noise does,
however wrong the estimate was before; a robot that has changed adds more. No prior takes part.

No model is perfect, and what it lacks shows most where a motion is unlike those before, along which least squares have
fitted it away. Such blocks are told by their leverage ``tr(A P A^T)``; they teach what is normal, and are not judged.
When most are so, the motion is of another kind, and the last blocks of the one before are forgotten. A motion that
returns is no gap either: of the stretches in which it was learned what is normal, the one that left most counts, for
some twenty minutes. Rows of a joint at rest or near a reversal, where dry friction may be anything, are not to be
given.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from geomid_ros.estimation.channel_products import triangular, usable
from geomid_ros.estimation.identifier import LONGEST_STEP
from geomid_ros.estimation.uncertain_inertia import STDS_OF_95
from geomid_ros.geometry import definite
from geomid_ros.model.channels import Channel
from geomid_ros.model.measurement import MeasurementModel, Rows
from geomid_ros.monitoring.payload_watch import REMEMBERED, Noise, PayloadWatch
from geomid_ros.signals.settings import MOST_WAITING_BYTES
from geomid_ros.types import FloatArray, IntArray

BLOCK = 40
"""Rows that are judged together: five periods of the filter's cutoff, where the messages are frequent enough."""
PART = BLOCK // 4
"""Rows after which a payload is looked for."""
LATE = 2 * BLOCK
"""Rows before a suspect block that may be bad, too: a change in the last rows of a block does not show there, and
hardly in the next where an offset may explain it."""
ALARM = -float(np.log(1e-7))
"""The evidence that opens or closes a gap: of all blocks of a channel whose noise is what it was, no larger share than
exp(-ALARM) opens one."""
_FEWEST = 10  # rows for each parameter, which are not independent, and then blocks, before there is a floor
_MOST_BLOCKS = 60  # of a stretch: a minute or so
_RISE = 2.25  # times the floor: the gap that the test looks for; and times the usual leverage: another motion
_FEWEST_BAD = 3  # blocks that an alarm takes, and its end: a push or a bump is no gap
_LEAST = 1e-4  # of what is measured, or of what a motion shows: below, rounding and the filter's ripple count


@dataclass(frozen=True)
class ChannelGap:
    """A monitored channel.

    ``times_floor`` is the root mean square of its last residuals in units of the noise floor, ``since`` the stamp [ns]
    since which that is a gap, None if it is none, and ``first`` the number of the instant at that stamp.
    """

    channel: str
    times_floor: float
    since: int | None
    first: int = 0


class ChangeDetector:
    """Learns from the first rows what is normal, and from then on tells which channels have changed.

    What a payload explains is no gap. While one is carried, gaps are not looked for: a load shows what the model lacks
    under loads.

    One thread may call :meth:`add` while another calls everything else.
    """

    def __init__(
        self, channels: Sequence[Channel], forgetting_time: float = np.inf, payload: PayloadWatch | None = None
    ) -> None:
        """
        Args:
            channels: of the model, in the order of its rows.
            forgetting_time: [s] in which what is normal is forgotten, but not before it is known.
            payload: looks for a payload in the same rows.
        """
        self.payload = payload
        self._forgetting_time = forgetting_time
        self._channels = [_Cusum(channel, forgetting_time) for channel in channels]
        instant = 8 * len(channels) * max((int(np.max(c.columns, initial=0)) + 2 for c in channels), default=1)
        most = max(BLOCK, MOST_WAITING_BYTES // instant)
        self._waiting: deque[tuple[int, int, FloatArray, FloatArray]] = deque(maxlen=most)
        self._parts: list[_Block] = []  # of the next block, as a payload is to be known soon
        self._disturbed = False  # whether a payload came or went in it
        self.gaps: tuple[ChannelGap, ...] = ()
        """The monitored channels as of the last block."""
        self.judged = 0
        """The number of the first instant in which no payload was looked for yet."""

    def add(self, first: int, stamps: IntArray, rows: Rows) -> bool:
        """Take the rows of a moving robot, in the order of time. Of those that nobody judges the last are kept. Returns
        whether a whole block waits.

        Args:
            first: the number of the first instant; instants are counted.
            stamps: ``(N,)`` [ns].
            rows: of the ``N`` instants, with NaN for targets that tell nothing of the robot: see
                :meth:`~geomid_ros.estimation.identifier.Identifier.add`.
        """
        numbers = range(first, first + len(stamps))
        self._waiting.extend(zip(numbers, stamps.tolist(), rows.coefficients, rows.targets, strict=True))
        return len(self._waiting) >= PART

    def judge(self) -> bool:
        """Judge rows up to the end of the next block. Returns whether there were enough of them."""
        while len(self._waiting) >= PART:
            self._parts.append(self._next())
            self._judge_payload(self._parts[-1])
            self.judged = self._parts[-1].first + PART
            if len(self._parts) * PART == BLOCK:
                self._judge_channels()
                return True
        return False

    def _next(self) -> _Block:
        part = (self._waiting.popleft() for _ in range(PART))
        numbers, stamps, coefficients, targets = zip(*part, strict=True)
        return _Block(numbers[0], np.array(stamps), Rows(np.array(coefficients), np.array(targets)))

    def _judge_payload(self, part: _Block) -> None:
        if self.payload is None:
            return
        share = float(np.exp(-1e-9 * float(part.stamps[-1] - part.stamps[0]) / self._forgetting_time))
        noise = [channel.noise for channel in self._channels]
        if self.payload.judge(*part, noise, share):
            self._disturbed = True
            began = part.first if self.payload.carried is None else self.payload.carried.first
            for channel in self._channels:
                channel.clear_suspicion(began - LATE)

    def _judge_channels(self) -> None:
        first, stamps, rows = _Block.joined(self._parts)
        self._parts.clear()
        disturbed, self._disturbed = self._disturbed, False
        if not disturbed and (self.payload is None or self.payload.carried is None):
            for index, channel in enumerate(self._channels):
                channel.judge(first, stamps, rows.coefficients[:, index], rows.targets[:, index])
        self.gaps = tuple(channel.gap for channel in self._channels if channel.ready)

    @property
    def changes(self) -> list[tuple[int, int]]:
        """Stamps [ns] and numbers of the instants since which gaps are open, or a payload is carried."""
        changes = [(gap.since, gap.first) for gap in self.gaps if gap.since is not None]
        carried = None if self.payload is None else self.payload.carried
        return changes if carried is None else [*changes, (carried.since, carried.first)]

    def normal(self, channels: Sequence[int]) -> int:
        """The number of the instant before which these channels are known not to have changed.

        The rows after it are still to be judged, suspect, or of an open gap. A suspicion that was not confirmed is
        forgotten after some blocks, so the instant is never further back than that.
        """
        suspect = [self._channels[index].first_suspect for index in channels]
        judged = self._parts[0].first if self._parts else self.judged
        begin = min([judged, *(first for first in suspect if first is not None)])
        return max(begin - LATE, judged - REMEMBERED * BLOCK)


class _Block(NamedTuple):
    """Rows, their ``stamps``, and the number of the ``first`` instant."""

    first: int
    stamps: IntArray
    rows: Rows

    @staticmethod
    def joined(parts: Sequence[_Block]) -> _Block:
        """The rows of all ``parts``."""
        columns = zip(*(vars(part.rows).values() for part in parts), strict=True)
        stamps = np.concatenate([part.stamps for part in parts])
        return _Block(parts[0].first, stamps, Rows(*map(np.concatenate, columns)))


class _Normal(NamedTuple):
    """What is normal: the mean energy per row of a block, and the shape of the energies' Gamma distribution."""

    level: float
    shape: float


class _Cusum:
    """A one-sided cumulative sum test (Page 1954) of one channel: have the errors of its blocks risen by ``_RISE``?

    A block's energy per row is taken to be Gamma-distributed, with the mean of the blocks before and a shape by their
    variance, which allows for noise that is correlated or differs between parts of the motion. Where that holds, the
    mean time between false alarms is at least ``exp(ALARM)`` blocks (Lorden 1971). A block counts for no more
    than a share of the alarm, which makes them rarer. An alarm ends as it began: by as much evidence for the contrary.
    """

    def __init__(self, channel: Channel, forgetting_time: float) -> None:
        self._channel = channel
        self._forgetting_time = forgetting_time
        self._factor = np.zeros((0, len(channel.columns) + 1))
        self._rows = 0.0  # by what is left of their weight
        self._last_stamp: int | None = None
        self._energies: deque[float] = deque(maxlen=_MOST_BLOCKS)
        self._learned = 0  # energies of the stretch
        self._earlier: deque[_Normal] = deque(maxlen=REMEMBERED)  # stretches
        self._suspect: deque[tuple[float, FloatArray, bool]] = deque(maxlen=REMEMBERED)  # whether energies are usual
        self._ratios: deque[float] = deque(maxlen=_FEWEST_BAD)
        self._unlike: deque[bool] = deque(maxlen=_FEWEST)  # whether blocks were of another motion
        self._evidence = 0.0  # for an opening, or, when it is open, for its end
        self._since = self._first = 0
        self._open = False

    @property
    def ready(self) -> bool:
        """Whether it is known what is normal."""
        return len(self._energies) >= _FEWEST

    @property
    def gap(self) -> ChannelGap:
        """The state after the last block."""
        size = float(np.sqrt(np.mean(self._ratios))) if self._ratios else 1.0
        return ChannelGap(self._channel.name, size, self._since if self._open else None, self._first)

    @property
    def first_suspect(self) -> int | None:
        """The number of the first instant that is in a gap, or may be; None if there is none."""
        return self._first if self._open or self._evidence > 0.0 else None

    @property
    def noise(self) -> Noise:
        """What is normal, as noise."""
        level, shape = self._normal if self.ready else _Normal(0.0, 0.0)
        return Noise(level, 2.0 * shape / BLOCK) if level > 0.0 else Noise()

    def clear_suspicion(self, began: int) -> None:
        """Close a gap that opened at the instant of number ``began`` or later, and forget rows that are not known to be
        normal: something else explains them."""
        self._open, self._evidence = self._open and self._first < began, 0.0
        self._suspect.clear()
        self._ratios.clear()

    @property
    def _moves_otherwise(self) -> bool:
        """Whether the motion is another than before, not a block of it here and there."""
        return 2 * sum(self._unlike) >= _FEWEST

    def judge(self, first: int, stamps: IntArray, coefficients: FloatArray, targets: FloatArray) -> None:
        """Take a block, ``stamps (N,)``, ``coefficients (N, D)`` and ``targets (N,)``, whose first instant has number
        ``first``."""
        share = self._remaining(stamps)
        measured = usable(coefficients, targets)
        rows = np.column_stack([coefficients[:, self._channel.columns], targets])[measured]
        if len(rows) < BLOCK // 2:
            return
        moved_otherwise = self._moves_otherwise
        self._unlike.append(self.ready and self._leverage(rows[:, :-1]) > _RISE)
        self._factor, self._rows = np.sqrt(share) * self._factor, share * self._rows
        if share < 1.0:
            self._earlier = deque((_Normal(share * each.level, each.shape) for each in self._earlier), REMEMBERED)
        joined = triangular(np.concatenate([self._factor, rows]))
        energy = max(_unexplained(joined) - _unexplained(self._factor), 0.0) / len(rows)
        if self.ready and not self._unlike[-1] and not self._moves_otherwise:
            self._test(energy, first, int(stamps[0]))
        self._suspect.append((energy, rows, self._moves_otherwise or not self._unlike[-1]))
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

    def _learn(self, with_last: FloatArray) -> None:
        """Take what was suspect as normal; ``with_last`` is the factor that the last block alone would lead to."""
        alone = len(self._suspect) == 1
        while self._suspect:
            energy, rows, is_usual = self._suspect.popleft()
            if is_usual and self._rows >= _FEWEST * len(self._channel.columns):
                self._energies.append(energy)
                self._learned += 1
                if self._learned % _MOST_BLOCKS == 0:
                    self._earlier.append(self._recent)
            self._factor = with_last if alone else triangular(np.concatenate([self._factor, rows]))
            self._rows += len(rows)

    def _leverage(self, coefficients: FloatArray) -> float:
        """The mean leverage of new rows ``(N, d)``, over that of the rows before."""
        known = self._factor[:, :-1]
        information = known.T @ known
        squares = np.diag(information)
        floor = _LEAST**2 * squares + np.finfo(float).eps * np.max(squares, initial=np.finfo(float).tiny)
        covariance = definite.inverse(information + np.diag(floor))
        new, old = np.sum((coefficients @ covariance) * coefficients), np.sum(information * covariance)
        return float(new / len(coefficients) / (old / self._rows))

    def _remaining(self, stamps: IntArray) -> float:
        """The weight that the rows before keep, bounded so that enough is known of what is normal."""
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
        """That of the last blocks, or of an earlier stretch where the motion left more."""
        return max([self._recent, *self._earlier])

    @property
    def _recent(self) -> _Normal:
        """That of the last blocks."""
        smallest = _LEAST**2 * float(np.sum(self._factor[:, -1] ** 2)) / self._rows
        level = max(float(np.mean(self._energies)), smallest)
        return _Normal(level, self._shape(level))

    def _shape(self, level: float) -> float:
        """The Gamma distribution's shape, rather too small, as few energies tell their variance only roughly."""
        variance = float(np.var(self._energies)) * (1.0 + 4.0 / np.sqrt(len(self._energies)))
        independent = 0.5 * BLOCK  # of rows that are
        return min(level**2 / variance, independent) if variance > 0.0 else independent


def _unexplained(factor: FloatArray) -> float:
    """The sum of squares that least squares leave, from the triangular factor of ``[A b]``."""
    return float(factor[-1, -1] ** 2) if len(factor) == factor.shape[1] else 0.0


def sensor_channels(model: MeasurementModel) -> dict[str, list[int]]:
    """The places among the model's channels of each mounted sensor's axes, by its topic."""
    return {sensor.topic: list(model.layout.wrenches[sensor.topic]) for sensor in model.mounted}


def changed_sensors(gaps: Sequence[ChannelGap], model: MeasurementModel) -> dict[str, int] | None:
    """The mounted sensors that are no longer what they were.

    A load that is picked up is felt by other sensors and at the joints, too: where there is a gap at any other channel,
    or no other is watched, it may be the robot that has changed.

    Args:
        gaps: of the channels that are watched.
        model: has the sensors.

    Returns:
        By the topic of each changed sensor, the number of the instant before which it had not changed; None if it may
        be the robot that has.
    """
    mounted = _channels_by_topic(model)
    first = {gap.channel: gap.first for gap in gaps if gap.since is not None}
    begin = {
        topic: min(first[name] for name in names if name in first) - LATE
        for topic, names in mounted.items()
        if not first.keys().isdisjoint(names)
    }
    others = {gap.channel for gap in gaps}.difference(*mounted.values())
    return begin if others and not robot_may_have_changed(gaps, model) else None


def robot_may_have_changed(gaps: Sequence[ChannelGap], model: MeasurementModel) -> bool:
    """Whether there is a gap at a joint, or at several sensors. As long as no joint is watched yet, nobody knows."""
    mounted = _channels_by_topic(model)
    opened = {gap.channel for gap in gaps if gap.since is not None}
    return bool(opened.difference(*mounted.values())) or sum(map(bool, map(opened.intersection, mounted.values()))) > 1


def _channels_by_topic(model: MeasurementModel) -> dict[str, list[str]]:
    return {topic: [model.channels[place].name for place in places] for topic, places in sensor_channels(model).items()}
