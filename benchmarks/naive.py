"""What a short script does: read a bag, filter, build the regressor, solve least squares.

python benchmarks/naive.py BAG URDF

Nothing is checked, and nothing is estimated but the parameters: of the links about their frames' origins, and at every
joint viscous and dry friction, rotor inertia and an offset. It is written for speed: one pass over the bag, joints by
the order of the first message, all motions filtered at once.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
from rosbags.highlevel import AnyReader
from scipy.signal import butter, sosfiltfilt

_CUTOFF = 5.0  # [Hz]
_RATE = 100.0  # [Hz]
_STILL = 0.01  # [rad/s] below which dry friction has no sign


def main(bag: Path, urdf: Path) -> None:
    """Print the masses of the links."""
    model = pin.buildModelFromUrdf(str(urdf))
    names, stamps, position, effort = read(bag)
    order = [names.index(name) for name in model.names[1:]]
    times = np.arange(stamps[0], stamps[-1], 1.0 / _RATE)
    both = np.hstack([position[:, order], effort[:, order]])
    even = np.column_stack([np.interp(times, stamps, column) for column in both.T])
    smooth = sosfiltfilt(butter(4, _CUTOFF, fs=_RATE, output="sos"), even, axis=0)
    q, tau = np.split(smooth, 2, axis=1)
    dq = np.gradient(q, 1.0 / _RATE, axis=0)
    ddq = np.gradient(dq, 1.0 / _RATE, axis=0)
    regressor = rows(model, q, dq, ddq)
    solution = np.linalg.lstsq(regressor, tau.ravel(), rcond=None)[0]
    for name, mass in zip(model.names[1:], solution[: 10 * model.nv : 10], strict=True):
        print(f"{name}: {mass:.3f} kg")
    residual = (regressor @ solution - tau.ravel()).reshape(tau.shape)
    print("rms [N m]:", *np.sqrt(np.mean(residual**2, axis=0)).round(3))


def read(bag: Path) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray]:
    """Names of the joints, stamps [s], positions and efforts ``(N, joints)``."""
    with AnyReader([bag]) as reader:
        chosen = [connection for connection in reader.connections if connection.topic == "/joint_states"]
        messages = [reader.deserialize(raw, topic.msgtype) for topic, _, raw in reader.messages(chosen)]
    stamps = np.array([message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec for message in messages])
    position, effort = (np.array([getattr(message, what) for message in messages]) for what in ("position", "effort"))
    return messages[0].name, stamps, position, effort


def rows(model: pin.Model, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    """The regressor ``(N joints, 14 joints)``."""
    data, count = model.createData(), model.nv
    result = np.zeros((len(q), count, 14 * count))
    for index in range(len(q)):
        links = pin.computeJointTorqueRegressor(model, data, q[index], dq[index], ddq[index])
        result[index, :, : 10 * count] = links
    sign = np.where(np.abs(dq) > _STILL, np.sign(dq), 0.0)
    for joint in range(count):
        effects = (dq[:, joint], sign[:, joint], ddq[:, joint], 1.0)
        for kind, column in enumerate(effects):
            result[:, joint, (10 + kind) * count + joint] = column
    return result.reshape(-1, 14 * count)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
