"""What is noted of a run."""

from __future__ import annotations

from dataclasses import dataclass, replace

from geomid_ros.simulation.motion import Motion
from geomid_ros.types import FloatArray, IntArray

_PER_JOINT = ("position", "velocity", "acceleration", "effort", "fine_effort", "feedforward")


@dataclass(frozen=True, eq=False)
class Trace:
    """Samples of T instants: ``time (T,)`` [s] and joints ``(T, n)``, all of a row at one instant.

    Without effects of measurement the effort is what the motors supply at that position and velocity, and with the
    accelerations it satisfies the equation of motion exactly. ``wrench (T, 6)`` or ``(T, 0)`` is sampled at its own
    instants ``wrench_time (T,)``, in its frame. ``commands`` and ``feedforward (T, n)`` are the controller's set-points
    and its feed-forward efforts at ``time``. ``fine_effort (F, n)`` are the efforts at ``fine_time (F,)``, every step
    of the integration.
    """

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    effort: FloatArray
    wrench_time: FloatArray
    wrench: FloatArray
    commands: Motion
    feedforward: FloatArray
    fine_time: FloatArray
    fine_effort: FloatArray

    def reordered(self, order: IntArray) -> Trace:
        """The same samples with the joints in another ``order (n,)``."""
        commands = Motion(*(values[:, order] for values in vars(self.commands).values()))
        return replace(self, commands=commands, **{name: getattr(self, name)[:, order] for name in _PER_JOINT})
