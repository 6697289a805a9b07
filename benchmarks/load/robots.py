"""Robots that move without end, and their messages as bytes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from files.recordings import BAGS
from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

_NOISE = 0.2  # N m, N
_TONES = 5
_AMPLITUDE = 0.1  # [rad] of each: together slower than the limits, as real robots are
_HIGHEST = 1.0  # [Hz] of a tone, about
_BATCH = 500  # instants: the rows of many at once would not fit into memory
_LIMBS = {"left_arm": 7, "right_arm": 7, "left_leg": 6, "right_leg": 6}
_TORSO = 4


@dataclass(frozen=True)
class Robot:
    """A description, and the frames of wrench sensors by their names."""

    name: str
    urdf: str
    frames: dict[str, str]

    @property
    def parameters(self) -> dict[str, Any]:
        """Of its node."""
        sensors = {name: {"topic": f"{name}/wrench", "frame": frame} for name, frame in self.frames.items()}
        return {"robot_description": self.urdf, "wrenches": list(sensors), "wrench": sensors}

    @property
    def kinds(self) -> dict[str, type]:
        """Of the messages, by topic."""
        return {"joint_states": JointState, **{f"{name}/wrench": WrenchStamped for name in self.frames}}

    def messages(self, rate: float, period: float) -> dict[str, FloatArray]:
        """By topic: messages as bytes ``(messages, length)`` of a motion that begins anew after ``period`` [s].

        Their stamps are to be filled in (:data:`STAMP`).
        """
        flat = {f"wrench.{name}.{key}": v for name, s in self.parameters["wrench"].items() for key, v in s.items()}
        session = Session(self.urdf, Configuration({"wrenches": list(self.frames), **flat}), self.name)
        motion, targets = _motion(session, round(rate * period), period)
        names, joints = list(session.robot.joint_names), len(session.robot.joints)
        states = np.concatenate([motion[0], motion[1], targets[:, :joints]], axis=1)
        marks = _marks(3 * joints)
        joint_state = JointState(
            name=names, position=marks[:joints], velocity=marks[joints : 2 * joints], effort=marks[2 * joints :]
        )
        messages = {"joint_states": _filled(joint_state, marks, states)}
        for index, (name, frame) in enumerate(self.frames.items()):
            first = joints + 6 * index
            messages[f"{name}/wrench"] = _filled(_wrench(frame), _marks(6), targets[:, first : first + 6])
        return messages


STAMP = 4
"""Where a message's stamp begins: after the header of CDR, as an int32 and a uint32."""


def robots() -> dict[str, Robot]:
    """An arm of 7 joints with a sensor at its wrist; a body of 30 joints with sensors at hands and feet."""
    arm = Robot("arm7", (BAGS / "arm7.urdf").read_text(encoding="utf-8"), {"wrist": "wrist_ft"})
    body = Robot("body30", _body(), {limb: f"{limb}_sensor" for limb in _LIMBS})
    return {robot.name: robot for robot in (arm, body)}


def _body() -> str:
    parts = ['<link name="pelvis"/>', *_chain("pelvis", "torso", _TORSO)]
    for limb, joints in _LIMBS.items():
        root = f"torso{_TORSO - 1}" if "arm" in limb else "pelvis"
        parts += [*_chain(root, limb, joints), _link(f"{limb}_sensor", 0.5)]
        parts.append(_joint(f"{limb}{joints - 1}", f"{limb}_sensor", "fixed"))
    return f'<robot name="body30">{"".join(parts)}</robot>'


def _chain(parent: str, name: str, joints: int) -> Iterator[str]:
    for index in range(joints):
        yield _link(f"{name}{index}", 2.0)
        axis = " ".join("1" if index % 3 == place else "0" for place in range(3))
        limit = '<limit lower="-3" upper="3" effort="100" velocity="20"/>'
        yield _joint(parent, f"{name}{index}", "revolute", f'<axis xyz="{axis}"/>{limit}')
        parent = f"{name}{index}"


def _link(name: str, mass: float) -> str:
    inertia = f'ixx="{0.01 * mass}" iyy="{0.01 * mass}" izz="{0.005 * mass}" ixy="0" ixz="0" iyz="0"'
    return (
        f'<link name="{name}"><inertial><origin xyz="0 0 0.1"/><mass value="{mass}"/>'
        f"<inertia {inertia}/></inertial></link>"
    )


def _joint(parent: str, child: str, kind: str, more: str = "") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 0.2"/>'
    return f'<joint name="{child}_joint" type="{kind}">{ends}{more}</joint>'


def _motion(session: Session, count: int, period: float) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """Position, velocity, acceleration, each ``(count, joints)``, and what the channels measure."""
    rng, model, joints = np.random.default_rng(0), session.model, len(session.robot.joints)
    speeds = 2.0 * np.pi / period * rng.integers(1, max(2, round(_HIGHEST * period)) + 1, (_TONES, joints))
    phases = rng.uniform(0.0, 2.0 * np.pi, (_TONES, joints))
    motion = tuple(np.empty((count, joints)) for _ in range(3))
    targets = np.empty((count, len(model.channels)))
    truth = np.append(1.1 * model.nominal_inertias, np.full(len(model.coefficients), 0.3))
    for begin in range(0, count, _BATCH):
        part = slice(begin, min(count, begin + _BATCH))
        angles = speeds * (period / count * np.arange(part.start, part.stop)[:, None, None]) + phases
        derivatives = np.sin(angles), speeds * np.cos(angles), -(speeds**2) * np.sin(angles)
        for whole, values in zip(motion, derivatives, strict=True):
            whole[part] = _AMPLITUDE * values.sum(1)
        targets[part] = model.rows(_samples(session, [whole[part] for whole in motion])).coefficients @ truth
    return motion, targets + _NOISE * rng.normal(size=targets.shape)


def _samples(session: Session, motion: list[FloatArray]) -> Samples:
    count, nothing = len(motion[0]), np.zeros((len(motion[0]), 0))
    wrenches = np.zeros((count, len(session.model.sensors), 6))
    stamps = np.arange(1, count + 1)
    return Samples(stamps, *motion, np.zeros_like(motion[0]), nothing, nothing, nothing, wrenches)


def _wrench(frame: str) -> WrenchStamped:
    message = WrenchStamped()
    message.header.frame_id = frame
    force, torque = message.wrench.force, message.wrench.torque
    force.x, force.y, force.z, torque.x, torque.y, torque.z = _marks(6)
    return message


def _marks(count: int) -> list[float]:
    """Numbers that can be found again among a message's bytes."""
    return [1e300 * (1.0 + 1e-3 * index) for index in range(count)]


def _filled(message: Any, marks: list[float], values: FloatArray) -> FloatArray:
    """The message's bytes, once for each row of ``values (N, numbers)``, in the place of its marks."""
    data = bytes(serialize_message(message))
    rows = np.tile(np.frombuffer(data, dtype=np.uint8), (len(values), 1))
    for column, mark in enumerate(marks):
        place = data.index(np.float64(mark).tobytes())
        rows[:, place : place + 8] = np.ascontiguousarray(values[:, column]).view(np.uint8).reshape(-1, 8)
    return rows
