"""What is judged: the joints of a robot whose efforts are measured, at a few instants of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geomid_ros.checks.evidence import (
    FOLLOWS,
    FRICTION,
    HALF,
    LEAST_SIGMA,
    Evidence,
    Unknowns,
    evidence,
    prior_factor,
)
from geomid_ros.checks.flexible import FlexibleFit
from geomid_ros.checks.instants import FEWEST, Kept
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import SIGN, SMOOTH_SIGN, STILL, Samples
from geomid_ros.types import AnyArray, BoolArray, FloatArray, IntArray

STRETCHES = 20
"""Of a recording: something may begin with each, and they are alternately in one part and in the other."""
_OF_MOTION = (
    "regressor", "predicted", "friction", "unknowns", "tolerated", "_bases",
)  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class Subject:
    """The C joints of a robot whose efforts are judged, and what was recorded of them at N instants.

    Attributes:
        robot: under the gravity that is configured.
        samples: instants of the recording at which the efforts of these joints are measured.
        joints: ``(C,)`` their places among the robot's.
        gains: ``(C,)`` factors that the messages' efforts were multiplied by.
        prior: ``(D,)`` the URDF's parameters.
        factor: ``(bodies, 10, 10)`` of the covariance of their errors.
        shares: ``(N,)`` how much of the recording comes before each instant, 0 to 1.
        recordings: ``(N,)`` the number of the recording that each instant is of.
        later: what was next after each of them.
    """

    robot: Robot
    samples: Samples
    joints: IntArray
    gains: FloatArray
    prior: FloatArray
    factor: FloatArray
    shares: FloatArray
    recordings: IntArray
    later: Samples

    @staticmethod
    def of(robot: Robot, kept: Kept, gains: FloatArray) -> Subject:
        """The joints whose efforts are measured and change, by a robot's own URDF.

        Args:
            robot: under the gravity that is configured.
            kept: a few instants of the recording.
            gains: ``(joints,)`` factors that the messages' efforts were multiplied by.
        """
        effort = kept.samples.effort
        changing = [_changes(own) for own in effort.T]
        joints = np.flatnonzero((np.mean(np.isfinite(effort), axis=0) >= HALF) & changing)
        usable = np.all(np.isfinite(effort[:, joints]), axis=1)
        samples = kept.samples.select(usable)
        return Subject(
            robot=robot,
            samples=samples,
            joints=joints,
            gains=gains[joints],
            prior=np.array([body.parameters for body in robot.bodies]).ravel(),
            factor=prior_factor(robot),
            shares=np.arange(len(samples)) / max(len(samples), 1),
            recordings=kept.recordings[usable],
            later=kept.later.select(usable),
        )

    @staticmethod
    def of_all(robot: Robot, samples: Samples) -> Subject:
        """The same of samples of one recording, as they are."""
        kept = Kept(samples, samples, np.zeros(len(samples), dtype=np.int64))
        return Subject.of(robot, kept, np.ones(samples.effort.shape[1]))

    def part(self, chosen: AnyArray | slice) -> Subject:
        """The same at some of the instants, chosen by a mask, an index array or a slice."""
        part = replace(
            self,
            samples=self.samples.select(chosen),
            shares=self.shares[chosen],
            recordings=self.recordings[chosen],
            later=self.later.select(chosen),
        )
        if "regressor" in self.__dict__:
            part.__dict__["regressor"] = self.regressor[chosen]
        if "unknowns" in self.__dict__:
            part.__dict__["unknowns"] = self.unknowns.part(chosen)
        return part

    def parts(self, *, alternating: bool = False) -> list[Subject]:
        """The recordings that this is of, or both halves of the motion of a single one; or two sets of stretches in
        turn, which both have something of all of the motion, if ``alternating``. In each every effort changes."""
        return self._alternating if alternating else self._halves

    @cached_property
    def _halves(self) -> list[Subject]:
        moved, several = np.cumsum(self.is_moving), len(np.unique(self.recordings)) > 1
        return self._divided(self.recordings if several else 2 * moved // (moved[-1] + 1))

    @cached_property
    def _alternating(self) -> list[Subject]:
        moved = np.cumsum(self.is_moving)
        return self._divided((STRETCHES * moved // (moved[-1] + 1)) % 2)

    def _divided(self, which: IntArray) -> list[Subject]:
        parts = [self.part(which == one) for one in np.unique(which)]
        return [part for part in parts if 2 * len(part.samples) >= FEWEST and np.all(part.spread > 0.0)]

    def with_efforts(self, measured: FloatArray) -> Subject:
        """The same motion with other efforts ``(N, C)``."""
        effort = self.samples.effort.copy()
        effort[:, self.joints] = measured
        other = replace(self, samples=replace(self.samples, effort=effort))
        other.__dict__.update({name: self.__dict__[name] for name in _OF_MOTION if name in self.__dict__})
        return other

    def in_units(self, units: FloatArray) -> Subject:
        """The same with channels measured in ``units (C,)`` in place of the standard deviations of its efforts."""
        other = self.with_efforts(self.measured)
        other.__dict__["spread"] = units
        return other

    def with_samples(self, samples: Samples) -> Subject:
        """The same robot in another motion."""
        return replace(self, samples=samples)

    def at(self, position: FloatArray) -> Subject:
        """The same motion at other positions ``(N, joints)``, which friction does not depend on."""
        other = self.with_samples(replace(self.samples, position=position))
        other.__dict__["_bases"] = self._bases
        return other

    def under(self, gravity: FloatArray) -> Subject:
        """The same under another ``gravity (3,)`` in the base frame [m/s^2]."""
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
        """The efforts ``(N, C)``."""
        return self.samples.effort[:, self.joints]

    @cached_property
    def spread(self) -> FloatArray:
        """Their standard deviations ``(C,)``."""
        return np.asarray(np.std(self.measured, axis=0))

    @property
    def counts(self) -> BoolArray:
        """Whether efforts vary by a good part of what the largest of their unit does ``(C,)``: those of a wrist are
        often mostly friction and noise."""
        return np.asarray(self.spread > LEAST_SIGMA * largest_of_unit(self.spread, self.units))

    @cached_property
    def regressor(self) -> FloatArray:
        """Rows ``(N, C, D)`` of the efforts over the links' parameters."""
        return self._rows(self.robot.gravity, *self.robot.configuration(self.samples))

    def _rows(self, gravity: FloatArray, *motion: FloatArray) -> FloatArray:
        rows = self.robot.with_gravity(gravity).joint_effort_rows(*motion)[:, self.joints]
        return rows.reshape(len(self.samples), len(self.joints), len(self.prior))

    @cached_property
    def predicted(self) -> FloatArray:
        """Efforts of the URDF's links ``(N, C)``."""
        return self.robot.joint_efforts(*self.robot.configuration(self.samples))[:, self.joints]

    @property
    def weight(self) -> FloatArray:
        """Efforts of their weights alone ``(N, C)``."""
        return np.asarray(self.predicted - self.under(np.zeros(3)).predicted)

    @cached_property
    def friction(self) -> FloatArray:
        """What may be added at each joint ``(N, C, 5)``: a constant, and per positive unit viscous friction, dry
        friction that sets in at once or slowly, and rotor inertia."""
        samples = self.samples
        dry = samples.column(SIGN), samples.column(SMOOTH_SIGN)
        columns = [np.ones(samples.velocity.shape), samples.velocity, *dry, samples.acceleration]
        return np.stack(columns, axis=2)[:, self.joints]

    def rubbed(self, found: Evidence) -> FloatArray:
        """The friction ``(N, C)`` that an evidence finds, in standard deviations of the efforts."""
        return np.asarray(np.einsum("nck,ck->nc", self.friction[:, :, 1:-1], found.friction[:, 1:-1]))

    @cached_property
    def unknowns(self) -> Unknowns:
        """What the links' errors, of unit variance, and friction add to the efforts."""
        felt, columns = list[IntArray](), list[FloatArray]()
        for channel, carried in enumerate(self.robot.carries[self.joints]):
            (bodies,) = np.nonzero(carried)
            rows = self.regressor[:, channel].reshape(-1, len(carried), 10)[:, bodies].transpose(1, 0, 2)
            by_errors = (rows @ self.factor[bodies]).transpose(1, 0, 2).reshape(len(self.regressor), -1)
            columns.append(np.column_stack([by_errors, self.friction[:, channel]]))
            felt.append((10 * bodies[:, None] + np.arange(10)).ravel())
        return Unknowns(len(self.prior), tuple(felt), tuple(columns))

    @cached_property
    def tolerated(self) -> FloatArray:
        """Standard deviations of friction's coefficients, see :func:`evidence` ``(C, 5)``."""
        return np.asarray(2.0 / np.maximum(np.sqrt(np.mean(self.friction**2, axis=0)), 1e-6))

    @cached_property
    def few(self) -> Subject:
        """The same at a few instants, which tell what resembles the prediction most."""
        return self.part(slice(None, None, -(-len(self.samples) // (2 * FEWEST))))

    @cached_property
    def moving(self) -> Subject:
        """The same at the instants at which a joint moves."""
        return self.part(self.is_moving)

    @property
    def is_moving(self) -> BoolArray:
        """The instants ``(N,)`` at which a joint moves."""
        return np.asarray(np.any(np.abs(self.samples.velocity[:, self.joints]) > STILL, axis=1))

    @cached_property
    def flexible(self) -> FlexibleFit:
        """The most that links, friction and curves of each joint's own motion explain."""
        return FlexibleFit(
            measured=self.measured,
            predicted=self.predicted,
            links=self.unknowns,
            friction=self.friction,
            tolerated=self.tolerated,
            position=self.samples.position[:, self.joints],
            velocity=self.samples.velocity[:, self.joints],
        )

    @cached_property
    def nominal(self) -> Evidence:
        """The evidence that everything is as it should be."""
        return self.evidence()

    def evidence(
        self, *, either_sign: BoolArray | bool = False, unknown: FloatArray | None = None, friction: bool = True
    ) -> Evidence:
        """The evidence of the efforts.

        Args:
            either_sign: whether friction may be of either sign, of all channels or of each ``(C,)``.
            friction: whether there is any; a constant there may be in any case.
            unknown: ``(N, C, j)`` what other unknowns of unit variance add to the efforts; they are the last of the
                links' errors then.
        """
        unknowns = self.unknowns if unknown is None else self.unknowns.with_more(unknown)
        if not friction:
            unknowns = unknowns.with_own(self.friction * (np.arange(FRICTION) == 0))
        target = (self.measured - self.predicted) / self.spread
        return evidence(target, unknowns, self.tolerated, units=self.spread, either_sign=either_sign)

    def links(self, found: Evidence) -> FloatArray:
        """The links' parameters ``(D,)`` that an evidence finds."""
        return self.linked(found.links[: len(self.prior)])

    def linked(self, errors: FloatArray) -> FloatArray:
        """The links' parameters ``(D,)`` at errors ``(D,)`` of unit variance."""
        return self.prior + (self.factor @ errors.reshape(-1, 10, 1)).ravel()

    def explained(self, found: Evidence) -> FloatArray:
        """What efforts are explained by ``(N, C)``, friction included."""
        friction = np.einsum("nck,ck->nc", self.friction, found.friction)
        return np.asarray(self.regressor @ self.links(found) + self.spread * friction)

    def fitted_gravity(self, parameters: FloatArray) -> FloatArray:
        """The gravity ``(3,)`` [m/s^2] under which links with these parameters ``(D,)`` explain efforts best."""
        positions, *motion = self.robot.configuration(self.samples)
        at_rest = [np.zeros_like(rates) for rates in motion]
        by_gravity = [self._rows(axis, positions, *at_rest) @ parameters for axis in np.eye(3)]
        left = self.measured - self._rows(np.zeros(3), positions, *motion) @ parameters
        both = (np.array([*by_gravity, left]) / self.spread).transpose(2, 1, 0)
        both = self._beyond_friction(both)
        return np.asarray(np.linalg.lstsq(both[:, :, :3].reshape(-1, 3), both[:, :, 3].ravel(), rcond=1e-6)[0])

    def _beyond_friction(self, columns: FloatArray) -> FloatArray:
        """Columns of each channel ``(C, N, k)`` without what its friction explains."""
        return np.asarray(columns - self._bases @ (self._bases.transpose(0, 2, 1) @ columns))

    @cached_property
    def _bases(self) -> FloatArray:
        return np.asarray(np.linalg.qr(self.friction.transpose(1, 0, 2))[0])

    @property
    def resemblance(self) -> float:
        """How much efforts resemble those predicted: the log likelihood per instant if each is a positive multiple of
        its prediction, and friction. No links are fitted."""
        slopes, alike = self.slopes()
        left = np.maximum(1.0 - np.where(slopes > 0.0, alike, 0.0), LEAST_SIGMA**2)
        return -0.5 * float(np.sum(np.log(left)))

    def slopes(self) -> tuple[FloatArray, FloatArray]:
        """Of each channel the slope of what is measured over what the URDF predicts, and their squared correlation,
        both without what friction explains ``(C,)``."""
        both = self._beyond_friction(np.stack([self.measured.T, self.predicted.T], axis=2))
        measured, predicted = both[:, :, 0], both[:, :, 1]
        crossed, own = np.sum(measured * predicted, axis=1), np.sum(predicted**2, axis=1)
        slopes = crossed / np.maximum(own, 1e-30)
        return slopes, crossed**2 / np.maximum(own * np.sum(measured**2, axis=1), 1e-30)

    def fitted_slopes(self, found: Evidence) -> tuple[FloatArray, BoolArray]:
        """How many times as much the links that were found take as the URDF's, and whether that is sure ``(C,)``."""
        slopes, alike = self._compared(found)
        return slopes, np.asarray(alike > np.sqrt(1.0 - FOLLOWS**2))

    def opposite(self, found: Evidence) -> BoolArray:
        """Whether the links that were found take the opposite of what the URDF's do ``(C,)``: as if of mass below zero,
        which is what shows efforts with the wrong sign where links explain a good part of them."""
        return np.asarray(self._compared(found)[1] < -np.sqrt(1.0 - FOLLOWS**2))

    def _compared(self, found: Evidence) -> tuple[FloatArray, FloatArray]:
        """The slopes of what links take that were found over what the URDF's do, and their correlations, which are zero
        where they explain little of what was measured ``(C,)``."""
        own, nominal = self.regressor @ self.links(found), self.predicted
        own, nominal = own - np.mean(own, axis=0), nominal - np.mean(nominal, axis=0)
        crossed, size = np.sum(own * nominal, axis=0), np.maximum(np.sum(nominal**2, axis=0), 1e-30)
        alike = crossed / np.maximum(np.sqrt(size * np.sum(own**2, axis=0)), 1e-30)
        return crossed / size, np.where(np.std(own, axis=0) > FOLLOWS * self.spread, alike, 0.0)


def largest_of_unit(sizes: FloatArray, units: Sequence[str]) -> FloatArray:
    """The largest of the sizes of channels ``(C,)`` with the same unit as each ``(C,)``."""
    return np.array([np.max(sizes[np.array(units) == unit]) for unit in units])


def _changes(effort: FloatArray) -> bool:
    """Whether an effort ``(N,)`` changes at all, where it is known."""
    known = effort[np.isfinite(effort)]
    return bool(len(known) and np.ptp(known) > 1e-9 * np.max(np.abs(known)))
