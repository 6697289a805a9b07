"""Whether the efforts of a recording are those of this robot: each hypothesis is fitted and compared."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.plausibility import words
from geomid_ros.plausibility.changes import Changes
from geomid_ros.plausibility.evidence import LEAST_SIGMA, Evidence
from geomid_ros.plausibility.flexible import FlexibleFit
from geomid_ros.plausibility.hypotheses import FOLLOWS, GAIN_OF_ORDER, Cause, Finding, Hypothesis, decide
from geomid_ros.plausibility.instants import FEWEST
from geomid_ros.plausibility.lags import Lags, Pairs
from geomid_ros.plausibility.names import exchanges_of_names
from geomid_ros.plausibility.readings import Efforts, Reading, World, as_it_is
from geomid_ros.plausibility.rows import gravity_rows, prior_factor
from geomid_ros.plausibility.unmeasured import frozen, is_model
from geomid_ros.types import FloatArray

MEASURED = 0.5
"""The least share of instants at which the effort of a joint that is judged is measured."""
_MOVES = 0.02  # [rad, m] standard deviation of the position of a joint that moves
_REASON = 4.0  # no URDF is wrong by more in its masses: a gain beyond it is a unit
_TOLD = 0.8  # squared correlation with what the URDF predicts, of a joint whose gain can be told
_ALIKE, _SHARE = 3.0, 0.6  # gains of one unit: so many within a factor of this
_TILT = np.cos(np.radians(25.0))
_DEGREE = np.pi / 180.0
_DIRECTIONS, _UNITS = 20, 10  # that gravity and units may well have
_MOST, _LEAST = 2.0, 0.03  # efforts as shares of the URDF's limits: those of right ones are between
_ABSURD = 30.0


class EffortCheck:
    """Compares what the efforts of a recording may be."""

    def __init__(
        self, model: MeasurementModel, samples: Samples, gains: FloatArray, dense: Samples | None = None
    ) -> None:
        """
        Args:
            model: of the robot.
            samples: a few instants of the recording.
            gains: ``(joints,)`` factors that the messages' efforts were multiplied by.
            dense: all instants of a stretch of it, to find a delay.
        """
        self._model = model
        self._robot = model.robot
        moves = np.std(samples.position, axis=0) > _MOVES
        measured = np.mean(np.isfinite(samples.effort), axis=0) >= MEASURED
        changes = np.array([_changes(effort) for effort in samples.effort.T], dtype=bool)
        self._constant = [self._robot.joint_names[j] for j in np.flatnonzero(measured & moves & ~changes)]
        self._joints = np.flatnonzero(measured & changes)
        self._samples = self._usable(samples)
        self._pairs = Pairs.of(self._usable(dense)) if dense is not None else None
        self._gains = gains[self._joints]
        self._names = [self._robot.joint_names[joint] for joint in self._joints]
        limits = self._robot.effort_limits[self._joints]
        self._loads = np.quantile(np.abs(self._samples.effort[:, self._joints]), 0.99, axis=0) / limits
        """The largest efforts as shares of the URDF's limits ``(C,)``."""
        self._factor = prior_factor(model)
        self._enough = len(self._samples) >= FEWEST and bool(np.any(moves)) and len(self._joints) > 0
        self.remarks: list[str] = []
        """What to know of efforts that may be right, once they have been judged."""

    def _usable(self, samples: Samples) -> Samples:
        return samples.select(np.all(np.isfinite(samples.effort[:, self._joints]), axis=1))

    def findings(self) -> list[Finding]:
        """What is wrong; empty if nothing is, or nothing can be told."""
        found = [Finding(cause=words.constant(self._constant))] if self._constant else []
        if self._enough:
            efforts = self._efforts(self._samples)
            world = World(efforts, self._robot.gravity)
            fit = FlexibleFit(world, self._samples, self._joints)
            found += [Finding(cause=c) for c in frozen(self._names, self._samples, world.measured, fit.rigid)]
            own = self._judged(efforts, world, fit)
            found += [own] if own is not None else []
            self.remarks = [words.MODEL] if is_model(world.measured, world.predicted) else []
        return found

    def _judged(self, efforts: Efforts, world: World, fit: FlexibleFit) -> Finding | None:
        nominal = world.judge(as_it_is(len(self._joints)))
        tried = [
            *self._signs(world),
            *self._orders(world),
            *self._names_exchanged(nominal),
            *self._units(world, nominal),
            *self._gravities(efforts),
            *self._compensated(efforts),
            *self._degrees(),
            *Changes(self._model, self._samples, self._joints, efforts, fit).hypotheses(nominal),
            *self._late(nominal),
        ]
        best = max([nominal, *(h.evidence for h in tried if h.allowed)], key=lambda found: found.log)
        if np.all(best.sigmas > FOLLOWS):
            return Finding(cause=words.unrelated(self._names))
        return decide(tried, nominal, len(self._samples))

    def _efforts(self, samples: Samples) -> Efforts:
        rows = gravity_rows(self._model, samples)
        prior = np.array([body.parameters for body in self._robot.bodies]).ravel()
        return Efforts.of(rows, self._joints, prior, self._factor)

    def _signs(self, world: World) -> Iterator[Hypothesis]:
        count = len(self._joints)
        everywhere = as_it_is(count)
        yield self._tried(
            world,
            Reading(everywhere.sources, -everywhere.gains),
            words.reversed_efforts(self._names, self._gains, True),
            range(count),
            1,
        )
        for joint in range(count) if count > 1 else ():
            gains = everywhere.gains.copy()
            gains[joint] = -1.0
            cause = words.reversed_efforts([self._names[joint]], [self._gains[joint]], False)
            yield self._tried(world, Reading(everywhere.sources, gains), cause, [joint], count)

    def _orders(self, world: World) -> Iterator[Hypothesis]:
        count = len(self._joints)
        pairs = list(combinations(range(count), 2))
        for first, second in pairs:
            sources = np.arange(count)
            sources[[first, second]] = second, first
            cause = words.exchanged_efforts(self._names[first], self._names[second])
            yield self._tried(world, Reading(sources, np.ones(count)), cause, [first, second], len(pairs))

    def _names_exchanged(self, nominal: Evidence) -> Iterator[Hypothesis]:
        """Positions and efforts of one joint are those of another; not tried where so little is left to explain that
        it could not be told."""
        if np.sum(np.log(nominal.sigmas / LEAST_SIGMA)) < GAIN_OF_ORDER:
            return
        exchanges = exchanges_of_names(self._names)
        for pairs in exchanges:
            sources = np.arange(len(self._joints))
            for first, second in pairs:
                sources[[first, second]] = second, first
            order = np.arange(len(self._robot.joints))
            order[self._joints] = self._joints[sources]
            samples = self._samples.with_joints(order)
            firsts, seconds = ([self._names[pair[end]] for pair in pairs] for end in (0, 1))
            yield Hypothesis(
                cause=words.exchanged_names(firsts, seconds),
                evidence=World(self._efforts(samples), self._robot.gravity).judge(as_it_is(len(sources))),
                choices=len(exchanges),
                sources=sources,
                concerned=[place for pair in pairs for place in pair],
            )

    def _units(self, world: World, nominal: Evidence) -> Iterator[Hypothesis]:
        count = len(self._joints)
        slopes, told = world.slopes()
        factor, settled = self._common_factor(world, slopes, told, nominal)
        if not 1.0 / _REASON <= factor <= _REASON:
            cause = words.other_unit(self._names, self._gains * factor, factor, True)
            reading = Reading(np.arange(count), np.full(count, factor))
            yield self._tried(world, reading, cause, range(count), _UNITS, settled=settled)
        common = factor if settled else np.nan
        by_size = np.std(world.predicted, axis=0) / world.spread
        factors = np.where((told > 0.5) & (slopes > 0.0), 1.0 / np.maximum(slopes, 1e-30), by_size)
        for joint in range(count) if count > 1 else ():
            factor = float(factors[joint])
            if factor > 0.0 and not 1.0 / _REASON <= factor <= _REASON:
                gains = np.ones(count)
                gains[joint] = factor
                cause = words.other_unit([self._names[joint]], [self._gains[joint] * factor], factor, False)
                own = not 1.0 / _REASON <= factor / common <= _REASON
                absurd = bool(self._loads[joint] > _ABSURD)
                reading = Reading(np.arange(count), gains)
                yield self._tried(world, reading, cause, [joint], _UNITS * count, allowed=own, settled=absurd)

    def _common_factor(
        self, world: World, slopes: FloatArray, told: FloatArray, nominal: Evidence
    ) -> tuple[float, bool]:
        """The factor that makes all efforts those of the URDF, and whether it is sure without any evidence: where the
        links that were fitted are all as much too light or too heavy, or limits are exceeded."""
        fitted, follows = world.fitted_slopes(nominal)
        for ratios, sure in ((slopes, (told > _TOLD) & (slopes > 0.0)), (fitted, follows)):
            if np.count_nonzero(sure) >= 2:
                factor = 1.0 / float(np.median(ratios[sure]))
                return factor, bool(np.mean(np.abs(np.log(ratios[sure] * factor)) < np.log(_ALIKE)) >= _SHARE)
        predicted = np.maximum(np.std(world.predicted, axis=0), 1e-9)
        beyond = bool(np.median(self._loads) > _MOST or np.max(self._loads) < _LEAST)
        return float(np.median(predicted / world.spread)), beyond

    def _gravities(self, efforts: Efforts) -> Iterator[Hypothesis]:
        count = len(self._joints)
        size = float(np.linalg.norm(self._robot.gravity))
        if size == 0.0:
            return
        gravity = efforts.fitted_gravity(efforts.prior)
        for start in (1.0, -1.0):
            direction = start * gravity / max(float(np.linalg.norm(gravity)), 1e-9)
            other = World(efforts, size * direction)
            first = other.judge(as_it_is(count))
            refined = efforts.fitted_gravity(efforts.prior + efforts.factor @ other.links(first.links))
            refined /= max(float(np.linalg.norm(refined)), 1e-9)
            for aim in (direction, refined):
                yield self._gravity(efforts, size * aim)

    def _gravity(self, efforts: Efforts, gravity: FloatArray) -> Hypothesis:
        nominal = self._robot.gravity
        tilted = bool(gravity @ nominal < _TILT * (nominal @ nominal))
        cause = words.other_gravity(gravity, self._names)
        count = len(self._joints)
        reading, world = as_it_is(count), World(efforts, gravity)
        return self._tried(world, reading, cause, range(count), _DIRECTIONS, allowed=tilted)

    def _compensated(self, efforts: Efforts) -> Iterator[Hypothesis]:
        count = len(self._joints)
        if not np.any(self._robot.gravity):
            return
        cause = words.no_gravity(self._names)
        worlds = World(efforts, np.zeros(3)), World(efforts, self._robot.gravity, weightless=True)
        for world in worlds:
            yield self._tried(world, as_it_is(count), cause, range(count), 2)

    def _degrees(self) -> Iterator[Hypothesis]:
        samples = self._samples
        turning = np.array([joint.unit != "N" for joint in self._robot.joints])
        scale = np.where(turning, _DEGREE, 1.0)
        small = replace(
            samples,
            position=scale * samples.position,
            velocity=scale * samples.velocity,
            acceleration=scale * samples.acceleration,
        )
        count = len(self._joints)
        world = World(self._efforts(small), self._robot.gravity)
        low, high = self._robot.position_limits.T
        beyond = np.any((samples.position < low - 0.5) | (samples.position > high + 0.5), axis=0)
        wide = np.max(np.abs(samples.position), axis=0) > 2.0 * np.pi
        cause = words.degrees(self._names)
        possible = bool(np.any(turning & (beyond | wide)))
        yield self._tried(world, as_it_is(count), cause, range(count), 1, allowed=possible)

    def _late(self, nominal: Evidence) -> Iterator[Hypothesis]:
        if self._pairs is not None:
            efforts = self._efforts(self._pairs.now)
            yield from Lags(self._model, self._pairs, self._joints, efforts).hypotheses(nominal, len(self._samples))

    def _tried(
        self,
        world: World,
        reading: Reading,
        cause: Cause,
        concerned: range | list[int],
        choices: int,
        *,
        allowed: bool = True,
        settled: bool = False,
    ) -> Hypothesis:
        return Hypothesis(
            cause=cause,
            evidence=world.judge(reading),
            choices=choices,
            sources=reading.sources,
            concerned=list(concerned),
            allowed=allowed,
            settled=settled,
        )


def _changes(effort: FloatArray) -> bool:
    """Whether an effort changes at all."""
    known = effort[np.isfinite(effort)]
    return bool(len(known) and np.ptp(known) > 1e-9 * np.max(np.abs(known)))
