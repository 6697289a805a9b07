"""What is recorded of a run."""

from __future__ import annotations

from dataclasses import dataclass, replace

from geomid_ros.simulation.motion import SetPoints
from geomid_ros.types import FloatArray, IntArray

_PER_JOINT = ("position", "velocity", "acceleration", "effort", "fine_effort", "feedforward")


@dataclass(frozen=True, eq=False)
class RunTrace:
    """Samples of n joints at T instants.

    Attributes:
        time: ``(T,)`` [s].
        position, velocity, acceleration, effort: ``(T, n)``. Without effects of measurement the effort is what the
            motors supply, and all four satisfy the equation of motion exactly.
        wrench_time: Instants ``(T,)`` of the wrench [s].
        wrench: ``(T, 6)`` in its frame, or ``(T, 0)``.
        commands, feedforward: The controller's set-points and feed-forward efforts ``(T, n)`` at ``time``.
        fine_time, fine_effort: Every step of the integration ``(F,)`` [s], and the efforts there ``(F, n)``.
    """

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    effort: FloatArray
    wrench_time: FloatArray
    wrench: FloatArray
    commands: SetPoints
    feedforward: FloatArray
    fine_time: FloatArray
    fine_effort: FloatArray

    def reordered(self, order: IntArray) -> RunTrace:
        """The same samples with the joints in another ``order (n,)``."""
        commands = SetPoints(*(values[:, order] for values in vars(self.commands).values()))
        return replace(self, commands=commands, **{name: getattr(self, name)[:, order] for name in _PER_JOINT})
