"""Design of an exciting trajectory from a robot description."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from geomid_ros.api.robot import DescribedRobot, configuration, description
from geomid_ros.errors import InputError
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.options import takes
from geomid_ros.report.excitation import save
from geomid_ros.session import excitation
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.excitation import Excitation
from geomid_ros.session.options import MotionOptions, PathLike


@dataclass(frozen=True, eq=False)
class MotionDesign:
    """A designed motion: ``excitation`` has its margins, and the quantities that it is expected to identify."""

    excitation: Excitation

    @property
    def trajectory(self) -> Trajectory:
        """Motion as points."""
        return self.excitation.trajectory

    @property
    def sentences(self) -> list[str]:
        """Quantities that the motion is expected to identify, in sentences."""
        return list(self.excitation.learning.sentences)

    def save(self, folder: PathLike) -> list[Path]:
        """Write trajectory.yaml, trajectory.csv, trajectory_bag, excitation.json, excitation.png and motion.html.

        Args:
            folder: created if it does not exist.

        Returns:
            The files.

        Raises:
            GeomidError: a file cannot be written.
        """
        return save(self.excitation, Path(folder))


@takes(MotionOptions)
def excite(options: MotionOptions) -> MotionDesign:
    """Design an exciting trajectory that is feasible at every instant and at rest at both ends.

    ``geomid excite`` calls this; its options have the same names, but ``--for`` for ``aim`` and ``--from`` for
    ``model``.

    Raises:
        InputError: a file or an argument cannot be used, or the robot cannot start.
    """
    return designed_motion(*robot_to_excite(options), options)


def robot_to_excite(options: MotionOptions) -> tuple[DescribedRobot, Configuration]:
    """Return the robot to design motions for, and its configuration. Raises InputError if no robot is given."""
    if options.urdf is None and options.model is None:
        raise InputError("no robot is given: add --urdf ROBOT.urdf (or --from estimate.json, with identified.urdf)")
    return description(options, [], options.model), configuration(options, options.model)


def designed_motion(robot: DescribedRobot, known: Configuration, options: MotionOptions) -> MotionDesign:
    """Design a motion by the options for a ``robot`` and its configuration ``known``."""
    task = excitation.design_task(robot.text, Path(robot.source), known, options)
    return MotionDesign(excitation.design(task, options))
