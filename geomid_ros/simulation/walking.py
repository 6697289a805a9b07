"""A quadruped in MuJoCo that sways, lifts its legs and trots, with encoders, motor efforts and an IMU.

Nothing measures the base's pose or the forces of the ground.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.simulation.bag import write_walk
from geomid_ros.simulation.description import (
    Description,
    LinkInertia,
    body_of,
    perturbed,
    pseudo_inertia,
    read_description,
)
from geomid_ros.simulation.gaits import GAITS, WalkOptions
from geomid_ros.simulation.motion import WalkTrace
from geomid_ros.simulation.options import LONGEST_STEP, RandomStream, generator
from geomid_ros.simulation.plant import buildable, load_mujoco, rigid_bodies
from geomid_ros.simulation.recording import beside, link_entry, refuse_existing
from geomid_ros.simulation.robots import robot_description
from geomid_ros.types import FloatArray

_PER_SET_POINT = 10  # steps
_STANCE = (0.0, 0.8, -1.6)  # [rad] hip, thigh and knee of a leg that stands
_STIFFNESS, _DAMPING = 250.0, 5.0  # of the joints' controllers [N m/rad], [N m s/rad]
_SETTLING = 1.0  # [s] before the motion begins, not recorded
_CONTACT = (0.006, 1.0)  # MuJoCo's solref of the ground: time constant [s], damping ratio
_SETTLED = 1e-6  # [m] at which the inverse kinematics stop
_UPRIGHT = 0.7  # cosine of the trunk's tilt; beyond it the robot has fallen


def simulate_walk(out: Path, options: WalkOptions) -> tuple[Path, Path]:
    """Record a walking robot in the new bag ``out``, and the truth in ``<out>.truth.json``. Returns both paths.

    Raises:
        InputError: a file exists already, or the robot cannot walk like this.
    """
    truth = beside(out, "truth.json")
    refuse_existing(out, truth)
    robot = read_description(robot_description(options.robot))
    bodies = true_bodies(robot, options)
    trace = measured(walk(robot, bodies, options), options)
    write_walk(out, trace, [joint.name for joint in robot.joints], robot.text, options.imu)
    document = {"links": [link_entry(body, True) for body in bodies], "options": asdict(options)}
    truth.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return out, truth


def true_bodies(robot: Description, options: WalkOptions) -> list[LinkInertia]:
    """The robot's links as they are: the URDF's with an error, and the payload on the root link."""
    numbers = generator(options.seed, RandomStream.INERTIA)
    bodies = [perturbed(body, options.inertia_error, numbers) for body in robot.inertias]
    if not options.payload:
        return bodies
    box = LinkInertia("", options.payload, np.array(options.payload_at), 2e-3 * options.payload * np.eye(3))
    return [
        body_of(body.name, pseudo_inertia(body) + pseudo_inertia(box)) if body.name == robot.root else body
        for body in bodies
    ]


def walk(robot: Description, bodies: Sequence[LinkInertia], options: WalkOptions) -> WalkTrace:
    """The true motion. Raises InputError if the robot falls, or a foot or the IMU is no link of it."""
    mujoco = load_mujoco()
    for link in (*options.feet, options.imu):
        if link not in robot.links:
            raise unknown_name("link", link, robot.links)
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
    every = round(1.0 / (options.rate * LONGEST_STEP))
    rows = []
    for step in range(-round(_SETTLING / LONGEST_STEP), len(position)):
        wanted = max(step, 0)
        state = data.qpos[7:].copy(), data.qvel[6:].copy()
        mujoco.mj_step1(model, data)
        data.ctrl[:] = _STIFFNESS * (position[wanted] - state[0]) + _DAMPING * (velocity[wanted] - state[1])
        mujoco.mj_step2(model, data)
        if step >= 0 and step % every == 0:
            contacts = [data.sensor(foot).data[0] for foot in options.feet]
            sensors = data.sensor("gyroscope").data.copy(), data.sensor("accelerometer").data.copy()
            rows.append((step * LONGEST_STEP, *state, data.actuator_force.copy(), *sensors, np.array(contacts)))
            if data.xmat[1, 8] < _UPRIGHT:
                raise InputError(f"the robot falls after {step * LONGEST_STEP:.1f} s of {', '.join(options.gaits)}")
    names = ("time", "position", "velocity", "effort", "angular_velocity", "specific_force", "contact")
    return WalkTrace(**dict(zip(names, map(np.array, zip(*rows, strict=True)), strict=True)))


def measured(trace: WalkTrace, options: WalkOptions) -> WalkTrace:
    """The trace with the sensors' noise and biases."""
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
        spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)  # the effort of damping is that of now
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
    """The ground, and round feet that feel it."""
    ground = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0])
    ground.solref[:2] = _CONTACT
    for foot, radius in feet.items():
        ball = spec.body(foot).add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0.0, 0.0])
        ball.solref[:2], ball.friction[:1] = _CONTACT, [1.0]
        ball.contype, ball.conaffinity = 1, 0
        spec.body(foot).add_site(name=foot, size=[2.0 * radius, 0.0, 0.0])
        spec.add_sensor(name=foot, type=mujoco.mjtSensor.mjSENS_TOUCH, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=foot)


def _set_points(mujoco: Any, model: Any, options: WalkOptions) -> tuple[FloatArray, FloatArray]:
    """Positions and velocities ``(steps, joints)`` that bring the feet where the gaits want them."""
    numbers = generator(options.recording_seed, RandomStream.MOTION)
    data = mujoco.MjData(model)
    data.qpos[:7] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    data.qpos[7:] = np.tile(_STANCE, len(options.feet))
    mujoco.mj_kinematics(model, data)
    home = np.array([data.body(foot).xpos for foot in options.feet])
    step = LONGEST_STEP * _PER_SET_POINT
    time = np.arange(0.0, options.duration / len(options.gaits), step)
    ways = [GAITS[gait](time, home, numbers) for gait in options.gaits]
    trunk, feet = (np.concatenate(parts) for parts in zip(*ways, strict=True))
    wanted = np.empty((len(trunk), model.nu))
    for row, pose, moved in zip(wanted, trunk, home + feet, strict=True):
        rotation = _rotation(mujoco, pose[3:])
        row[:] = _joints_at(mujoco, model, data, (moved - pose[:3]) @ rotation, list(options.feet))
    coarse, fine = step * np.arange(len(wanted)), LONGEST_STEP * np.arange(len(wanted) * _PER_SET_POINT)
    position = np.array([np.interp(fine, coarse, column) for column in wanted.T]).T
    return position, np.gradient(position, LONGEST_STEP, axis=0)


def _rotation(mujoco: Any, vector: FloatArray) -> FloatArray:
    quaternion, matrix = np.empty(4), np.empty(9)
    angle = float(np.linalg.norm(vector))
    mujoco.mju_axisAngle2Quat(quaternion, vector / max(angle, 1e-12), angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _joints_at(mujoco: Any, model: Any, data: Any, wanted: FloatArray, feet: Sequence[str]) -> FloatArray:
    """The joints' positions at which the feet are at ``wanted (feet, 3)`` in the trunk's frame, from those in
    ``data`` on by Newton's method."""
    jacobians = np.empty((len(feet), 3, model.nv))
    for _ in range(20):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        missing = wanted - np.array([data.body(foot).xpos for foot in feet])
        if np.max(np.abs(missing)) < _SETTLED:
            return np.array(data.qpos[7:])
        for jacobian, foot in zip(jacobians, feet, strict=True):
            mujoco.mj_jacBody(model, data, jacobian, None, model.body(foot).id)
        data.qpos[7:] += np.linalg.lstsq(jacobians.reshape(-1, model.nv)[:, 6:], missing.ravel(), rcond=None)[0]
    raise InputError("the feet do not reach where the gait wants them: the legs are too short")
