"""Quadruped in MuJoCo that sways, lifts its legs and trots, with encoders, motor efforts and an IMU.

The base's pose and the ground's forces are not measured.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.errors import InputError, check_name
from geomid_ros.options import Options, option
from geomid_ros.simulation.bag import write_walk
from geomid_ros.simulation.description import (
    Description,
    LinkInertia,
    body_of,
    perturbed,
    pseudo_inertia,
    read_description,
    robot_description,
)
from geomid_ros.simulation.motion import WalkTrace
from geomid_ros.simulation.options import LONGEST_STEP, RandomStream, generator
from geomid_ros.simulation.plant import buildable, load_mujoco, rigid_bodies
from geomid_ros.simulation.recording import companion_path, link_entry, refuse_existing
from geomid_ros.types import FloatArray

_SHORTEST = 4.0  # [s] duration of a gait
_SMALLEST, _LARGEST = 1e-3, 1.0  # radii of feet [m]
_FADE = 0.7  # [s] of fading at the beginning and the end of a motion
_PERIOD, _SWING = 0.6, 0.4  # of the trot [s], and the fraction of it in which a foot is lifted

Gait = Callable[[FloatArray, FloatArray, np.random.Generator], tuple[FloatArray, FloatArray]]
"""From times ``(N,)`` and the feet's positions at rest ``(feet, 3)`` to displacements from rest: of the trunk
``(N, 6)``, translation and rotation vector, and of the feet ``(N, feet, 3)``."""


def _faded(time: FloatArray, wait: float = 0.0) -> FloatArray:
    """Smooth factor from 0 to 1 and back ``(N, 1)``, with a ``wait`` [s] at 0 at both ends."""
    fraction = np.clip((np.minimum(time, time[-1] - time) - wait) / _FADE, 0.0, 1.0)
    return np.asarray(fraction**2 * (3.0 - 2.0 * fraction))[:, None]


def _sway(time: FloatArray, size: FloatArray, numbers: np.random.Generator) -> FloatArray:
    """Random sums of sines ``(N, len(size))``, faded at both ends."""
    frequency = numbers.uniform(0.3, 1.5, (4, len(size)))
    phase = numbers.uniform(0.0, 2.0 * np.pi, frequency.shape)
    waves = np.sin(2.0 * np.pi * frequency * time[:, None, None] + phase)
    return np.asarray(_faded(time) * size * np.sum(waves, axis=1) / 3.0)


def _wobble(time: FloatArray, home: FloatArray, numbers: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    trunk = _sway(time, np.array([0.025, 0.02, 0.02, 0.08, 0.08, 0.08]), numbers)
    return trunk, np.zeros((len(time), *home.shape))


def _lift(time: FloatArray, home: FloatArray, numbers: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Lift and move one foot after another, with the trunk over the other feet."""
    trunk = _sway(time, np.array([0.005, 0.005, 0.01, 0.03, 0.03, 0.04]), numbers)
    feet = np.zeros((len(time), *home.shape))
    for foot, part in enumerate(np.array_split(np.arange(len(time)), len(home))):
        elapsed = time[part] - time[part[0]]
        trunk[part, :2] -= 0.3 * home[foot, :2] * _faded(elapsed)
        height = np.array([0.0, 0.0, 0.09])
        feet[part, foot] = _faded(elapsed, _FADE) * (height + _sway(elapsed, np.array([0.05, 0.04, 0.02]), numbers))
    return trunk, feet


def _trot(time: FloatArray, home: FloatArray, numbers: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Step on the spot, with diagonal feet together."""
    trunk = _sway(time, np.array([0.005, 0.005, 0.005, 0.02, 0.02, 0.02]), numbers)
    feet = np.zeros((len(time), *home.shape))
    for foot, (x, y, _) in enumerate(home):
        phase = (time / _PERIOD + (0.5 if x * y > 0.0 else 0.0)) % 1.0
        swing = np.clip(phase / _SWING, 0.0, 1.0)
        feet[:, foot, 2] = 0.05 * np.sin(np.pi * swing) ** 2 * _faded(time)[:, 0]
    return trunk, feet


GAITS: dict[str, Gait] = {"wobble": _wobble, "lift": _lift, "trot": _trot}
"""Gaits by name: sway with all feet down, lift the feet one by one, trot on the spot."""


@dataclass(frozen=True, kw_only=True)
class WalkOptions(Options):
    """Quadruped with its hidden truth, gaits and sensors. SI units; Gaussian noise is given by its standard deviation.

    Attributes:
        robot: path of the URDF (the nominal model). Each leg has three joints: hip, thigh and knee.
        feet: radius of each foot [m], by the link whose origin is the foot's centre.
        imu: link of the IMU.
        gaits: performed in turn, each for the same time; from :data:`GAITS`.
        payload: mass on the trunk that the URDF lacks [kg], at ``payload_at`` in the root link's frame.
        inertia_error: relative error of the URDF's inertias.
        seed: fixes the robot; ``motion_seed`` motion and noise (``seed`` unless given).
        gyroscope_bias, accelerometer_bias: standard deviations of constant errors.
    """

    robot: str
    feet: Mapping[str, float]
    imu: str
    gaits: Sequence[str] = ("wobble", "lift", "trot")
    duration: float = 36.0
    rate: float = option(500.0, min=1.0, max=1.0 / LONGEST_STEP)
    seed: int = 1
    motion_seed: int | None = None
    payload: float = option(3.0, min=0.0)
    payload_at: tuple[float, float, float] = (0.04, 0.02, 0.08)
    inertia_error: float = option(0.1, min=0.0, max=1.0)
    viscous_friction: float = 0.1
    coulomb_friction: float = 0.2
    rotor_inertia: float = 0.01
    position_noise: float = 1e-4
    velocity_noise: float = 1e-2
    effort_noise: float = 0.1
    gyroscope_noise: float = 0.005
    gyroscope_bias: float = 0.003
    accelerometer_noise: float = 0.05
    accelerometer_bias: float = 0.02

    def __post_init__(self) -> None:
        super().__post_init__()
        for gait in self.gaits:
            check_name("gait", gait, GAITS)
        shortest = _SHORTEST * len(self.gaits)
        if not shortest <= self.duration < math.inf:
            raise InputError(f"duration is {self.duration:g}, expected {shortest:g} or more")
        for foot, radius in self.feet.items():
            if not _SMALLEST <= radius <= _LARGEST:
                raise InputError(f"radius of {foot} is {radius:g}, expected {_SMALLEST:g} to {_LARGEST:g}")
        stride = 1.0 / (self.rate * LONGEST_STEP)
        if not math.isclose(stride, round(stride)):
            raise InputError(
                f"rate is {self.rate:g}; it must be {1.0 / LONGEST_STEP:g} Hz divided by an integer, e.g. 250 Hz"
            )

    @property
    def recording_seed(self) -> int:
        """Seed of the motion and of the noise."""
        return self.seed if self.motion_seed is None else self.motion_seed


def parse_feet(texts: Sequence[str]) -> dict[str, float]:
    """Parse ``LINK:RADIUS`` [m] to radii by link. Raises InputError for another form."""
    feet = {}
    for text in texts:
        link, _, radius = text.partition(":")
        try:
            feet[link] = float(radius)
        except ValueError as error:
            raise InputError(f"foot '{text}' is not of the form LINK:RADIUS, e.g. FL_foot:0.022 [m]") from error
    return feet


_PER_SET_POINT = 10  # integration steps per set-point
_STANCE = (0.0, 0.8, -1.6)  # [rad] hip, thigh and knee of a standing leg
_STIFFNESS, _DAMPING = 250.0, 5.0  # of the joints' controllers [N m/rad], [N m s/rad]
_SETTLING = 1.0  # [s] before the motion begins, not recorded
_CONTACT = (0.006, 1.0)  # MuJoCo's solref of the ground: time constant [s], damping ratio
_SETTLED = 1e-6  # [m] tolerance of the inverse kinematics
_UPRIGHT = 0.7  # cosine of the trunk's tilt; beyond it the robot has fallen


def simulate_walk(out: Path, options: WalkOptions) -> tuple[Path, Path]:
    """Record a walking robot in the new bag ``out``, and the truth in ``<out>.truth.json``. Returns both paths.

    Raises:
        InputError: a file exists already, or the robot cannot walk like this.
    """
    truth = companion_path(out, "truth.json")
    refuse_existing(out, truth)
    robot = read_description(robot_description(options.robot))
    bodies = true_bodies(robot, options)
    trace = with_sensor_noise(walk(robot, bodies, options), options)
    write_walk(out, trace, [joint.name for joint in robot.joints], robot.text, options.imu)
    document = {"links": [link_entry(body, True) for body in bodies], "options": asdict(options)}
    truth.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return out, truth


def true_bodies(robot: Description, options: WalkOptions) -> list[LinkInertia]:
    """True bodies of the robot: those of the URDF with an error, and the payload on the root link."""
    numbers = generator(options.seed, RandomStream.INERTIA)
    bodies = [perturbed(body, options.inertia_error, numbers) for body in robot.inertias]
    if not options.payload:
        return bodies
    box = LinkInertia(robot.root, options.payload, np.array(options.payload_at), 2e-3 * options.payload * np.eye(3))
    if all(body.name != robot.root for body in bodies):  # its trunk is fixed to a frame
        return [box, *bodies]
    return [
        body_of(body.name, pseudo_inertia(body) + pseudo_inertia(box)) if body.name == robot.root else body
        for body in bodies
    ]


def walk(robot: Description, bodies: Sequence[LinkInertia], options: WalkOptions) -> WalkTrace:
    """Simulate the true motion. Raises InputError if the robot falls, or lacks a link for a foot or the IMU."""
    mujoco = load_mujoco()
    for link in (*options.feet, options.imu):
        check_name("link", link, robot.links)
    if len(robot.joints) != len(_STANCE) * len(options.feet):
        raise InputError(
            f"the robot has {len(robot.joints)} moving joints and {len(options.feet)} feet; a robot that walks has "
            f"{len(_STANCE)} at each leg and no others"
        )
    model = _compiled(mujoco, robot, bodies, options)
    data = mujoco.MjData(model)
    position, velocity = _set_points(mujoco, model, options)
    data.qpos[7:] = position[0]
    mujoco.mj_kinematics(model, data)
    lowest = min(data.body(foot).xpos[2] - radius for foot, radius in options.feet.items())
    data.qpos[2] -= lowest
    stride = round(1.0 / (options.rate * LONGEST_STEP))
    rows = []
    for step in range(-round(_SETTLING / LONGEST_STEP), len(position)):
        target = max(step, 0)
        state = data.qpos[7:].copy(), data.qvel[6:].copy()
        mujoco.mj_step1(model, data)
        data.ctrl[:] = _STIFFNESS * (position[target] - state[0]) + _DAMPING * (velocity[target] - state[1])
        mujoco.mj_step2(model, data)
        if step >= 0 and step % stride == 0:
            contacts = [data.sensor(foot).data[0] for foot in options.feet]
            sensors = data.sensor("gyroscope").data.copy(), data.sensor("accelerometer").data.copy()
            rows.append((step * LONGEST_STEP, *state, data.actuator_force.copy(), *sensors, np.array(contacts)))
            if data.xmat[1, 8] < _UPRIGHT:
                raise InputError(f"the robot falls after {step * LONGEST_STEP:.1f} s of {', '.join(options.gaits)}")
    return WalkTrace(*map(np.array, zip(*rows, strict=True)))


def with_sensor_noise(trace: WalkTrace, options: WalkOptions) -> WalkTrace:
    """Add the sensors' noise and biases to a trace."""
    numbers = generator(options.recording_seed, RandomStream.NOISE)

    def noisy(values: FloatArray, level: float, bias: float = 0.0) -> FloatArray:
        constant = bias * numbers.standard_normal(values.shape[1])
        return np.asarray(values + constant + level * numbers.standard_normal(values.shape))

    return replace(
        trace,
        position=noisy(trace.position, options.position_noise),
        velocity=noisy(trace.velocity, options.velocity_noise),
        effort=noisy(trace.effort, options.effort_noise),
        angular_velocity=noisy(trace.angular_velocity, options.gyroscope_noise, options.gyroscope_bias),
        specific_force=noisy(trace.specific_force, options.accelerometer_noise, options.accelerometer_bias),
    )


def _compiled(mujoco: Any, robot: Description, bodies: Sequence[LinkInertia], options: WalkOptions) -> Any:
    with buildable():
        spec = rigid_bodies(mujoco, robot, bodies)
        spec.option.timestep = LONGEST_STEP
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio = 10.0
        spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)  # damping acts by the present velocity
        for joint, limits in zip(spec.joints, robot.joints, strict=True):
            joint.damping, joint.frictionloss = [options.viscous_friction, 0.0, 0.0], options.coulomb_friction
            joint.armature = options.rotor_inertia
            spec.add_actuator(
                trntype=mujoco.mjtTrn.mjTRN_JOINT,
                target=joint.name,
                forcelimited=1,
                forcerange=[-limits.effort, limits.effort],
            )
        spec.body(robot.root).add_freejoint()
        _set_on_feet(mujoco, spec, options.feet)
        spec.body(options.imu).add_site(name="imu")
        kinds = {"gyroscope": mujoco.mjtSensor.mjSENS_GYRO, "accelerometer": mujoco.mjtSensor.mjSENS_ACCELEROMETER}
        for name, kind in kinds.items():
            spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="imu")
        return spec.compile()


def _set_on_feet(mujoco: Any, spec: Any, feet: Mapping[str, float]) -> None:
    """Add the ground, and spherical feet with touch sensors."""
    ground = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0])
    ground.solref[:2] = _CONTACT
    for foot, radius in feet.items():
        ball = spec.body(foot).add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0.0, 0.0])
        ball.solref[:2], ball.friction[:1] = _CONTACT, [1.0]
        ball.contype, ball.conaffinity = 1, 0
        spec.body(foot).add_site(name=foot, size=[2.0 * radius, 0.0, 0.0])
        spec.add_sensor(name=foot, type=mujoco.mjtSensor.mjSENS_TOUCH, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=foot)


def _set_points(mujoco: Any, model: Any, options: WalkOptions) -> tuple[FloatArray, FloatArray]:
    """Joint positions and velocities ``(steps, joints)`` that move trunk and feet as the gaits require."""
    numbers = generator(options.recording_seed, RandomStream.MOTION)
    data = mujoco.MjData(model)
    data.qpos[:7] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    data.qpos[7:] = np.tile(_STANCE, len(options.feet))
    mujoco.mj_kinematics(model, data)
    home = np.array([data.body(foot).xpos for foot in options.feet])
    step = LONGEST_STEP * _PER_SET_POINT
    time = np.arange(0.0, options.duration / len(options.gaits), step)
    paths = [GAITS[gait](time, home, numbers) for gait in options.gaits]
    trunk, feet = (np.concatenate(parts) for parts in zip(*paths, strict=True))
    knots = np.empty((len(trunk), model.nu))
    for row, pose, foot_positions in zip(knots, trunk, home + feet, strict=True):
        rotation = _rotation(mujoco, pose[3:])
        row[:] = _joints_at(mujoco, model, data, (foot_positions - pose[:3]) @ rotation, list(options.feet))
    coarse, fine = step * np.arange(len(knots)), LONGEST_STEP * np.arange(len(knots) * _PER_SET_POINT)
    position = np.array([np.interp(fine, coarse, column) for column in knots.T]).T
    return position, np.gradient(position, LONGEST_STEP, axis=0)


def _rotation(mujoco: Any, vector: FloatArray) -> FloatArray:
    quaternion, matrix = np.empty(4), np.empty(9)
    angle = float(np.linalg.norm(vector))
    mujoco.mju_axisAngle2Quat(quaternion, vector / max(angle, 1e-12), angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _joints_at(mujoco: Any, model: Any, data: Any, targets: FloatArray, feet: Sequence[str]) -> FloatArray:
    """Solve the inverse kinematics by Newton's method, from the joint positions in ``data``, for feet at
    ``targets (feet, 3)`` in the trunk's frame."""
    jacobians = np.empty((len(feet), 3, model.nv))
    for _ in range(20):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        error = targets - np.array([data.body(foot).xpos for foot in feet])
        if np.max(np.abs(error)) < _SETTLED:
            return np.array(data.qpos[7:])
        for jacobian, foot in zip(jacobians, feet, strict=True):
            mujoco.mj_jacBody(model, data, jacobian, None, model.body(foot).id)
        data.qpos[7:] += np.linalg.lstsq(jacobians.reshape(-1, model.nv)[:, 6:], error.ravel(), rcond=None)[0]
    raise InputError("the inverse kinematics has no solution: the gait's foot targets are out of reach")
