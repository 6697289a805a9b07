"""Payload by change point: does the last link carry a body since some instant, and which?

The rows since each recent block are explained in three ways. The robot is as it was. Or the link carries a body, from a
wide prior. Or every channel feels anything at all, as large as it came out and as smooth as motions are. A body is
believed where its evidence beats both others, and taken back where the last rows are likelier without it (change points
of product partitions: Adams, MacKay 2007).

What earlier rows tell of the robot enters as their information M. The rows ``[A e]`` of a channel, with errors e of its
prediction and the body's columns B among A, tell of the body, with ``V = M + A'A``,

    H = B'B - B'A V^-1 A'B,    h = B'e - B'A V^-1 A'e,    S = e'e - e'A V^-1 A'e.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from geomid_ros.estimation.channel_products import usable
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.tolerances import LARGEST_STEP, ROUNDING, ROUNDS, SETTLED
from geomid_ros.estimation.uncertain_inertia import interval_of_positive
from geomid_ros.geometry import definite
from geomid_ros.geometry.manifold import ONE_BODY, Point
from geomid_ros.geometry.symmetric import SIZE
from geomid_ros.model.channels import Channel
from geomid_ros.model.measurement import Rows
from geomid_ros.types import FloatArray, IntArray, frozen

REMEMBERED = 20
"""Blocks since which a change is looked for; suspect blocks, and stretches of usual ones, that are kept."""
_LACKING = 0.1  # of what a body adds to efforts: what the model lacks under loads
_SOON = 2  # blocks after which a large change shows; a small one in the whole window


class Noise(NamedTuple):
    """Noise of a channel: its variance, and how many independent rows one row counts for; no rows as long as nobody
    knows."""

    variance: float = 1.0
    independent: float = 0.0


@dataclass(frozen=True, eq=False)
class Carried:
    """A body that a ``link`` carries, in the link's frame.

    ``parameters (10,)`` and their ``covariance``, the ``columns`` of the model that are the link's; ``since``: the
    stamp [ns] from which on, and ``first``, the number of the instant at that stamp.
    """

    link: str
    columns: slice
    parameters: FloatArray
    covariance: FloatArray
    since: int
    first: int

    @property
    def mass(self) -> float:
        """[kg]."""
        return float(self.parameters[0])

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the mass [kg]."""
        return interval_of_positive(self.mass, float(np.sqrt(self.covariance[0, 0])))

    def added(self, parameters: FloatArray) -> FloatArray:
        """Parameters of the model ``(D,)`` with the body on the link."""
        whole = parameters.copy()
        whole[self.columns] += self.parameters
        return whole


def carrying(estimate: Estimate, carried: Carried | None) -> Estimate:
    """An estimate with what is carried, for predictions."""
    return estimate if carried is None else replace(estimate, parameters=carried.added(estimate.parameters))


@dataclass(frozen=True, eq=False)
class _Block:
    """Sums of products ``(d + 1, d + 1)`` of each channel's rows ``[A e]``; their numbers ``(channels,)``, in rows and
    in blocks; and when they begin."""

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
    """A body's likeliest ``point``, and the ``gain`` in log evidence over nothing."""

    point: Point
    gain: float
    covariance: FloatArray


@dataclass(frozen=True, eq=False)
class _Told:
    """What rows tell of a body: ``information (10, 10)``, ``slope (10,)``.

    ``vagueness``: gain in log likelihood, whatever the body, as its efforts need not be exact. ``unknown``: gain if
    each channel feels something else, as large as it came out, and another thing with every block.
    """

    information: FloatArray
    slope: FloatArray
    vagueness: float
    unknown: float

    def gain(self, body: FloatArray) -> float:
        """Log likelihood of a body ``(10,)`` over nothing."""
        return self.vagueness + float(self.slope @ body - 0.5 * body @ self.information @ body)


class _Baseline:
    """What is known of the robot without a payload by one channel: parameters ``mean (d,)`` and their information, in
    units of a row."""

    def __init__(self, channel: Channel, body: slice, links: int) -> None:
        self.columns = channel.columns
        places = np.arange(len(self.columns))
        self.body = places[(self.columns >= body.start) & (self.columns < body.stop)]
        self._own = places[self.columns >= links]  # coefficients of effects
        self.mean = np.zeros(len(self.columns))
        self.information = np.zeros((len(self.columns), len(self.columns)))

    def products(self, coefficients: FloatArray, targets: FloatArray) -> FloatArray:
        """Sums of products of rows ``(N, D)``."""
        rows = coefficients[:, self.columns]
        joined = np.concatenate([rows, (targets - rows @ self.mean)[:, None]], axis=1)
        return np.asarray(joined.T @ joined)

    def whole(self, more: FloatArray) -> FloatArray:
        """The information with that of further rows, and a little where there is none."""
        total = self.information + more[:-1, :-1]
        squares = np.diag(total)
        return np.asarray(total + np.diag(ROUNDING * squares + np.finfo(float).eps * np.max(squares, initial=1e-300)))

    def learn(self, products: FloatArray, share: float) -> FloatArray:
        """Take rows; those before keep a ``share`` of their weight. Returns the step of the mean."""
        self.information *= share
        step = definite.solved_anyway(self.whole(products), products[:-1, -1])
        self.information += products[:-1, :-1]
        self.mean += step
        return step

    def reduced(self, products: FloatArray) -> tuple[FloatArray, FloatArray]:
        """``[[H h], [h' S]] (11, 11)`` of rows; and the same for what acts on the channel alone, ``(k + 1, k + 1)``."""
        kept = np.concatenate([self._own, self.body, [len(self.columns)]])
        right = products[:-1, kept]
        whole = products[np.ix_(kept, kept)] - right.T @ definite.solved_anyway(self.whole(products), right)
        own, rest = len(self._own), len(self._own) + np.arange(SIZE + 1)
        alone = np.append(np.arange(own), rest[-1])
        return whole[own:, own:], whole[np.ix_(alone, alone)]


class PayloadWatch:
    """Looks for a body on a link in blocks of rows, and follows it."""

    def __init__(
        self,
        channels: Sequence[Channel],
        link: str,
        columns: slice,
        links: int,
        *,
        usual: FloatArray,
        spread: float,
        gain: float,
        surprise: float,
    ) -> None:
        """
        Args:
            channels: of the model.
            link: that may carry a body.
            columns: of the model that are the link's.
            links: number of columns that are links'; effects follow.
            usual: payload ``(10,)`` about which the prior lies.
            spread: standard deviation of the prior, a geodesic distance.
            gain: relative standard deviation of the efforts' common gain.
            surprise: log evidence that takes or drops a body.
        """
        self._link, self._columns = link, columns
        self._gain = gain
        self._baselines = [_Baseline(channel, columns, links) for channel in channels]
        self._felt = [len(baseline.body) == SIZE for baseline in self._baselines]
        self._prior = ONE_BODY.point(usual)
        self._precision = 1.0 / spread**2
        self._surprise = surprise
        self._recent: deque[tuple[_Block, FloatArray | None]] = deque()  # with the body that was known before
        self._loaded: _Block | None = None  # the sum since the body is carried
        self._noise: Sequence[Noise] = ()
        self._share = 1.0  # of what was learned, by what came since without a body
        self.carried: Carried | None = None
        """The body; None if there is none."""

    def judge(self, first: int, stamps: IntArray, rows: Rows, noise: Sequence[Noise], share: float) -> bool:
        """Take a block of rows. Returns whether a body came or went with it.

        Args:
            first: number of the first instant.
            stamps: ``(N,)`` [ns].
            rows: of the ``N`` instants; targets that say nothing are NaN.
            noise: of each channel.
            share: weight that what was learned before keeps.
        """
        if self.carried is None:
            self._noise = noise
            self._share *= share
        measured = usable(rows.coefficients, rows.targets)
        products = tuple(
            baseline.products(rows.coefficients[own, index], rows.targets[own, index])
            for index, (baseline, own) in enumerate(zip(self._baselines, measured.T, strict=True))
        )
        counts = np.count_nonzero(measured, axis=0).astype(np.float64)
        block = _Block(products, counts, counts / len(stamps), first, int(stamps[0]))
        self._recent.append((block, None if self.carried is None else self.carried.parameters))
        changed = self._take() if self._loaded is None else self._drop()
        if self._loaded is not None and self.carried is not None and not changed:
            self._follow(self._loaded + block, self.carried.parameters)
        if len(self._recent) == 2 * REMEMBERED:
            oldest = _sum([self._recent.popleft()[0] for _ in range(REMEMBERED)])
            if self._loaded is None:
                self._learn(oldest)
        return changed

    def _learn(self, block: _Block) -> None:
        """Take rows of the robot without a body, and shift the errors of those that are still recent."""
        share, self._share = self._share, 1.0
        for place, baseline in enumerate(self._baselines):
            step = np.append(baseline.learn(block.products[place], share), -1.0)
            for later, _ in self._recent:
                products = later.products[place]
                errors = -products @ step  # of the rows, by the new mean
                products[-1, :-1] = products[:-1, -1] = errors[:-1]
                products[-1, -1] = -errors @ step

    def _told(self, block: _Block) -> _Told:
        total, vagueness, unknown, joints = np.zeros((SIZE + 1, SIZE + 1)), 0.0, 0.0, self._surprise
        for baseline, felt, products, rows, blocks, noise in zip(
            self._baselines, self._felt, block.products, block.rows, block.blocks, self._noise, strict=True
        ):
            if not felt or rows * noise.independent <= 0.0:
                continue
            weighted, alone = (noise.independent / noise.variance * each for each in baseline.reduced(products))
            squares = float(weighted[-1, -1])
            excess = max((squares - rows * noise.independent) / blocks, 0.0)
            unknown += 0.5 * blocks * max(excess - 1.0 - float(np.log(max(excess, 1.0))), 0.0)
            vague = 1.0 + _LACKING**2 * excess
            inexact = 0.5 * (squares * (1.0 - 1.0 / vague) - blocks * float(np.log(vague)))
            vagueness += inexact
            total += weighted / vague
            volume = 0.5 * (len(alone) - 1) * float(np.log1p(rows * noise.independent))
            needed = vague * (volume + self._surprise - inexact)
            if 0.5 * squares > needed:  # nothing explains more than all of it
                joints += max(_most(alone[:-1, :-1], alone[:-1, -1]) - needed, 0.0) / vague
        return _Told(total[:-1, :-1], total[:-1, -1], vagueness, max(unknown, joints - self._surprise))

    @property
    def _last(self) -> list[_Block]:
        """The blocks of the window, the latest first."""
        return [block for block, _ in self._recent][: -REMEMBERED - 1 : -1]

    def _tails(self) -> Iterator[_Block]:
        """Sums of the last block, the last two and so on, the whole window last."""
        return accumulate(self._last, lambda later, earlier: earlier + later)

    def _take(self) -> bool:
        """Take up a body where the last rows show one."""
        last = self._last
        ends = [_sum(last[count - 1 :: -1]) for count in (_SOON, REMEMBERED) if len(last) >= count]
        if not any(map(self._may_carry, ends)):
            return False
        fits = [(fit.gain - told.unknown, tail, fit) for tail in self._tails() for told, fit in [self._fitted(tail)]]
        excess, tail, fit = max(fits, key=lambda each: each[0])
        if excess < self._surprise:
            return False
        self._begin(tail, fit)
        return True

    def _may_carry(self, tail: _Block) -> bool:
        told = self._told(tail)
        return told.vagueness + _most(told.information, told.slope) - told.unknown > self._surprise

    def _begin(self, tail: _Block, fit: _Fit) -> None:
        before = [block for block, _ in self._recent if block.first < tail.first]
        self._recent = deque((b, fit.point.parameters) for b, _ in self._recent if b.first >= tail.first)
        if before[:-1]:  # the last one may have felt it
            self._learn(_sum(before[:-1]))
        self._note(_sum([block for block, _ in self._recent]), fit)

    def _follow(self, loaded: _Block, body: FloatArray) -> None:
        told = self._told(loaded)
        self._note(loaded, _body(told, self._prior, self._precision, ONE_BODY.point(body)))

    def _note(self, loaded: _Block, fit: _Fit) -> None:
        self._loaded = loaded
        body = fit.point.parameters
        covariance = fit.covariance + self._gain**2 * np.outer(body, body)
        self.carried = Carried(self._link, self._columns, frozen(body), frozen(covariance), loaded.stamp, loaded.first)

    def _drop(self) -> bool:
        """Take the body back where the last rows are likelier without it."""
        for tail, (block, known) in zip(self._tails(), reversed(self._recent), strict=False):
            told = self._told(tail)
            against = -told.unknown - (0.0 if known is None else told.gain(known))
            if against > self._surprise:
                self._recent = deque((b, None) for b, _ in self._recent if b.first >= block.first)
                self._loaded = self.carried = None
                return True
            if against < 0.0:
                break
        return False

    def _fitted(self, block: _Block) -> tuple[_Told, _Fit]:
        told = self._told(block)
        return told, _body(told, self._prior, self._precision, self._prior)


def _most(information: FloatArray, slope: FloatArray) -> float:
    """The largest gain in log likelihood by any parameters."""
    return 0.5 * float(slope @ np.linalg.lstsq(information, slope, rcond=ROUNDING)[0])


def _sum(blocks: Sequence[_Block]) -> _Block:
    """All blocks, in the order of time."""
    first, *later = blocks
    products = tuple(product.copy() for product in first.products)
    for block in later:
        for total, more in zip(products, block.products, strict=True):
            np.add(total, more, out=total)
    rows, counts = (np.sum(own, axis=0) for own in zip(*((block.rows, block.blocks) for block in blocks), strict=True))
    return replace(first, products=products, rows=rows, blocks=counts)


def _body(told: _Told, prior: Point, precision: float, point: Point) -> _Fit:
    """The likeliest body by Gauss-Newton steps on the manifold from a ``point``, with Laplace's approximation of its
    evidence."""
    for _ in range(ROUNDS):
        away, curvature = ONE_BODY.log_and_hessian(point, prior)
        jacobian = point.links_jacobian[0]
        hessian = jacobian.T @ told.information @ jacobian
        slope = jacobian.T @ (told.slope - told.information @ point.parameters) + precision * away
        step = definite.solved_anyway(hessian + precision * curvature[0], slope)
        length = float(np.linalg.norm(step))
        if length < SETTLED:
            break
        point = ONE_BODY.exp(point, step * min(1.0, LARGEST_STEP / length))
    away, curvature = ONE_BODY.log_and_hessian(point, prior)
    jacobian = point.links_jacobian[0]
    whole = jacobian.T @ told.information @ jacobian + precision * np.eye(SIZE)
    occam = 0.5 * float(np.linalg.slogdet(whole / precision)[1])
    gain = told.gain(point.parameters) - 0.5 * precision * float(away @ away) - occam
    return _Fit(point, gain, jacobian @ definite.inverse(whole) @ jacobian.T)
