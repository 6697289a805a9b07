"""Simulations of held-out data before and after, as the gap's page shows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np

from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.resimulation.resimulate import Resimulated
from geomid_ros.resimulation.windows import HORIZON
from geomid_ros.session.written_simulation import Simulations
from geomid_ros.types import FloatArray

Kind: TypeAlias = Literal["windows", "closed_loop"]
SENTENCES: Mapping[Kind, str] = {
    "windows": f"Velocities simulated in MuJoCo with the written MJCF. The measured efforts are applied; every "
    f"{HORIZON:g} s the simulation restarts from the measured state.",
    "closed_loop": "Efforts simulated in MuJoCo with the written MJCF: the whole motion under the recorded commands, "
    "with the controller that explains the measured efforts best.",
}
"""How it was simulated, by kind."""


def _nothing() -> FloatArray:
    return np.zeros((0, 0))


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedAgain:
    """The robot's simulation before and after, beside what was measured.

    Attributes:
        kind: how it was simulated.
        errors: {before, after}, each by channel in units of the floor.
        joints: names of the columns; their ``units``.
        times: ``(N,)`` [s].
        measured, before, after: ``(N, joints)``, NaN where a new simulation begins.
    """

    kind: Kind
    errors: Mapping[str, Mapping[str, float]]
    joints: Sequence[str] = ()
    units: Sequence[str] = ()
    times: FloatArray = field(default_factory=_nothing)
    measured: FloatArray = field(default_factory=_nothing)
    before: FloatArray = field(default_factory=_nothing)
    after: FloatArray = field(default_factory=_nothing)

    @property
    def sentence(self) -> str:
        """How it was simulated."""
        return SENTENCES[self.kind]


def simulated_again(model: MeasurementModel, simulations: Simulations) -> list[SimulatedAgain]:
    """The simulations that there are, in short windows first."""
    velocities, efforts = [f"{unit}/s" for unit in position_units(model)], [joint.unit for joint in model.robot.joints]
    windows, loop = simulations.windows, simulations.closed_loop
    return [
        *([_again("windows", windows, model.robot.joint_names, velocities)] if windows else []),
        *([_again("closed_loop", loop, model.robot.joint_names, efforts)] if loop else []),
    ]


def _again(kind: Kind, found: Resimulated, joints: Sequence[str], units: Sequence[str]) -> SimulatedAgain:
    lines = {
        name: np.concatenate([_broken(getattr(trace, name)) for trace in found.traces])
        for name in ("measured", "before", "after")
    }
    times = _in_a_row([_ends_repeated(trace.times) for trace in found.traces])
    errors = {"before": found.before, "after": found.after}
    return SimulatedAgain(kind=kind, errors=errors, joints=joints, units=units, times=times, **lines)


def position_units(model: MeasurementModel) -> list[str]:
    """Units of the joints' positions."""
    return ["m" if joint.unit == "N" else "rad" for joint in model.robot.joints]


def _broken(windows: FloatArray) -> FloatArray:
    """Windows ``(W, K, J)`` one after the other, with a break behind each, ``(W (K + 1), J)``."""
    joined = np.concatenate([windows, np.full_like(windows[:, -1:], np.nan)], axis=1)
    return joined.reshape(-1, windows.shape[2])


def _ends_repeated(times: FloatArray) -> FloatArray:
    """Times ``(W, K)`` that go with :func:`_broken`: the breaks take none."""
    return np.concatenate([times, times[:, -1:]], axis=1).ravel()


def _in_a_row(times: Sequence[FloatArray]) -> FloatArray:
    """Times of recordings, each after the one before."""
    starts = np.cumsum([0.0, *(part[-1] - part[0] for part in times[:-1])])
    return np.concatenate([part - part[0] + start for part, start in zip(times, starts, strict=True)])
