"""Whether the efforts of a recording are those of this robot: each hypothesis is fitted and compared."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from geomid_ros.checks import words
from geomid_ros.checks.changes import Changes
from geomid_ros.checks.descriptions import impossible_description
from geomid_ros.checks.encoders import encoder_hypotheses
from geomid_ros.checks.evidence import LEAST_SIGMA, Evidence
from geomid_ros.checks.flexible import FlexibleFit
from geomid_ros.checks.hypotheses import FOLLOWS, GAIN_OF_ORDER, Cause, Finding, Hypothesis, decide
from geomid_ros.checks.instants import FEWEST
from geomid_ros.checks.lags import Lags, Pairs
from geomid_ros.checks.motions import degree_hypotheses, name_hypotheses
from geomid_ros.checks.readings import World, as_it_is
from geomid_ros.checks.signs import (
    friction_hypotheses,
    magnitude_hypotheses,
    order_hypotheses,
    sign_hypotheses,
)
from geomid_ros.checks.standstill import frozen_position
from geomid_ros.checks.subject import Subject
from geomid_ros.checks.switched_unit import SwitchedUnit
from geomid_ros.checks.unexplained import Residuals
from geomid_ros.checks.units import unit_hypotheses
from geomid_ros.checks.unmeasured import frozen, is_model
from geomid_ros.checks.weights import gravity_hypotheses
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray, IntArray

MEASURED = 0.5
"""The least share of instants at which the effort of a joint that is judged is measured."""
_MOVES = 0.02  # [rad, m] standard deviation of the position of a joint that moves


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
        robot = model.robot
        moves = np.std(samples.position, axis=0) > _MOVES
        measured = np.mean(np.isfinite(samples.effort), axis=0) >= MEASURED
        changes = np.array([_changes(effort) for effort in samples.effort.T], dtype=bool)
        self._constant = [robot.joint_names[j] for j in np.flatnonzero(measured & moves & ~changes)]
        joints = np.flatnonzero(measured & changes)
        usable = _usable(samples, joints)
        self._subject = Subject(model, usable, joints, gains[joints])
        self._pairs = Pairs.of(_usable(dense, joints)) if dense is not None else None
        self._enough = len(usable) >= FEWEST and bool(np.any(moves)) and len(joints) > 0
        self.remarks: list[str] = []
        """What to know of efforts that may be right, once they have been judged."""

    def findings(self) -> list[Finding]:
        """What is wrong; empty if nothing is, or nothing can be told."""
        found = [Finding(cause=words.constant(self._constant))] if self._constant else []
        return [*found, *self._judged()] if self._enough else found

    def _judged(self) -> list[Finding]:
        subject = self._subject
        plain = impossible_description(subject) or frozen_position(subject)
        if plain is not None:
            return [Finding(cause=plain)]
        world = subject.world(subject.samples)
        fit = FlexibleFit(world, subject.samples, subject.joints)
        self.remarks = [words.MODEL] if is_model(world.measured, world.predicted) else []
        causes = frozen(subject.names, subject.samples, world.measured, fit.rigid)
        own, level = self._best(subject, world, fit)
        if own is None and level is not None:
            self.remarks.append(level.sentence)
            subject = subject.under(np.array(level.settings["gravity"]))
            world = subject.world(subject.samples)
            own, _ = self._best(subject, world, FlexibleFit(world, subject.samples, subject.joints))
        named = [*(Finding(cause=cause) for cause in causes), *([] if own is None else [own])]
        return named or self._unexplained(subject, world)

    @staticmethod
    def _unexplained(subject: Subject, world: World) -> list[Finding]:
        """The joints whose efforts no links and no friction explain, whatever the reason."""
        explained = world.explained(world.judge(as_it_is(len(subject.joints))))
        residuals = Residuals(
            names=subject.names,
            units=[subject.robot.joints[joint].unit for joint in subject.joints],
            positions=subject.samples.position[:, subject.joints],
            speeds=subject.samples.velocity[:, subject.joints],
            efforts=world.measured,
            residuals=world.measured - world.spread * explained,
            before=np.full(len(subject.joints), np.inf),
        )
        found = residuals.finding(world.spread, FOLLOWS)
        return [] if found is None else [found]

    def _best(self, subject: Subject, world: World, fit: FlexibleFit) -> tuple[Finding | None, Cause | None]:
        """What explains efforts better than that they are as they should be; and the same of what may only be remarked
        on: a base that is not level."""
        instants = len(subject.samples)
        nominal = world.judge(as_it_is(len(subject.joints)))
        tried = [*self._tried(subject, world, nominal), *self._changing(subject, fit, nominal)]
        best = max([nominal, *(h.evidence for h in tried if h.allowed)], key=lambda found: found.log)
        if np.all(best.sigmas > FOLLOWS):
            return Finding(cause=words.unrelated(subject.names)), None
        aside = [h for h in tried if not h.alone and h.is_named(nominal, instants)]
        remarked = max(aside, key=lambda hypothesis: hypothesis.score).cause if aside else None
        return decide(tried, nominal, instants), remarked

    @staticmethod
    def _tried(subject: Subject, world: World, nominal: Evidence) -> Iterator[Hypothesis]:
        """What may be so all of the time."""
        yield from sign_hypotheses(subject, world)
        yield from friction_hypotheses(subject, world)
        yield from magnitude_hypotheses(subject, world)
        yield from order_hypotheses(subject, world)
        yield from unit_hypotheses(subject, world, nominal)
        yield from gravity_hypotheses(subject)
        yield from degree_hypotheses(subject)
        # Of what is nearly explained no more could be told.
        if np.sum(np.log(nominal.sigmas / LEAST_SIGMA)) > GAIN_OF_ORDER:
            yield from name_hypotheses(subject)
            yield from encoder_hypotheses(subject, world, nominal)

    def _changing(self, subject: Subject, fit: FlexibleFit, nominal: Evidence) -> Iterator[Hypothesis]:
        """What may change, or come at another time."""
        yield from Changes(subject, fit).hypotheses(nominal)
        yield from SwitchedUnit(subject).hypotheses(nominal)
        if self._pairs is not None:
            yield from Lags(subject, self._pairs).hypotheses(nominal)


def _usable(samples: Samples, joints: IntArray) -> Samples:
    """The samples at which the efforts of all these joints are measured."""
    return samples.select(np.all(np.isfinite(samples.effort[:, joints]), axis=1))


def _changes(effort: FloatArray) -> bool:
    """Whether an effort changes at all."""
    known = effort[np.isfinite(effort)]
    return bool(len(known) and np.ptp(known) > 1e-9 * np.max(np.abs(known)))
