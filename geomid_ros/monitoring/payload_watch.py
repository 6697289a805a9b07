"""Payload detection by change points: has the last link carried a payload since some time, and which?

Three hypotheses explain the rows since each recent block: the robot is as it was; the link carries a payload, with a
wide prior; or an unknown effect acts on every channel, as large as observed and different in every block. A payload is
accepted if its evidence exceeds both others, dropped if the last rows are likelier without it, and exchanged if they
and those before are likelier with one each (change points of product partitions: Adams, MacKay 2007). If it is likelier
that the link lost one, nothing is learned meanwhile; if that stays so, the link is learned anew.

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
from geomid_ros.geometry.manifold import ONE_BODY, ParameterManifold, Point
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
    which it is carried; ``picked_up``: stamp since which anything is, and ``first_sample``: index of the sample then.
    """

    link: str
    columns: slice
    parameters: FloatArray
    covariance: FloatArray
    since: int
    picked_up: int
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
class CarriedMemory:
    """``parameters``, ``covariance`` and ``since`` of a :class:`CarriedPayload`; sums of ``products``, and numbers of
    ``rows`` and ``blocks`` by channel, since then."""

    parameters: FloatArray
    covariance: FloatArray
    since: int
    products: tuple[FloatArray, ...]
    rows: FloatArray
    blocks: FloatArray


@dataclass(frozen=True, eq=False)
class WatchMemory:
    """State of a :class:`PayloadWatch` for a ``link``.

    Attributes:
        link: The link.
        means, information: The robot's parameters without a payload and their information, by channel.
        noise: ``(channels, 2)``, see :class:`ChannelNoise`.
        carried: The present payload; None if there is none.
    """

    link: str
    means: tuple[FloatArray, ...]
    information: tuple[FloatArray, ...]
    noise: FloatArray
    carried: CarriedMemory | None = None

    @property
    def shapes(self) -> list[tuple[int, ...]]:
        """Shapes of all arrays."""
        arrays = [self.noise, *self.means, *self.information]
        if (load := self.carried) is not None:
            arrays += [load.parameters, load.covariance, load.rows, load.blocks, *load.products]
        return [array.shape for array in arrays]


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

    def __sub__(self, later: _Block) -> _Block:
        products = tuple(a - b for a, b in zip(self.products, later.products, strict=True))
        return replace(self, products=products, rows=self.rows - later.rows, blocks=self.blocks - later.blocks)


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
    """Log likelihood of n payloads relative to none: ``information (10 n, 10 n)``, ``slope (10 n,)``; ``parts
    (channels, 10 n, 10 n)``: information of each channel.

    ``vagueness``: gain of any payload, as its efforts need not be exact. ``unknown``: gain if an unknown effect acts on
    each channel, as large as observed and different in every block, or if effects of the channels changed.
    """

    information: FloatArray
    slope: FloatArray
    vagueness: float
    unknown: float
    parts: FloatArray

    def gain(self, body: FloatArray) -> float:
        """Log likelihood of the payloads ``(10 n,)`` relative to none."""
        return self.vagueness + float(self.slope @ body - 0.5 * body @ self.information @ body)

    @property
    def of_loss(self) -> _Likelihood:
        """Likelihood of the same payloads if they were there before, and are lost."""
        return replace(self, slope=-self.slope)

    @property
    def largest_excess(self) -> float:
        """Largest log evidence of any payload, even of an impossible one, beyond that of an unknown effect."""
        return self.vagueness + _largest_gain(self.information, self.slope) - self.unknown


class _Baseline:
    """Information on the robot without a payload from one channel: parameters ``mean (d,)`` and their information, in
    units of a row."""

    def __init__(self, channel: Channel, body: slice, links: int) -> None:
        self.columns = channel.columns
        first, end, effects = np.searchsorted(self.columns, [body.start, body.stop, links])
        self.body, self._effects = slice(first, end), slice(effects, len(self.columns))  # coefficients of effects
        self.mean = frozen(np.zeros(len(self.columns)))
        self.information = frozen(np.zeros((len(self.columns), len(self.columns))))

    @property
    def feels_all(self) -> bool:
        """True if the channel depends on all parameters of the body."""
        return bool(self.body.stop - self.body.start == SIZE)

    def products(self, coefficients: FloatArray, targets: FloatArray) -> FloatArray:
        """Sums of products of rows ``(N, D)``."""
        rows = coefficients[:, self.columns]
        joined = np.concatenate([rows, (targets - rows @ self.mean)[:, None]], axis=1)
        return np.asarray(joined.T @ joined)

    def whole(self, more: FloatArray) -> FloatArray:
        """Return the information with that of ``more`` rows, slightly regularised."""
        total = self.information + more[:-1, :-1]
        squares = np.einsum("ii->i", total)  # a view
        squares += ROUNDING * squares + np.finfo(float).eps * np.max(squares, initial=1e-300)
        return total

    def learn(self, products: FloatArray, share: float) -> FloatArray:
        """Learn from rows; those before keep a ``share`` of their weight. Return the step of the mean."""
        self.information = share * self.information
        step = spd.solve_or_least_squares(self.whole(products), products[:-1, -1])
        self.information = frozen(self.information + products[:-1, :-1])
        self.mean = frozen(self.mean + step)
        return step

    def forget_body(self) -> None:
        """Forget the body's parameters; what is known of the others stays."""
        across = self.information[:, self.body]
        rest = self.information - across @ np.linalg.pinv(across[self.body], hermitian=True) @ across.T
        rest[self.body] = rest[:, self.body] = 0.0
        self.information = frozen(rest)

    def reduced(self, parts: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
        """``[[H h], [h' S]] (10 n + 1, 10 n + 1)`` of rows in n parts, with a payload in each; and the same for the
        channel's effects in all of them, ``(k + 1, k + 1)``."""
        whole, effects, last = reduce(operator.add, parts), self._effects, slice(len(self.columns), None)
        # Columns: a payload in each part, the errors, and the effects.
        rows = np.column_stack([*(part[:, self.body] for part in parts), whole[:, last], whole[:, effects]])
        errors = SIZE * len(parts)
        total = np.zeros((rows.shape[1], rows.shape[1]))
        for begin, part in zip(range(0, errors, SIZE), parts, strict=True):
            total[begin : begin + SIZE, begin : begin + SIZE] = part[self.body, self.body]
        total[errors], total[errors + 1 :] = rows[-1], rows[effects]
        total[:errors, errors:] = total[errors:, :errors].T
        total -= rows[:-1].T @ spd.solve_or_least_squares(self.whole(whole), rows[:-1])
        return total[: errors + 1, : errors + 1], total[errors:, errors:]


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
        pace: int = 1,
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
            pace: number of blocks between searches.
        """
        self._link, self._columns = link, columns
        self._gain = gain
        self._baselines = [_Baseline(channel, columns, links) for channel in channels]
        self._prior = ONE_BODY.point(prior_mean)
        self._precision = 1.0 / prior_std**2
        self._surprise, self._pace = threshold, pace
        self._waited = 0  # blocks since the last search
        self._recent: deque[tuple[_Block, FloatArray | None]] = deque()  # with the payload that was known before
        self._loaded: _Block | None = None  # sum since the payload is carried
        self._picked_up = 0, 0  # stamp and index of the first sample with any payload
        self._noise: Sequence[ChannelNoise] = [ChannelNoise(1.0, 0.0)] * len(channels)
        self._share = 1.0  # weight that rows learned so far keep after newer rows without a payload
        self._body: CarriedPayload | None = None  # that the link carries or, if the sign is -1, has lost
        self._sign = 1.0
        self.exchanged: CarriedPayload | None = None
        """Payload before the last exchange, by its own rows."""

    @property
    def payload(self) -> CarriedPayload | None:
        """Present payload; None if there is none."""
        return self._body if self._sign > 0.0 else None

    @property
    def notices(self) -> bool:
        """True if it is known of any channel what is normal, so that a payload can be noticed."""
        return any(noise.independent > 0.0 for noise in self._noise)

    @property
    def memory(self) -> WatchMemory:
        """State for :meth:`restore`, apart from the last rows without a payload."""
        load = None
        if self.payload is not None and self._loaded is not None:
            body, loaded = self.payload, self._loaded
            load = CarriedMemory(
                body.parameters, body.covariance, body.since, loaded.products, loaded.rows, loaded.blocks
            )
        means = tuple(baseline.mean for baseline in self._baselines)
        information = tuple(baseline.information for baseline in self._baselines)
        return WatchMemory(self._link, means, information, np.array(self._noise), load)

    def restore(self, memory: WatchMemory) -> None:
        """Go on from the state of another watch of the same channels, from sample 0 on; that of another link is
        ignored. Raises InputError, and changes nothing, for a state that no such watch can have."""
        if memory.link != self._link:
            return
        sizes, count, load = [len(baseline.mean) for baseline in self._baselines], len(self._baselines), memory.carried
        expected: list[tuple[int, ...]] = [(count, 2), *((size,) for size in sizes), *((size, size) for size in sizes)]
        if load is not None:
            expected += [(SIZE,), (SIZE, SIZE), (count,), (count,), *((size + 1, size + 1) for size in sizes)]
        if memory.shapes != expected:
            raise InputError(f"a memory of payloads of '{self._link}' has arrays of other shapes than this model's")
        if load is not None:
            body, covariance = frozen(ONE_BODY.point(load.parameters).parameters), frozen(load.covariance)
            self._loaded = _Block(load.products, load.rows, load.blocks, 0, load.since)
            self._picked_up = load.since, 0
            self._body = CarriedPayload(self._link, self._columns, body, covariance, load.since, *self._picked_up)
        for baseline, mean, information in zip(self._baselines, memory.means, memory.information, strict=True):
            baseline.mean, baseline.information = mean, information
        self._noise = [ChannelNoise(*row) for row in memory.noise.tolist()]

    def update(self, first: int, stamps: IntArray, rows: Rows, noise: Sequence[ChannelNoise], retained: float) -> bool:
        """Take a block of rows. Return True if it shows that a payload was picked up or put down.

        Args:
            first: index of the first sample.
            stamps: ``(N,)`` [ns].
            rows: rows of the ``N`` samples; uninformative targets are NaN.
            noise: noise of each channel.
            retained: fraction of their weight that earlier rows keep.
        """
        if self._loaded is None:
            known = zip(noise, self._noise, strict=True)
            self._noise = [new if new.independent > 0.0 else old for new, old in known]
            self._share *= retained
        measured = usable(rows.coefficients, rows.targets)
        products = tuple(
            baseline.products(rows.coefficients[used, index], rows.targets[used, index])
            for index, (baseline, used) in enumerate(zip(self._baselines, measured.T, strict=True))
        )
        counts = np.count_nonzero(measured, axis=0).astype(np.float64)
        block = _Block(products, counts, counts / len(stamps), first, int(stamps[0]))
        self._recent.append((block, None if self._body is None else self._body.parameters))
        self._loaded = None if self._loaded is None else self._loaded + block
        self._waited = (self._waited + 1) % self._pace
        changed = self._waited == 0 and self._search()
        if len(self._recent) == 2 * REMEMBERED:
            if self._sign < 0.0:
                self._learn_link_anew()
            oldest = _sum([self._recent.popleft()[0] for _ in range(REMEMBERED)])
            if self._loaded is None:
                self._learn(oldest)
        return changed

    def _search(self) -> bool:
        """Return True if a payload was picked up or put down, or another one is carried."""
        before = self.payload
        if self._loaded is None or self._body is None:
            self._take()
        elif not self._drop():
            self._exchange(self._body, self._loaded)
        since = [None if payload is None else payload.since for payload in (before, self.payload)]
        return since[0] != since[1]

    def _learn(self, block: _Block) -> None:
        """Learn from rows without a payload, and shift the errors of recent rows."""
        share, self._share = self._share, 1.0
        for place, baseline in enumerate(self._baselines):
            step = np.append(baseline.learn(block.products[place], share), -1.0)
            for later, _ in self._recent:
                later.products[place][:] = _with_other_errors(later.products[place], step)

    def _likelihood(self, *blocks_of_bodies: _Block) -> _Likelihood:
        """Likelihood of a payload in each of n blocks."""
        size, whole = SIZE * len(blocks_of_bodies) + 1, _sum(blocks_of_bodies)
        parts, vagueness, unknown, joints = [np.zeros((size, size))], 0.0, 0.0, self._surprise
        for place, (baseline, rows, blocks, noise) in enumerate(
            zip(self._baselines, whole.rows, whole.blocks, self._noise, strict=True)
        ):
            if not baseline.feels_all or rows * noise.independent <= 0.0:
                continue
            reduced = baseline.reduced([block.products[place] for block in blocks_of_bodies])
            weighted, effects_only = (noise.independent / noise.variance * part for part in reduced)
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
                joints += max(_largest_gain(effects_only[1:, 1:], effects_only[1:, 0]) - needed, 0.0) / inflation
        total, unknown = np.sum(parts, axis=0), max(unknown, joints - self._surprise)
        slope = self._sign * total[:-1, -1]
        return _Likelihood(total[:-1, :-1], slope, vagueness, unknown, np.array(parts)[:, :-1, :-1])

    @property
    def _last(self) -> list[_Block]:
        """Blocks of the window, the latest first."""
        return [block for block, _ in self._recent][: -REMEMBERED - 1 : -1]

    def _tails(self) -> Iterator[_Block]:
        """Sums of the last block, the last two and so on, the whole window last."""
        return accumulate(self._last, lambda later, earlier: earlier + later)

    def _take(self) -> None:
        """Accept a payload if the last rows show one, or that one is lost."""
        if not any(map(self._may_differ, self._ends)):
            return
        tails = ((tail, self._likelihood(tail)) for tail in self._tails())
        shown = [(tail, data) for tail, data in tails if data.largest_excess > self._surprise]
        signed = [(tail, *each) for tail, data in shown for each in ((1.0, data), (-1.0, data.of_loss))]
        fits = [(self._fit(data, [self._prior], self._surprise), tail, sign) for tail, sign, data in signed]
        fit, tail, sign = max(fits, key=lambda item: item[0].excess)
        if fit.excess >= self._surprise:
            self._sign = sign  # before the body, as other threads ask for the payload
            self._begin(tail, fit)

    def _learn_link_anew(self) -> None:
        """Forget what is known of the link: it has stayed lighter, so it carried something before."""
        self._recent = deque((block, None) for block, _ in self._recent)
        self._loaded, self._body, self._sign = None, None, 1.0
        for baseline in self._baselines:
            baseline.forget_body()

    @property
    def _ends(self) -> list[_Block]:
        """Sums of the last blocks and of the window."""
        last = self._last
        return [_sum(last[count - 1 :: -1]) for count in (_SOON, REMEMBERED) if len(last) >= count]

    def _may_differ(self, tail: _Block) -> bool:
        return self._likelihood(tail).largest_excess > self._surprise

    def _begin(self, tail: _Block, fit: _Fit) -> None:
        before = [block for block, _ in self._recent if block.first < tail.first]
        self._recent = deque((b, fit.point.parameters) for b, _ in self._recent if b.first >= tail.first)
        if self._loaded is None:
            self._picked_up = tail.stamp, tail.first
            if before[:-1]:  # the last one may depend on the payload
                self._learn(_sum(before[:-1]))
        self._note(_sum([block for block, _ in self._recent]), fit)

    def _note(self, loaded: _Block, fit: _Fit) -> None:
        self._loaded = loaded
        body = fit.point.parameters
        common, separate = np.outer(body, body), fit.shifts.T @ fit.shifts
        covariance = fit.covariance + self._gain**2 * max(common, separate, key=lambda part: float(part[0, 0]))
        self._body = CarriedPayload(
            self._link, self._columns, frozen(body), frozen(covariance), loaded.stamp, *self._picked_up
        )

    def _exchange(self, body: CarriedPayload, loaded: _Block) -> None:
        """Accept another payload if the last rows and those ``loaded`` before are likelier with one each; else update
        the payload by all."""
        known = ONE_BODY.point(body.parameters)
        one = self._fit(self._likelihood(loaded), [known])
        if any(self._may_differ(self._beyond(tail, self._sign * body.parameters)) for tail in self._ends):
            tails = [tail for tail in self._tails() if tail.first > loaded.first]
            fits = [self._fit(self._likelihood(loaded - tail, tail), [known, self._prior]) for tail in tails]
            two, tail = max(zip(fits, tails, strict=True), key=lambda item: item[0].excess)
            if two.excess - one.excess > self._surprise:
                self._begin(tail, self._fit(self._likelihood(tail), [self._prior]))
                self.exchanged = replace(body, parameters=frozen(two.point.parameters[:SIZE]))
                return
        self._note(loaded, one)

    def _beyond(self, block: _Block, body: FloatArray) -> _Block:
        """Return the block with the errors that a payload ``(10,)`` leaves."""
        products = []
        for baseline, product in zip(self._baselines, block.products, strict=True):
            step = np.append(np.zeros(len(baseline.columns)), -1.0)
            step[baseline.body] = body if baseline.feels_all else 0.0
            products.append(_with_other_errors(product, step))
        return replace(block, products=tuple(products))

    def _drop(self) -> bool:
        """Drop the payload if the last rows are likelier without it."""
        for tail, (block, payload) in zip(self._tails(), reversed(self._recent), strict=False):
            likelihood = self._likelihood(tail)
            against = -likelihood.unknown - (0.0 if payload is None else likelihood.gain(payload))
            if against > self._surprise:
                self._recent = deque((b, None) for b, _ in self._recent if b.first >= block.first)
                self._loaded, self._body, self._sign = None, None, 1.0
                return True
            if against < 0.0:
                break
        return False

    def _fit(self, likelihood: _Likelihood, bodies: Sequence[Point], least: float = -np.inf) -> _Fit:
        """Fit the most probable payloads by Gauss-Newton steps on the manifold from some ``bodies``, halved until they
        make them more probable; with Laplace's approximation of their evidence. It ends where a whole step is expected
        to leave the excess below the ``least`` of use."""
        precision, manifold = self._precision, ParameterManifold(len(bodies), 0, np.zeros(0))
        prior = manifold.point(np.tile(self._prior.parameters, len(bodies)))
        point = manifold.point(np.concatenate([body.parameters for body in bodies]))

        def blocks(matrices: FloatArray) -> FloatArray:
            result = np.zeros((manifold.dimension, manifold.dimension))
            result[manifold.links_blocks] = matrices
            return result

        def log_posterior(point: Point) -> float:
            return likelihood.gain(point.parameters) - 0.5 * precision * manifold.distance(point, prior) ** 2

        reached = log_posterior(point)
        for _ in range(ROUNDS):
            away, curvature = manifold.log_and_hessian(point, prior)
            jacobian = blocks(point.links_jacobian)
            hessian = jacobian.T @ likelihood.information @ jacobian
            slope = jacobian.T @ (likelihood.slope - likelihood.information @ point.parameters) + precision * away
            step = spd.solve_or_least_squares(hessian + precision * blocks(curvature), slope)
            if reached + 0.5 * float(slope @ step) - likelihood.unknown < least:
                break
            length = float(np.linalg.norm(step))
            share = min(1.0, LARGEST_STEP / max(length, SETTLED))
            end = manifold.exp(point, share * step)
            while (value := log_posterior(end)) < reached and share * length >= SETTLED:
                share *= 0.5
                end = manifold.exp(point, share * step)
            if share * length < SETTLED:
                break
            point, reached = end, value
        jacobian = blocks(point.links_jacobian)
        information = jacobian.T @ likelihood.information @ jacobian + precision * np.eye(manifold.dimension)
        occam = 0.5 * float(np.linalg.slogdet(information / precision)[1])
        gain = log_posterior(point) - occam
        covariance = jacobian @ spd.inverse(information) @ jacobian.T
        return _Fit(point, gain - likelihood.unknown, covariance, likelihood.parts @ point.parameters @ covariance)


def _with_other_errors(products: FloatArray, step: FloatArray) -> FloatArray:
    """Return products of rows ``[A e]`` with the errors ``-[A e] step`` in place of e."""
    result, errors = products.copy(), -products @ step
    result[-1, :-1] = result[:-1, -1] = errors[:-1]
    result[-1, -1] = -errors @ step
    return result


def _largest_gain(information: FloatArray, slope: FloatArray) -> float:
    """Largest gain in log likelihood of any parameters."""
    return 0.5 * float(slope @ np.linalg.lstsq(information, slope, rcond=ROUNDING)[0])


def _sum(blocks: Sequence[_Block]) -> _Block:
    """Sum of all blocks, in the order of time."""
    return reduce(operator.add, blocks)
