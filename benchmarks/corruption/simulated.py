"""Sound recordings of simulated arms: random true links, friction, noise, and encoders with steps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.corruption.recording import JOINTS, TYPES, Recording, Source
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

BAGS = Path(__file__).parents[2] / "bags"
RAIL = "rail"
ROBOTS = ("arm3", "arm7", RAIL)
"""Names of the simulated robots: those of ``bags``, and an arm on a rail with a telescope."""
SECONDS, RATE = 30.0, 100.0
_SPREAD = 0.2  # of each coordinate of a link's geodesic step from the URDF
_STEP = 2e-6  # [rad, m] of an encoder
_SHARP = 0.01  # [rad/s, m/s] within which dry friction turns
_GRAVITY = (0.0, 0.0, -9.81)
_CHAIN = (
    # type, axis, origin, mass, half length of the link, effort limit
    ("prismatic", "1 0 0", "0 0 0.3", 12.0, 0.15, 900.0),
    ("revolute", "0 0 1", "0 0 0.2", 6.0, 0.12, 200.0),
    ("revolute", "0 1 0", "0 0.05 0.25", 5.0, 0.18, 200.0),
    ("revolute", "0 1 0", "0.35 -0.05 0", 3.0, 0.15, 100.0),
    ("prismatic", "1 0 0", "0.3 0 0", 1.5, 0.1, 150.0),
)


def rail_urdf() -> str:
    """URDF of an arm of three revolute joints between a rail and a telescope, which are prismatic."""
    parts, parent = [], "base"
    for number, (kind, axis, origin, mass, half, effort) in enumerate(_CHAIN, 1):
        across, along = mass * half**2 / 3.0, mass * half**2 / 8.0
        parts.append(
            f'<link name="link{number}"><inertial><origin xyz="{half} 0.02 0.03"/><mass value="{mass}"/>'
            f'<inertia ixx="{along}" ixy="0" ixz="0" iyy="{across}" iyz="0" izz="{across}"/></inertial></link>'
            f'<joint name="joint{number}" type="{kind}"><parent link="{parent}"/><child link="link{number}"/>'
            f'<origin xyz="{origin}"/><axis xyz="{axis}"/>'
            f'<limit lower="-3" upper="3" effort="{effort}" velocity="4"/></joint>'
        )
        parent = f"link{number}"
    return f'<robot name="{RAIL}"><link name="base"/>{"".join(parts)}</robot>'


def simulated(name: str, seed: int) -> Recording:
    """A recording of 30 s of a robot of :data:`ROBOTS` with its own random truth and motion."""
    urdf = rail_urdf() if name == RAIL else (BAGS / f"{name}.urdf").read_text(encoding="utf-8")
    robot = Robot(urdf, source=name)
    rng = np.random.default_rng([seed, ROBOTS.index(name)])
    times = np.arange(round(SECONDS * RATE)) / RATE
    position, velocity, acceleration = _motion(rng, times, [joint.unit == "N" for joint in robot.joints])
    effort = _efforts(rng, robot, position, velocity, acceleration)
    effort += 0.01 * np.std(effort, axis=0) * rng.normal(size=effort.shape)
    names = list(robot.joint_names)
    return Recording(
        source=Source(bag=Path(f"{name}-{seed}"), urdf=Path(f"{name}.urdf")),
        urdf=urdf,
        robot=robot,
        messages=[("/joint_states", JOINTS, round(time * 1e9), _message(names)) for time in times],
        stamps=times,
        position=_STEP * np.round(position / _STEP),
        velocity=velocity + 1e-3 * rng.normal(size=velocity.shape),
        effort=effort,
        wrench=np.zeros((0, 6)),
        wrench_stamps=np.zeros(0),
        gravity=np.array(_GRAVITY),
    )


def _motion(rng: np.random.Generator, times: FloatArray, slides: list[bool]) -> FloatArray:
    """Positions, speeds and accelerations of five sines a joint, from rest within a second ``(3, N, joints)``."""
    begun = np.minimum(times, 1.0)[:, None]
    rate, change = begun**2 * (3.0 - 2.0 * begun), 6.0 * begun * (1.0 - begun)
    passed = begun**3 - 0.5 * begun**4 + np.maximum(times[:, None] - 1.0, 0.0)
    moved = np.zeros((3, len(times), len(slides)))
    for harmonic in range(1, 6):
        omega = 2.0 * np.pi * harmonic / 10.0
        size = np.where(slides, 0.3, 0.8) * rng.normal(size=len(slides)) / harmonic
        angle = omega * passed + rng.uniform(0.0, 2.0 * np.pi, size=len(slides))
        first, second = omega * np.cos(angle), -(omega**2) * np.sin(angle)
        moved += size * np.stack([np.sin(angle), rate * first, rate**2 * second + change * first])
    return moved


def _efforts(
    rng: np.random.Generator, robot: Robot, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Efforts of random links near the URDF's, of friction, rotors and offsets ``(N, joints)``."""
    bodies = np.array([body.parameters for body in robot.bodies]).ravel()
    manifold = ParameterManifold(len(robot.bodies), 0, np.zeros(0))
    start = manifold.point(bodies)
    blocks, _ = manifold.jacobian(start)
    step = np.concatenate([block @ (_SPREAD * rng.normal(size=10)) for block in blocks])
    links = bodies + 0.5 * step  # half of it: second moments stay positive
    none = np.zeros((len(position), 0))
    stamps = np.arange(len(position), dtype=np.int64)
    samples = Samples(
        stamps, position, velocity, acceleration, 0.0 * position, none, none, none, np.zeros((len(position), 0, 6))
    )
    rows = robot.with_gravity(np.array(_GRAVITY)).joint_effort_rows(*robot.configuration(samples))
    rigid = rows.reshape(len(position), len(robot.joints), -1) @ links
    scale = np.std(rigid, axis=0)
    viscous, dry, offset = (share * scale * rng.uniform(0.3, 1.0, scale.shape) for share in (0.1, 0.15, 0.05))
    return np.asarray(rigid + viscous * velocity + dry * np.tanh(velocity / _SHARP) + offset)


def _message(names: list[str]) -> Any:
    joint_state, header, time = (
        TYPES.types[kind] for kind in (JOINTS, "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    none = np.zeros(0)
    return joint_state(
        header=header(stamp=time(sec=0, nanosec=0), frame_id=""), name=names, position=none, velocity=none, effort=none
    )


def rested(recording: Recording, seconds: float) -> Recording:
    """The recording with a rest of so many seconds in front: the first message again and again, with sensor noise."""
    count = round(seconds / np.median(np.diff(recording.stamps)))
    rng = np.random.default_rng(0)

    def before(values: FloatArray) -> FloatArray:
        noise = 0.5 * np.std(np.diff(values, n=2, axis=0), axis=0) / np.sqrt(6.0)
        return np.concatenate([values[0] + noise * rng.normal(size=(count, values.shape[1])), values])

    period = float(np.median(np.diff(recording.stamps)))
    wait = period * np.arange(count)
    later = recording.stamps + period * count
    topic, kind, begin, first = next(message for message in recording.messages if message[1] == JOINTS)
    after = [
        (own, type_, time + round(1e9 * period * count), message) for own, type_, time, message in recording.messages
    ]
    still = (
        None
        if recording.velocity is None
        else np.concatenate([np.zeros((count, recording.velocity.shape[1])), recording.velocity])
    )
    return replace(
        recording,
        messages=[*((topic, kind, begin + round(1e9 * time), first) for time in wait), *after],
        wrench_stamps=recording.wrench_stamps + period * count,
        stamps=np.concatenate([recording.stamps[0] + wait, later]),
        position=before(recording.position),
        velocity=still,
        effort=before(recording.effort),
    )
