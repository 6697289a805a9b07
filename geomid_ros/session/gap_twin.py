"""Whether a simulator's recording is one of the same motion as the robot's."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.model.samples import Samples
from geomid_ros.session.recordings import check_efforts
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

_LENGTHS = 0.1  # relative difference of two recordings of one motion
_MOTIONS = 0.5  # of the larger one's standard deviation: a simulation lags and droops, but does the same
_STILL = 0.02  # [rad, m] standard deviation of a joint that does not move
_LONGEST_SHIFT = 2.0  # [s] between the beginnings of the two recordings and of the motion in them
_STEP = 0.02  # [s]


def check_twin(session: Session, simulated: Path, twin: Samples, recorded: Path, measured: Samples) -> None:
    """Refuse a simulator's recording that does not match the measured one, naming both and what differs."""
    check_efforts(session, [twin], [simulated])
    lengths = [float(samples.stamps[-1] - samples.stamps[0]) * 1e-9 for samples in (twin, measured)]
    if abs(lengths[0] - lengths[1]) > _LENGTHS * max(lengths):
        raise InputError(
            f"{simulated}: {lengths[0]:.1f} s of simulation for the {lengths[1]:.1f} s of {recorded}. Record the "
            "simulator under the same commands, from their beginning to their end"
        )
    difference = _differences(_on_a_grid(twin), _on_a_grid(measured))
    spread = np.maximum(np.maximum(np.std(twin.position, axis=0), np.std(measured.position, axis=0)), _STILL)
    worst = int(np.argmax(difference / spread))
    if difference[worst] > _MOTIONS * spread[worst]:
        raise InputError(
            f"{simulated}: joint '{session.robot.joint_names[worst]}' moves otherwise than in {recorded}, by "
            f"{difference[worst]:.2g} on average where it moves by {spread[worst]:.2g}. Record the simulator under the "
            "same commands, from the same pose"
        )


def _on_a_grid(samples: Samples) -> FloatArray:
    """Positions ``(N, joints)`` every ``_STEP`` from the first sample on."""
    times = (samples.stamps - samples.stamps[0]) * 1e-9
    grid = np.arange(0.0, times[-1] + 1e-9, _STEP)
    return np.stack([np.interp(grid, times, np.unwrap(column)) for column in samples.position.T], axis=1)


def _differences(a: FloatArray, b: FloatArray) -> FloatArray:
    """Root mean square difference of positions ``(joints,)`` at the shift at which all are most alike."""
    most = round(_LONGEST_SHIFT / _STEP)
    shifts = [shift for shift in range(-most, most + 1) if abs(shift) < min(len(a), len(b))]
    found = [_rms(a[max(shift, 0) :], b[max(-shift, 0) :]) for shift in shifts]
    return found[int(np.argmin([np.sum(rms**2) for rms in found]))]


def _rms(a: FloatArray, b: FloatArray) -> FloatArray:
    count = min(len(a), len(b))
    rms: FloatArray = np.sqrt(np.mean((a[:count] - b[:count]) ** 2, axis=0))
    return rms
