"""Payload detection by change points: has the last link carried a payload since some time, and which?

Three hypotheses explain the rows since each recent block: the robot is as it was; the link carries a payload, with a
wide prior; or an unknown effect acts on every channel, as large as observed and different in every block. A payload is
accepted if its evidence exceeds both others, and dropped if the last rows are likelier without it (change points of
product partitions: Adams, MacKay 2007).

Earlier rows enter as their information M about the robot. The rows ``[A e]`` of a channel, with prediction errors e and
the payload's columns B among A, determine the payload's likelihood, with ``V = M + A'A``, by

    H = B'B - B'A V^-1 A'B,    h = B'e - B'A V^-1 A'e,    S = e'e - e'A V^-1 A'e.
"""

from __future__ import annotations

import operator
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.channel_products import usable
from geomid_ros.estimation.estimate import LACKING, Estimate, Predictor, interval_of_positive
from geomid_ros.estimation.tolerances import LARGEST_STEP, ROUNDING, ROUNDS, SETTLED
from geomid_ros.geometry import spd
from geomid_ros.geometry.manifold import ONE_BODY, Point
from geomid_ros.geometry.spd import SIZE
from geomid_ros.model.channels import Channel
from geomid_ros.model.measurement_model import Rows
from geomid_ros.types import FloatArray, IntArray, frozen

REMEMBERED = 20
"""Blocks since which a change is looked for; suspect blocks, and noise floors of stretches, that are kept."""
_SOON = 2  # blocks that show a large change; a small one needs the whole window


class ChannelNoise(NamedTuple):
    """Noise of a channel: its variance, and the number of independent rows per row; 0 while unknown."""

    variance: float
    independent: float


@dataclass(frozen=True, eq=False)
class CarriedPayload:
    """Payload of a ``link``, in the link's frame.

    ``parameters (10,)`` and their ``covariance``; ``columns``: of the link in the model; ``since``: stamp [ns] since
    which it is carried, and ``first_sample``: index of the sample at that stamp.
    """

    link: str
    columns: slice
    parameters: FloatArray
    covariance: FloatArray
    since: int
    first_sample: int

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        return float(self.parameters[0])

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the mass [kg]."""
        return interval_of_positive(self.mass, float(np.sqrt(self.covariance[0, 0])))

    def added(self, parameters: FloatArray) -> FloatArray:
        """Return parameters of the model ``(D,)`` with the payload on the link."""
        result = parameters.copy()
        result[self.columns] += self.parameters
        return result


@dataclass(frozen=True, eq=False)
class WatchMemory:
    """State of a :class:`PayloadWatch` while a payload is carried.

    Attributes:
        link, parameters, covariance, since: As of :class:`CarriedPayload`.
        means, information: The robot's parameters without a payload and their information, by channel.
        noise: ``(channels, 2)``, see :class:`ChannelNoise`.
        products, rows, blocks: Sums since the payload is carried.
    """

    link: str
    parameters: FloatArray
    covariance: FloatArray
    since: int
    means: tuple[FloatArray, ...]
    information: tuple[FloatArray, ...]
    noise: FloatArray
    products: tuple[FloatArray, ...]
    rows: FloatArray
    blocks: FloatArray

    @property
    def shapes(self) -> list[tuple[int, ...]]:
        """Shapes of all arrays."""
        arrays = (self.parameters, self.covariance, self.noise, self.rows, self.blocks)
        return [array.shape for array in (*arrays, *self.means, *self.information, *self.products)]


def with_payload(estimate: Estimate, carried: CarriedPayload | None) -> Estimate:
    """Return an estimate with the payload added, for predictions."""
    if carried is None:
        return estimate
    parameters, drive_gains = estimate.predictor
    return replace(estimate, predictor=Predictor(carried.added(parameters), drive_gains))


@dataclass(frozen=True, eq=False)
class _Block:
    """Sums of products ``(d + 1, d + 1)`` of each channel's rows ``[A e]``; their numbers ``(channels,)`` in rows and
    in blocks; index and stamp of the first sample."""

    products: tuple[FloatArray, ...]
    rows: FloatArray
    blocks: FloatArray
    first: int
    stamp: int

    def __add__(self, later: _Block) -> _Block:
        products = tuple(a + b for a, b in zip(self.products, later.products, strict=True))
        return replace(self, products=products, rows=self.rows + later.rows, blocks=self.blocks + later.blocks)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Maximum a posteriori ``point`` of a payload; ``excess``: its log evidence beyond that of an unknown effect;
    ``shifts (channels, 10)``: by how much it moves per gain error of each channel."""

    point: Point
    excess: float
    covariance: FloatArray
    shifts: FloatArray


@dataclass(frozen=True, eq=False)
class _Likelihood:
    """Log likelihood of a payload relative to none: ``information (10, 10)``, ``slope (10,)``; ``parts (channels, 10,
    10)``: information of each channel.

    ``vagueness``: gain of any payload, as its efforts need not be exact. ``unknown``: gain if an unknown effect acts on
    each channel, as large as observed and different in every block, or if effects of the channels changed.
    """

    information: FloatArray
    slope: FloatArray
    vagueness: float
    unknown: float
    parts: FloatArray

    def gain(self, body: FloatArray) -> float:
        """Log likelihood of a payload ``(10,)`` relative to none."""
        return self.vagueness + float(self.slope @ body - 0.5 * body @ self.information @ body)


class _Baseline:
    """Information on the robot without a payload from one channel: parameters ``mean (d,)`` and their information, in
    units of a row."""

    def __init__(self, channel: Channel, body: slice, links: int) -> None:
        self.columns = channel.columns
        places = np.arange(len(self.columns))
        self.body = places[(self.columns >= body.start) & (self.columns < body.stop)]
        self._effects = places[self.columns >= links]  # coefficients of effects
        self.mean = np.zeros(len(self.columns))
        self.information = np.zeros((len(self.columns), len(self.columns)))

    def products(self, coefficients: FloatArray, targets: FloatArray) -> FloatArray:
        """Sums of products of rows ``(N, D)``."""
        rows = coefficients[:, self.columns]
        joined = np.concatenate([rows, (targets - rows @ self.mean)[:, None]], axis=1)
        return np.asarray(joined.T @ joined)

    def whole(self, more: FloatArray) -> FloatArray:
        """Return the information with that of ``more`` rows, slightly regularised."""
        total = self.information + more[:-1, :-1]
        squares = np.diag(total)
        return np.asarray(total + np.diag(ROUNDING * squares + np.finfo(float).eps * np.max(squares, initial=1e-300)))

    def learn(self, products: FloatArray, share: float) -> FloatArray:
        """Learn from rows; those before keep a ``share`` of their weight. Return the step of the mean."""
        self.information *= share
        step = spd.solve_or_least_squares(self.whole(products), products[:-1, -1])
        self.information += products[:-1, :-1]
        self.mean += step
        return step

    def reduced(self, products: FloatArray) -> tuple[FloatArray, FloatArray]:
        """``[[H h], [h' S]] (11, 11)`` of rows; and the same for the channel's effects, ``(k + 1, k + 1)``."""
        kept = np.concatenate([self._effects, self.body, [len(self.columns)]])
        right = products[:-1, kept]
        total = products[np.ix_(kept, kept)] - right.T @ spd.solve_or_least_squares(self.whole(products), right)
        count, rest = len(self._effects), len(self._effects) + np.arange(SIZE + 1)
        effects_only = np.append(np.arange(count), rest[-1])
        return total[count:, count:], total[np.ix_(effects_only, effects_only)]


class PayloadWatch:
    """Detects a payload of a link from blocks of rows, and updates it."""

    def __init__(
        self,
        channels: Sequence[Channel],
        link: str,
        columns: slice,
        links: int,
        *,
        prior_mean: FloatArray,
        prior_std: float,
        gain: float,
        threshold: float,
    ) -> None:
        """
        Args:
            channels: channels of the model.
            link: link that may carry a payload.
            columns: columns of the link in the model.
            links: number of columns of links; effects follow.
            prior_mean: payload ``(10,)`` at the centre of the prior.
            prior_std: prior standard deviation, a geodesic distance.
            gain: relative standard deviation of the gain of efforts: one for all channels, or one for each, whichever
                leaves the mass more uncertain.
            threshold: log evidence at which a payload is accepted or dropped.
        """
        self._link, self._columns = link, columns
        self._gain = gain
        self._baselines = [_Baseline(channel, columns, links) for channel in channels]
        self._prior = ONE_BODY.point(prior_mean)
        self._precision = 1.0 / prior_std**2
        self._surprise = threshold
        self._recent: deque[tuple[_Block, FloatArray | None]] = deque()  # with the payload that was known before
        self._loaded: _Block | None = None  # sum since the payload is carried
        self._noise: Sequence[ChannelNoise] = ()
        self._share = 1.0  # weight that rows learned so far keep after newer rows without a payload
        self.payload: CarriedPayload | None = None
        """Present payload; None if there is none."""

    @property
    def memory(self) -> WatchMemory | None:
        """State for :meth:`restore`; None if there is no payload."""
        if self.payload is None or self._loaded is None:
            return None
        return WatchMemory(
            link=self._link,
            parameters=self.payload.parameters,
            covariance=self.payload.covariance,
            since=self.payload.since,
            means=tuple(frozen(baseline.mean) for baseline in self._baselines),
            information=tuple(frozen(baseline.information) for baseline in self._baselines),
            noise=np.array(self._noise),
            products=self._loaded.products,
            rows=self._loaded.rows,
            blocks=self._loaded.blocks,
        )

    def restore(self, memory: WatchMemory) -> None:
        """Go on with the payload of another watch of the same channels, from sample 0 on; a payload of another link is
        ignored. Raises InputError, and changes nothing, for a state that no such watch can have."""
        if memory.link != self._link:
            return
        sizes, count = [len(baseline.mean) for baseline in self._baselines], len(self._baselines)
        fixed: list[tuple[int, ...]] = [(SIZE,), (SIZE, SIZE), (count, 2), (count,), (count,)]
        widths = [(size,) for size in sizes], [(size, size) for size in sizes], [(size + 1, size + 1) for size in sizes]
        if memory.shapes != [*fixed, *widths[0], *widths[1], *widths[2]]:
            raise InputError(f"the payload of '{self._link}' has arrays of other shapes than this model's")
        body, covariance = frozen(ONE_BODY.point(memory.parameters).parameters), frozen(memory.covariance)
        for baseline, mean, information in zip(self._baselines, memory.means, memory.information, strict=True):
            baseline.mean, baseline.information = mean.copy(), information.copy()
        self._noise = [ChannelNoise(*row) for row in memory.noise.tolist()]
        self._loaded = _Block(memory.products, memory.rows, memory.blocks, 0, memory.since)
        self.payload = CarriedPayload(self._link, self._columns, body, covariance, memory.since, 0)

    def update(self, first: int, stamps: IntArray, rows: Rows, noise: Sequence[ChannelNoise], retained: float) -> bool:
        """Take a block of rows. Return True if a payload was picked up or put down in it.

        Args:
            first: index of the first sample.
            stamps: ``(N,)`` [ns].
            rows: rows of the ``N`` samples; uninformative targets are NaN.
            noise: noise of each channel.
            retained: fraction of their weight that earlier rows keep.
        """
        if self.payload is None:
            self._noise = noise
            self._share *= retained
        measured = usable(rows.coefficients, rows.targets)
        products = tuple(
            baseline.products(rows.coefficients[used, index], rows.targets[used, index])
            for index, (baseline, used) in enumerate(zip(self._baselines, measured.T, strict=True))
        )
        counts = np.count_nonzero(measured, axis=0).astype(np.float64)
        block = _Block(products, counts, counts / len(stamps), first, int(stamps[0]))
        self._recent.append((block, None if self.payload is None else self.payload.parameters))
        changed = self._take() if self._loaded is None else self._drop()
        if self._loaded is not None and self.payload is not None and not changed:
            loaded = self._loaded + block
            self._note(loaded, self._fit(loaded, ONE_BODY.point(self.payload.parameters)))
        if len(self._recent) == 2 * REMEMBERED:
            oldest = _sum([self._recent.popleft()[0] for _ in range(REMEMBERED)])
            if self._loaded is None:
                self._learn(oldest)
        return changed

    def _learn(self, block: _Block) -> None:
        """Learn from rows without a payload, and shift the errors of recent rows."""
        share, self._share = self._share, 1.0
        for place, baseline in enumerate(self._baselines):
            step = np.append(baseline.learn(block.products[place], share), -1.0)
            for later, _ in self._recent:
                products = later.products[place]
                errors = -products @ step  # of the rows, with the new mean
                products[-1, :-1] = products[:-1, -1] = errors[:-1]
                products[-1, -1] = -errors @ step

    def _likelihood(self, block: _Block) -> _Likelihood:
        parts, vagueness, unknown, joints = [np.zeros((SIZE + 1, SIZE + 1))], 0.0, 0.0, self._surprise
        for baseline, products, rows, blocks, noise in zip(
            self._baselines, block.products, block.rows, block.blocks, self._noise, strict=True
        ):
            if len(baseline.body) < SIZE or rows * noise.independent <= 0.0:
                continue
            weighted, effects_only = (noise.independent / noise.variance * part for part in baseline.reduced(products))
            squares = float(weighted[-1, -1])
            excess = max((squares - rows * noise.independent) / blocks, 0.0)
            unknown += 0.5 * blocks * max(excess - 1.0 - float(np.log(max(excess, 1.0))), 0.0)
            inflation = 1.0 + LACKING**2 * excess
            inexact_gain = 0.5 * (squares * (1.0 - 1.0 / inflation) - blocks * float(np.log(inflation)))
            vagueness += inexact_gain
            parts.append(weighted / inflation)
            volume = 0.5 * (len(effects_only) - 1) * float(np.log1p(rows * noise.independent))
            needed = inflation * (volume + self._surprise - inexact_gain)
            if 0.5 * squares > needed:  # nothing explains more than all of it
                joints += max(_largest_gain(effects_only[:-1, :-1], effects_only[:-1, -1]) - needed, 0.0) / inflation
        total, unknown = np.sum(parts, axis=0), max(unknown, joints - self._surprise)
        return _Likelihood(total[:-1, :-1], total[:-1, -1], vagueness, unknown, np.array(parts)[:, :-1, :-1])

    @property
    def _last(self) -> list[_Block]:
        """Blocks of the window, the latest first."""
        return [block for block, _ in self._recent][: -REMEMBERED - 1 : -1]

    def _tails(self) -> Iterator[_Block]:
        """Sums of the last block, the last two and so on, the whole window last."""
        return accumulate(self._last, lambda later, earlier: earlier + later)

    def _take(self) -> bool:
        """Accept a payload if the last rows show one."""
        last = self._last
        ends = [_sum(last[count - 1 :: -1]) for count in (_SOON, REMEMBERED) if len(last) >= count]
        if not any(map(self._may_carry, ends)):
            return False
        fits = [(tail, self._fit(tail, self._prior, self._surprise)) for tail in self._tails()]
        tail, fit = max(fits, key=lambda item: item[1].excess)
        if fit.excess < self._surprise:
            return False
        self._begin(tail, fit)
        return True

    def _may_carry(self, tail: _Block) -> bool:
        data = self._likelihood(tail)
        return data.vagueness + _largest_gain(data.information, data.slope) - data.unknown > self._surprise

    def _begin(self, tail: _Block, fit: _Fit) -> None:
        before = [block for block, _ in self._recent if block.first < tail.first]
        self._recent = deque((b, fit.point.parameters) for b, _ in self._recent if b.first >= tail.first)
        if before[:-1]:  # the last one may depend on the payload
            self._learn(_sum(before[:-1]))
        self._note(_sum([block for block, _ in self._recent]), fit)

    def _note(self, loaded: _Block, fit: _Fit) -> None:
        self._loaded = loaded
        body = fit.point.parameters
        common, separate = np.outer(body, body), fit.shifts.T @ fit.shifts
        covariance = fit.covariance + self._gain**2 * max(common, separate, key=lambda part: float(part[0, 0]))
        self.payload = CarriedPayload(
            self._link, self._columns, frozen(body), frozen(covariance), loaded.stamp, loaded.first
        )

    def _drop(self) -> bool:
        """Drop the payload if the last rows are likelier without it."""
        for tail, (block, payload) in zip(self._tails(), reversed(self._recent), strict=False):
            likelihood = self._likelihood(tail)
            against = -likelihood.unknown - (0.0 if payload is None else likelihood.gain(payload))
            if against > self._surprise:
                self._recent = deque((b, None) for b, _ in self._recent if b.first >= block.first)
                self._loaded = self.payload = None
                return True
            if against < 0.0:
                break
        return False

    def _fit(self, block: _Block, point: Point, least: float = -np.inf) -> _Fit:
        """Fit the most probable payload by Gauss-Newton steps on the manifold from a ``point``, halved until they make
        it more probable; with Laplace's approximation of its evidence. It ends where a whole step is expected to leave
        the payload's excess below the ``least`` of use."""
        likelihood, prior, precision = self._likelihood(block), self._prior, self._precision

        def log_posterior(point: Point) -> float:
            return likelihood.gain(point.parameters) - 0.5 * precision * ONE_BODY.distance(point, prior) ** 2

        reached = log_posterior(point)
        for _ in range(ROUNDS):
            away, curvature = ONE_BODY.log_and_hessian(point, prior)
            jacobian = point.links_jacobian[0]
            hessian = jacobian.T @ likelihood.information @ jacobian
            slope = jacobian.T @ (likelihood.slope - likelihood.information @ point.parameters) + precision * away
            step = spd.solve_or_least_squares(hessian + precision * curvature[0], slope)
            if reached + 0.5 * float(slope @ step) - likelihood.unknown < least:
                break
            length = float(np.linalg.norm(step))
            share = min(1.0, LARGEST_STEP / max(length, SETTLED))
            end = ONE_BODY.exp(point, share * step)
            while (value := log_posterior(end)) < reached and share * length >= SETTLED:
                share *= 0.5
                end = ONE_BODY.exp(point, share * step)
            if share * length < SETTLED:
                break
            point, reached = end, value
        away, curvature = ONE_BODY.log_and_hessian(point, prior)
        jacobian = point.links_jacobian[0]
        information = jacobian.T @ likelihood.information @ jacobian + precision * np.eye(SIZE)
        occam = 0.5 * float(np.linalg.slogdet(information / precision)[1])
        gain = likelihood.gain(point.parameters) - 0.5 * precision * float(away @ away) - occam
        covariance = jacobian @ spd.inverse(information) @ jacobian.T
        return _Fit(point, gain - likelihood.unknown, covariance, likelihood.parts @ point.parameters @ covariance)


def _largest_gain(information: FloatArray, slope: FloatArray) -> float:
    """Largest gain in log likelihood of any parameters."""
    return 0.5 * float(slope @ np.linalg.lstsq(information, slope, rcond=ROUNDING)[0])


def _sum(blocks: Sequence[_Block]) -> _Block:
    """Sum of all blocks, in the order of time."""
    return reduce(operator.add, blocks)
