"""What is judged: the joints of a robot whose efforts are measured, at a few instants of a recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomid_ros.checks.evidence import Evidence
from geomid_ros.checks.hypotheses import Cause, Hypothesis
from geomid_ros.checks.readings import Efforts, World, as_it_is
from geomid_ros.checks.rows import effort_rows, friction_columns, prior_factor
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray, IntArray


class Subject:
    """The C joints of a robot whose efforts are judged, and what was recorded of them."""

    def __init__(self, model: MeasurementModel, samples: Samples, joints: IntArray, gains: FloatArray) -> None:
        """
        Args:
            model: of the robot.
            samples: instants of the recording at which the efforts of these joints are measured.
            joints: ``(C,)`` their places among the robot's.
            gains: ``(C,)`` factors that the messages' efforts were multiplied by.
        """
        self.model, self.robot = model, model.robot
        self.samples = samples
        self.joints = joints
        self.gains = gains
        self.names = [self.robot.joint_names[joint] for joint in joints]
        self.prior = np.array([body.parameters for body in self.robot.bodies]).ravel()
        self.factor = prior_factor(self.robot)

    def under(self, gravity: FloatArray) -> Subject:
        """The same under another ``gravity (3,)`` in the base frame [m/s^2]."""
        return Subject(self.model.with_gravity(gravity), self.samples, self.joints, self.gains)

    @property
    def everywhere(self) -> range:
        """All channels."""
        return range(len(self.joints))

    @property
    def loads(self) -> FloatArray:
        """The largest efforts as shares of the URDF's limits ``(C,)``."""
        largest = np.quantile(np.abs(self.samples.effort[:, self.joints]), 0.99, axis=0)
        return np.asarray(largest / self.robot.effort_limits[self.joints])

    def efforts(self, samples: Samples) -> Efforts:
        """What was measured at samples."""
        return Efforts(
            measured=samples.effort[:, self.joints],
            spread=np.std(samples.effort[:, self.joints], axis=0),
            friction=friction_columns(samples)[:, self.joints],
            prior=self.prior,
            factor=self.factor,
        )

    def regressor(self, samples: Samples, *, weightless: bool = False) -> FloatArray:
        """The rows ``(N, C, D)`` of this robot in the motion of samples; without gravity if ``weightless``."""
        gravity = np.zeros(3) if weightless else self.robot.gravity
        return effort_rows(self.robot, samples, gravity)[:, self.joints]

    def world(self, samples: Samples) -> World:
        """This robot in the motion of samples."""
        return World(self.efforts(samples), self.regressor(samples))

    def hypothesis(
        self,
        cause: Cause,
        evidence: Evidence,
        choices: int,
        *,
        sources: IntArray | None = None,
        concerned: Sequence[int] | None = None,
        allowed: bool = True,
        alone: bool = True,
        settled: bool = False,
    ) -> Hypothesis:
        """A hypothesis about all channels that are as they are measured, unless it is said otherwise."""
        return Hypothesis(
            cause=cause,
            evidence=evidence,
            choices=choices,
            sources=as_it_is(len(self.joints)).sources if sources is None else sources,
            concerned=list(self.everywhere if concerned is None else concerned),
            allowed=allowed,
            alone=alone,
            settled=settled,
        )
