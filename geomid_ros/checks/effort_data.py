"""Subject of a check: the joints of a robot whose efforts are measured, at a few samples of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from geomid_ros.checks.evidence import (
    FRICTION,
    LARGEST_RESIDUAL,
    LEAST_SIGMA,
    MOST,
    PRIOR_STD,
    Evidence,
    Unknowns,
    evidence,
    prior_factor,
)
from geomid_ros.checks.sample_reservoir import FEWEST, KeptSamples
from geomid_ros.estimation.tolerances import ROUNDING
from geomid_ros.geometry import spd
from geomid_ros.model.robot import STANDARD_GRAVITY, Robot
from geomid_ros.model.samples import REST_SPEED, SIGN, SMOOTH_SIGN, Samples
from geomid_ros.types import AnyArray, BoolArray, FloatArray, IntArray

_SLOW = 0.05  # fraction of a joint's largest speed, below which stiction is arbitrary
STRETCHES = 20
"""Number of stretches of a recording: a change may begin with each, and they alternate between two parts."""
_OF_MOTION = ("rows", "predicted", "friction", "unknowns", "tolerated", "_bases")


@dataclass(frozen=True, eq=False, kw_only=True)
class EffortData:
    """C joints of a robot whose efforts are checked, and N samples that were recorded of them.

    Attributes:
        robot: under the configured gravity.
        samples: those of the recording at which the efforts of these joints are measured.
        joints: ``(C,)`` their indices among the robot's.
        gains: ``(C,)`` factors on the messages' efforts.
        urdf_parameters: ``(D,)`` the URDF's parameters.
        factor: ``(bodies, 10, 10)`` of the covariance of their errors.
        shares: ``(N,)`` fraction of the recording before each sample, 0 to 1.
        recordings, bags: ``(N,)`` number of each sample's recording, and the name of its bag.
        next_samples: the next sample after each of them.
    """

    robot: Robot
    samples: Samples
    joints: IntArray
    gains: FloatArray
    urdf_parameters: FloatArray
    factor: FloatArray
    shares: FloatArray
    recordings: IntArray
    bags: AnyArray
    next_samples: Samples

    @staticmethod
    def of(robot: Robot, kept: KeptSamples, gains: FloatArray) -> EffortData:
        """Select the joints that move a mass and whose efforts are measured and change, with the robot's URDF as prior.

        Args:
            robot: under the configured gravity.
            kept: a few samples of the recording.
            gains: ``(joints,)`` factors on the messages' efforts.
        """
        effort = kept.samples.effort
        joints = np.flatnonzero(is_measured(kept.samples) & is_changing(effort) & np.any(robot.supports, axis=1))
        usable = np.all(np.isfinite(effort[:, joints]), axis=1)
        samples = kept.samples.select(usable)
        return EffortData(
            robot=robot,
            samples=samples,
            joints=joints,
            gains=gains[joints],
            urdf_parameters=np.array([body.parameters for body in robot.bodies]).ravel(),
            factor=prior_factor(robot),
            shares=np.arange(len(samples)) / max(len(samples), 1),
            recordings=kept.recordings[usable],
            bags=kept.bags[usable],
            next_samples=kept.next_samples.select(usable),
        )

    @staticmethod
    def of_all(robot: Robot, samples: Samples) -> EffortData:
        """Select the joints from samples of one recording, as they are."""
        kept = KeptSamples(samples, samples, np.zeros(len(samples), dtype=np.int64), np.full(len(samples), ""))
        return EffortData.of(robot, kept, np.ones(samples.effort.shape[1]))

    def select(self, chosen: AnyArray | slice) -> EffortData:
        """Return the subject at some of the samples, chosen by a mask, an index array or a slice."""
        part = replace(
            self,
            samples=self.samples.select(chosen),
            shares=self.shares[chosen],
            recordings=self.recordings[chosen],
            bags=self.bags[chosen],
            next_samples=self.next_samples.select(chosen),
        )
        if "rows" in self.__dict__:
            part.__dict__["rows"] = self.rows[:, chosen]
        if "unknowns" in self.__dict__:
            part.__dict__["unknowns"] = self.unknowns.select(chosen)
        return part

    def time_of(self, place: float) -> str:
        """Time from the first sample to the fraction ``place`` of all samples, in words: in its bag, if there are
        several. Steps back in time count 0."""
        sample = min(round(place * len(self.bags)), len(self.bags) - 1)
        of_bag = self.bags == self.bags[sample]
        steps = np.diff(self.samples.stamps[: sample + 1][of_bag[: sample + 1]])
        seconds = f"{1e-9 * float(np.sum(np.maximum(steps, 0))):.0f} s"
        return seconds if np.all(of_bag) else f"{seconds} of '{self.bags[sample]}'"

    @cached_property
    def halves(self) -> list[EffortData]:
        """The recordings, or both halves of the motion of a single one. In each part every effort changes."""
        moved, several = np.cumsum(self.is_moving), len(np.unique(self.recordings)) > 1
        return self._divided(self.recordings if several else 2 * moved // (moved[-1] + 1))

    @cached_property
    def alternating(self) -> list[EffortData]:
        """Two sets of alternate stretches, which both have something of all of the motion, like :attr:`halves`."""
        moved = np.cumsum(self.is_moving)
        return self._divided((STRETCHES * moved // (moved[-1] + 1)) % 2)

    def _divided(self, which: IntArray) -> list[EffortData]:
        parts = [self.select(which == one) for one in np.unique(which)]
        return [part for part in parts if 2 * len(part.samples) >= FEWEST and np.all(part.measured_std > 0.0)]

    def with_efforts(self, measured: FloatArray) -> EffortData:
        """Return the same motion with other efforts ``(N, C)``."""
        effort = self.samples.effort.copy()
        effort[:, self.joints] = measured
        other = replace(self, samples=replace(self.samples, effort=effort))
        other.__dict__.update({name: self.__dict__[name] for name in _OF_MOTION if name in self.__dict__})
        return other

    def in_units(self, units: FloatArray) -> EffortData:
        """Return the subject with channels in ``units (C,)`` instead of the standard deviations of its efforts."""
        other = self.with_efforts(self.measured)
        other.__dict__["measured_std"] = units
        return other

    def with_samples(self, samples: Samples) -> EffortData:
        """Return the same robot in another motion."""
        return replace(self, samples=samples)

    def at_positions(self, position: FloatArray) -> EffortData:
        """Return the same motion at other positions ``(N, joints)``, on which friction does not depend."""
        other = self.with_samples(replace(self.samples, position=position))
        other.__dict__["_bases"] = self._bases
        return other

    def under_gravity(self, gravity: FloatArray) -> EffortData:
        """Return the subject under another ``gravity (3,)`` in the base frame [m/s^2]."""
        return replace(self, robot=self.robot.with_gravity(gravity))

    @property
    def names(self) -> list[str]:
        """Names of the joints."""
        return [self.robot.joint_names[joint] for joint in self.joints]

    @property
    def units(self) -> list[str]:
        """Units of the efforts."""
        return [self.robot.joints[joint].unit for joint in self.joints]

    @property
    def measured(self) -> FloatArray:
        """Measured efforts ``(N, C)``."""
        return self.samples.effort[:, self.joints]

    @cached_property
    def measured_std(self) -> FloatArray:
        """Standard deviations of the efforts ``(C,)``."""
        return np.asarray(np.std(self.measured, axis=0))

    @property
    def relative_std(self) -> FloatArray:
        """Standard deviations of the efforts over the largest in their unit ``(C,)``; small ones, as those of a wrist,
        are often mostly friction and noise."""
        return np.asarray(self.measured_std / largest_of_unit(self.measured_std, self.units))

    @cached_property
    def pairs(self) -> tuple[IntArray, IntArray]:
        """All pairs of a channel and a body that its joint moves, by channel: both indices ``(P,)``."""
        channels, bodies = np.nonzero(self.robot.supports[self.joints])
        return channels, bodies

    @cached_property
    def rows(self) -> FloatArray:
        """Effort rows of the :attr:`pairs` over their body's parameters ``(P, N, 10)``."""
        return self._rows(self.robot, *self.robot.configuration(self.samples))

    def _rows(self, robot: Robot, *motion: FloatArray) -> FloatArray:
        return robot.rows_of_pairs(*motion)[np.isin(np.nonzero(robot.supports)[0], self.joints)]

    def link_efforts(self, parameters: FloatArray, rows: FloatArray | None = None) -> FloatArray:
        """Efforts ``(N, C)`` of links with ``parameters (D,)``, by ``rows (P, N, 10)``; in this motion unless given."""
        channels, bodies = self.pairs
        of_pairs = (self.rows if rows is None else rows) @ parameters.reshape(-1, 10, 1)[bodies]
        return np.asarray(of_pairs[:, :, 0].T @ (channels[:, None] == np.arange(len(self.joints))))

    def columns_of(self, body: int, factor: FloatArray) -> FloatArray:
        """Effort columns ``(N, C, k)`` of a change of a body's parameters by a ``factor (10, k)``."""
        channels, bodies = self.pairs
        columns = np.zeros((*self.measured.shape, factor.shape[1]))
        columns[:, channels[bodies == body]] = (self.rows[bodies == body] @ factor).transpose(1, 0, 2)
        return columns

    @cached_property
    def predicted(self) -> FloatArray:
        """Efforts predicted for the URDF's links ``(N, C)``."""
        return self.robot.joint_efforts(*self.robot.configuration(self.samples))[:, self.joints]

    @property
    def expected_std(self) -> FloatArray:
        """Standard deviations of the efforts of links that are like the URDF's within their errors ``(C,)``."""
        pairs = zip(self.unknowns.affected_by, self.unknowns.columns, strict=True)
        by_errors = [float(np.sum(np.var(columns[:, : len(felt)], axis=0))) for felt, columns in pairs]
        return np.asarray(np.sqrt(np.var(self.predicted, axis=0) + by_errors))

    @property
    def weight(self) -> FloatArray:
        """Gravity efforts of the URDF's links ``(N, C)``."""
        return np.asarray(self.predicted - self.under_gravity(np.zeros(3)).predicted)

    @cached_property
    def friction(self) -> FloatArray:
        """Columns of each joint ``(N, C, 5)``: a constant; and, per positive unit, viscous friction, dry friction that
        sets in at once or gradually, and rotor inertia."""
        samples = self.samples
        dry = samples.column(SIGN), samples.column(SMOOTH_SIGN)
        columns = [np.ones(samples.velocity.shape), samples.velocity, *dry, samples.acceleration]
        return np.stack(columns, axis=2)[:, self.joints]

    def friction_efforts(self, found: Evidence) -> FloatArray:
        """Friction ``(N, C)`` at an evidence, in standard deviations of the efforts."""
        return np.asarray(np.einsum("nck,ck->nc", self.friction[:, :, 1:-1], found.friction[:, 1:-1]))

    @property
    def sticking(self) -> FloatArray:
        """Samples ``(N, C)`` at which a joint is too slow to overcome its stiction: 1 there, 0 at others."""
        return (~moving(self.friction[:, :, 1])).astype(np.float64)

    @cached_property
    def unknowns(self) -> Unknowns:
        """Effort columns of the links' errors, of unit variance, and of friction."""
        channels, bodies = self.pairs
        errors, columns = list[IntArray](), list[FloatArray]()
        for channel, friction in enumerate(self.friction.transpose(1, 0, 2)):
            felt = bodies[channels == channel]
            by_errors = self.rows[channels == channel] @ self.factor[felt]
            columns.append(np.concatenate([*by_errors, friction], axis=1))
            errors.append((10 * felt[:, None] + np.arange(10)).ravel())
        return Unknowns(len(self.urdf_parameters), tuple(errors), tuple(columns), self.sticking)

    @cached_property
    def tolerated(self) -> FloatArray:
        """Prior standard deviations of friction's coefficients, see :func:`evidence` ``(C, 5)``."""
        return np.asarray(2.0 / np.maximum(np.sqrt(np.mean(self.friction**2, axis=0)), 1e-6))

    @cached_property
    def thinned(self) -> EffortData:
        """The subject at a few samples, enough to rank candidates by their resemblance to the prediction."""
        return self.select(slice(None, None, -(-len(self.samples) // (2 * FEWEST))))

    @cached_property
    def moving_part(self) -> EffortData:
        """The subject at the samples at which a joint moves."""
        return self.select(self.is_moving)

    @property
    def is_moving(self) -> BoolArray:
        """True for the samples ``(N,)`` at which a joint moves."""
        return np.asarray(np.any(np.abs(self.samples.velocity[:, self.joints]) > REST_SPEED, axis=1))

    @cached_property
    def baseline_fit(self) -> BaselineFit:
        """Fit of links, friction and curves of each joint's motion: the most that these explain."""
        return BaselineFit(self)

    @cached_property
    def nominal(self) -> Evidence:
        """Evidence that nothing is wrong."""
        return self.evidence()

    @cached_property
    def of_friction(self) -> Evidence:
        """Evidence that efforts are friction alone, and no links are felt."""
        unknowns = Unknowns.of(np.zeros((*self.measured.shape, 0)), self.friction, self.sticking)
        return evidence(self.measured / self.measured_std, unknowns, self.tolerated)

    def evidence(
        self, *, either_sign: BoolArray | bool = False, unknown: FloatArray | None = None, friction: bool = True
    ) -> Evidence:
        """Compute the evidence of the efforts.

        Args:
            either_sign: True if friction may be of either sign, of all channels or of each ``(C,)``.
            friction: True if there is any; a constant is possible in any case.
            unknown: ``(N, C, j)`` effort columns of other unknowns of unit variance, which become the last of the
                links' errors.
        """
        unknowns = self.unknowns if unknown is None else self.unknowns.with_errors(unknown)
        if not friction:
            unknowns = unknowns.with_separate(self.friction * (np.arange(FRICTION) == 0))
        return evidence(self.target, unknowns, self.tolerated, units=self.measured_std, either_sign=either_sign)

    @property
    def target(self) -> FloatArray:
        """Efforts beyond those of the URDF's links, in standard deviations of the efforts ``(N, C)``."""
        return np.asarray((self.measured - self.predicted) / self.measured_std)

    def links(self, found: Evidence) -> FloatArray:
        """Links' parameters ``(D,)`` at an evidence."""
        return self.parameters_at(found.link_errors[: len(self.urdf_parameters)])

    def parameters_at(self, errors: FloatArray) -> FloatArray:
        """Links' parameters ``(D,)`` at errors ``(D,)`` of unit variance."""
        return self.urdf_parameters + (self.factor @ errors.reshape(-1, 10, 1)).ravel()

    def explained(self, found: Evidence) -> FloatArray:
        """Efforts that are explained ``(N, C)``, friction included."""
        friction = np.einsum("nck,ck->nc", self.friction, found.friction)
        return np.asarray(self.link_efforts(self.links(found)) + self.measured_std * friction)

    def fitted_gravity(self, found: Evidence | None = None) -> FloatArray:
        """Gravity ``(3,)`` [m/s^2] under which efforts are explained best: with the URDF's links, or together with
        links, linearised at those of an evidence."""
        parameters = self.urdf_parameters if found is None else self.links(found)
        positions, *motion = self.robot.configuration(self.samples)
        at_rest, axes = [np.zeros_like(rates) for rates in motion], STANDARD_GRAVITY * np.eye(3)
        by_gravity = (self._rows(self.robot.with_gravity(axis), positions, *at_rest) for axis in axes)
        columns = np.stack([self.link_efforts(parameters, rows) for rows in by_gravity], axis=2)
        unknowns = Unknowns.of(columns, self.friction) if found is None else self.unknowns.with_errors(columns)
        unknowns = replace(unknowns, sticking=np.zeros(self.measured.shape))  # gravity at rest would pass for stiction
        errors = evidence(self.target, unknowns, self.tolerated, units=self.measured_std).link_errors
        return np.asarray(self.robot.gravity + STANDARD_GRAVITY * errors[-3:])

    def without_friction(self, columns: FloatArray) -> FloatArray:
        """Remove from columns of each channel ``(C, N, k)`` what its friction can explain, of either sign."""
        return np.asarray(columns - self._bases @ (self._bases.transpose(0, 2, 1) @ columns))

    @cached_property
    def _bases(self) -> FloatArray:
        return np.asarray(np.linalg.qr(self.friction.transpose(1, 0, 2))[0])

    @property
    def resemblance(self) -> float:
        """Resemblance of measured and predicted efforts: the log likelihood per sample if each is a positive multiple
        of its prediction, plus friction. No links are fitted."""
        residual_square = np.maximum(1.0 - np.maximum(self.slopes()[1], 0.0) ** 2, LEAST_SIGMA**2)
        return -0.5 * float(np.sum(np.log(residual_square)))

    def slopes(self) -> tuple[FloatArray, FloatArray]:
        """Slope of measured over predicted efforts, and their correlation, without friction ``(C,)``."""
        both = self.without_friction(np.stack([self.measured.T, self.predicted.T], axis=2))
        return _slopes(both[:, :, 0].T, both[:, :, 1].T)

    def sizes_of_links(self, fit: Evidence) -> FloatArray:
        """Slopes of the fitted links' efforts over the URDF's, at the joints that should feel most ``(k,)``."""
        expected = np.std(self.predicted, axis=0)
        main = expected > LEAST_SIGMA * largest_of_unit(expected, self.units)
        return np.asarray(self.fitted_slopes(fit)[0][main])

    def fitted_slopes(self, fit: Evidence) -> tuple[FloatArray, FloatArray]:
        """Slope of the fitted links' efforts over the URDF's, and their correlation, which is zero where these links
        explain little of the measurement ``(C,)``. If it is negative, as if mass were, efforts have the wrong sign."""
        fitted, nominal = self.link_efforts(self.links(fit)), self.predicted
        slopes, correlations = _slopes(fitted - np.mean(fitted, axis=0), nominal - np.mean(nominal, axis=0))
        explain = np.std(fitted, axis=0) > LARGEST_RESIDUAL * self.measured_std
        return slopes, np.where(explain, correlations, 0.0)


def _slopes(values: FloatArray, over: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slope of values over others, both ``(N, C)``, and their correlation ``(C,)``, through zero."""
    crossed, size = np.sum(values * over, axis=0), np.maximum(np.sum(over**2, axis=0), 1e-30)
    return crossed / size, crossed / np.maximum(np.sqrt(size * np.sum(values**2, axis=0)), 1e-30)


@dataclass(frozen=True, eq=False, kw_only=True)
class EvidenceGain:
    """Improvement by additional columns.

    Attributes:
        per_instant: gain of log evidence per sample [nats].
        ratios: ``(C,)`` residual over that without the columns.
        coefficients, deviations: ``(k,)`` of the columns.
        link_efforts: ``(N, C)`` efforts of the links given these columns.
    """

    per_instant: float
    ratios: FloatArray
    coefficients: FloatArray
    deviations: FloatArray
    link_efforts: FloatArray

    def beyond(self, other: EvidenceGain) -> EvidenceGain:
        """Return the improvement by these columns over that by others."""
        return replace(self, per_instant=self.per_instant - other.per_instant, ratios=self.ratios / other.ratios)


class BaselineFit:
    """Links, friction and curves fitted to the efforts of a subject at the samples at which each of its joints moves.

    Curves of each joint's motion stand for springs, cables and other friction laws: what they explain is no evidence of
    a fault. Anything else is fitted given these.
    """

    def __init__(self, subject: EffortData) -> None:
        friction = subject.friction
        self._moving = moving(friction[:, :, 1]).astype(np.float64)
        self._instants = float(np.mean(np.maximum(np.sum(self._moving, axis=0), 1.0)))  # of a channel, on average
        curves = _curves(subject.samples.position[:, subject.joints], friction, subject.predicted)
        self._tolerated = np.concatenate([np.ones(curves.shape[1:]), subject.tolerated], axis=1)
        self._subject, self._own = subject, np.concatenate([curves, friction], axis=2)
        self._unknowns = subject.unknowns.with_separate(self._own)
        self.nominal = self._evidence(self._unknowns)
        """Evidence without further columns."""
        self.link_efforts = self._rigid(self.nominal.link_errors)
        """Efforts of the fitted links ``(N, C)``."""
        self._linearise()

    def predicted_gains(
        self, columns: FloatArray, begins: IntArray | None = None, *, before: bool = False
    ) -> FloatArray:
        """Return an approximate lower bound of ``gain(columns).per_instant``, at the noise without the columns [nats].

        Args:
            columns: ``(N, C, k)`` of the efforts, per standard deviation of their coefficients.
            begins: ``(n,)`` increasing indices of samples; the columns are zero before each, or from it on if
                ``before``. By default they begin at the first sample.

        Returns:
            For each beginning ``(n,)``.
        """
        ends = np.append(0 if begins is None else begins, len(columns))
        if before:
            ends = np.append(0, ends[:-1])
        parts = np.array([self._crossed(columns, slice(*part)) for part in pairwise(ends)])
        sums = np.cumsum(parts, axis=0) if before else np.cumsum(parts[::-1], axis=0)[::-1]
        return np.array([self._promise(total) for total in sums])

    def _crossed(self, columns: FloatArray, part: slice) -> FloatArray:
        """Products ``(K + k + 1, k)`` of the known columns, the columns and the target with the columns, over some
        samples, all in units of the noise."""
        count, size = columns.shape[2], len(self._whitener)
        sums = np.zeros((size + count + 1, count))
        for channel, (places, known) in enumerate(zip(self._known.places, self._known.columns, strict=True)):
            nonzero = np.flatnonzero(np.any(columns[part, channel], axis=0))
            rows = self._weights[part, channel, None] * columns[part, channel, nonzero]
            at = np.concatenate([places, size + nonzero, [size + count]])
            sums[at[:, None], nonzero] += np.column_stack([known[part], rows, self._target[part, channel]]).T @ rows
        return sums

    def _promise(self, crossed: FloatArray) -> float:
        with_known, squared, target = np.split(crossed, [len(self._whitener), len(crossed) - 1])
        coupling = self._whitener @ with_known
        sizes, axes = np.linalg.eigh(squared - coupling.T @ coupling)
        precisions = 1.0 + np.maximum(sizes, 0.0)  # rounding makes sizes of tiny efforts negative
        quadratic = float(np.sum((axes.T @ (target[0] - self._explained @ coupling)) ** 2 / precisions))
        return 0.5 * (quadratic - float(np.sum(np.log(precisions)))) / self._instants

    def _linearise(self) -> None:
        """Linearise at the fit, with friction of either sign."""
        of = self._subject
        self._weights = self._moving / (of.measured_std * self.nominal.sigmas)
        scaled = self._own * self._tolerated * of.measured_std[:, None]
        self._known = self._unknowns.with_separate(scaled).times(self._weights)
        self._target = self._weights * (of.measured - of.predicted)
        sums = self._known.with_target(self._target, np.ones(self._target.shape[1]))
        products = sums.weighed(np.ones(len(sums)))
        self._whitener = spd.whitener(products[:-1, :-1] + np.eye(len(products) - 1))
        self._explained = self._whitener @ products[:-1, -1]

    def gain(self, columns: FloatArray) -> EvidenceGain:
        """Fit additional columns, in the form of :meth:`predicted_gains`."""
        fitted, rank = self._evidence(self._unknowns.with_errors(columns)), self._unknowns.links
        return EvidenceGain(
            per_instant=(fitted.log_evidence - self.nominal.log_evidence) / self._instants,
            ratios=fitted.sigmas / self.nominal.sigmas,
            coefficients=fitted.link_errors[rank:],
            deviations=fitted.deviations()[rank:],
            link_efforts=self._rigid(fitted.link_errors[:rank]),
        )

    def _rigid(self, links: FloatArray) -> FloatArray:
        return np.asarray(self._subject.predicted + self._unknowns.link_efforts(links))

    def _evidence(self, unknowns: Unknowns) -> Evidence:
        """Evidence of unknowns of unit variance, curves and friction."""
        of = self._subject
        return evidence(of.target, unknowns, self._tolerated, units=of.measured_std, counted=self._moving)


def largest_of_unit(sizes: FloatArray, units: Sequence[str]) -> FloatArray:
    """Largest of the sizes of channels ``(C,)`` with the same unit as each ``(C,)``."""
    return np.array([np.max(sizes[np.array(units) == unit]) for unit in units])


def is_measured(samples: Samples) -> BoolArray:
    """True for joints whose efforts are measured in half of the samples or more ``(joints,)``."""
    return np.asarray(np.mean(np.isfinite(samples.effort), axis=0) >= MOST)


def is_changing(efforts: FloatArray) -> BoolArray:
    """True for efforts ``(N, joints)`` that change at all, where they are measured ``(joints,)``."""
    measured = [effort[np.isfinite(effort)] for effort in efforts.T]
    return np.array([len(each) > 0 and np.ptp(each) > 1e-9 * np.max(np.abs(each)) for each in measured], dtype=bool)


def moving(velocity: FloatArray) -> BoolArray:
    """True where joints move, so that stiction is not arbitrary ``(N, C)``."""
    speed = np.abs(velocity)
    return np.asarray(speed > _SLOW * np.max(speed, axis=0))


def by_channel(columns: FloatArray) -> FloatArray:
    """Columns ``(N, C, k)`` that are separate for each channel, as columns ``(N, C, C k)`` of all channels."""
    instants, channels, count = columns.shape
    expanded = np.zeros((instants, channels, channels, count))
    diagonal = np.arange(channels)
    expanded[:, diagonal, diagonal] = columns
    return expanded.reshape(instants, channels, channels * count)


def _curves(position: FloatArray, friction: FloatArray, predicted: FloatArray) -> FloatArray:
    """Columns of springs, cables and other friction laws, per prior standard deviation ``(N, C, 6)``."""
    place = standardised(position - np.mean(position, axis=0))
    speed = standardised(friction[:, :, 1])
    sign = friction[:, :, 2]
    load = np.abs(standardised(predicted - np.mean(predicted, axis=0)))
    bent, cubic = place**2 - 1.0, place**3 - 3.0 * place
    creeping = sign * np.exp(-(speed**2))
    return PRIOR_STD * np.stack([place, bent, cubic, speed * np.abs(speed), creeping, load * sign], axis=2)


def standardised(values: FloatArray) -> FloatArray:
    """Divide values ``(N, C)`` by their standard deviations; zero where they are constant up to rounding."""
    deviations = np.std(values, axis=0)
    varied = deviations > ROUNDING * (1.0 + np.max(np.abs(values), axis=0, initial=0.0))
    return np.asarray(np.where(varied, values, 0.0) / np.where(varied, deviations, 1.0))
