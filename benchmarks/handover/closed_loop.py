"""The recorded commands of a robot, replayed through its PD controller into MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.types import FloatArray

_STEP = 1e-3  # [s]
_DELAYS = np.arange(0.0, 0.021, 0.001)  # [s] tried between a command and its effect


@dataclass(frozen=True, eq=False)
class Commanded:
    """A recording on its own stamps: ``times (N,)`` [s], measured ``positions`` and ``commands (N, joints)`` [rad], and
    the gains of the controller."""

    times: FloatArray
    positions: FloatArray
    commands: FloatArray
    kp: float
    kd: float

    def part(self, begin: float, end: float) -> Commanded:
        """The part between two shares of the time."""
        chosen = slice(round(begin * len(self.times)), round(end * len(self.times)))
        return Commanded(self.times[chosen], self.positions[chosen], self.commands[chosen], self.kp, self.kd)


def error(mjcf: str, joints: list[str], recording: Commanded, delay: float) -> float:
    """RMS of simulated minus measured positions [rad], of all joints."""
    return float(np.sqrt(np.mean((simulated(mjcf, joints, recording, delay) - recording.positions) ** 2)))


def best_delay(mjcf: str, joints: list[str], recording: Commanded) -> float:
    """The delay [s] of the commands with which the simulation is nearest to a recording."""
    return float(min(_DELAYS, key=lambda delay: error(mjcf, joints, recording, delay)))


def simulated(mjcf: str, joints: list[str], recording: Commanded, delay: float) -> FloatArray:
    """Positions ``(N, joints)`` that MuJoCo reaches under the commands, from the measured state at the beginning."""
    import mujoco as mj

    model = mj.MjModel.from_xml_string(mjcf)
    model.opt.timestep, model.opt.integrator = _STEP, mj.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= mj.mjtDisableBit.mjDSBL_CONTACT
    data = mj.MjData(model)
    ids = [model.joint(name).id for name in joints]
    qs, vs = model.jnt_qposadr[ids], model.jnt_dofadr[ids]
    data.qpos[qs] = recording.positions[0]
    first = recording.times[:5] - recording.times[0]
    data.qvel[vs] = np.polyfit(first, recording.positions[:5], 1)[0]
    instants = np.arange(recording.times[0], recording.times[-1], _STEP)
    # A command holds until the next one comes.
    held = np.searchsorted(recording.times, instants - delay, side="right") - 1
    wanted = recording.commands[np.maximum(held, 0)]
    reached = np.empty((len(instants), len(joints)))
    for index, command in enumerate(wanted):
        reached[index] = data.qpos[qs]
        data.qfrc_applied[vs] = recording.kp * (command - data.qpos[qs]) - recording.kd * data.qvel[vs]
        mj.mj_step(model, data)
    return _at(instants, reached, recording.times)


def _at(times: FloatArray, values: FloatArray, instants: FloatArray) -> FloatArray:
    return np.stack([np.interp(instants, times, column) for column in values.T], axis=1)
