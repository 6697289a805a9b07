"""Sequences of messages, as topics bring them."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.fuzz.target import require
from geomid_ros.commands.live import shared_file
from geomid_ros.errors import GeomidError
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import IMU, JOINT_STATES, ODOM, parse
from geomid_ros.signals.pipeline import SignalPipeline

_START = 1_700_000_000_000_000_000
_WRENCH = "wrist"
_ODD = (math.nan, math.inf, -math.inf, 1e308, -1e308, 1e-308, 0.0, -0.0, 1e9, 1e17, 3.0)
_LONGEST = (10, 40, 40, 150)  # messages
_VALUES: tuple[dict[str, Any], ...] = (
    {},
    {"filter.period": 0.01},
    {"filter.max_gap": 0.05, "filter.cutoff": 20.0},
    {"floating_base": True, "wrenches": [_WRENCH], "wrench.wrist.frame": "world", "wrench.wrist.role": "external"},
    {"wrenches": [_WRENCH], "wrench.wrist.frame": "tool", "wrench.wrist.sign": -1.0, "joint.joint2.effort_gain": -0.5},
    {"locked_joints": ["joint1"]},
    {"imu.frame": "base_link", "contacts": ["tool:0.02"]},
)


@dataclass
class _Source:
    """A clock and the way a publisher goes wrong."""

    stamp: int
    period: int
    faults: float
    sent: Counter[str] = field(default_factory=Counter)


class MessagesTarget:
    """Every message is accepted, rejected or dropped; samples are finite and in order."""

    def __init__(self, folder: Path) -> None:
        del folder
        urdf = shared_file("bags/arm3.urdf").read_text(encoding="utf-8")
        configurations = [
            Configuration({"gap.memory": 0.0, "effects": ["viscous_friction", "coulomb_friction"], **values})
            for values in _VALUES
        ]
        self._sessions = [Session(urdf, configuration, "arm3.urdf") for configuration in configurations]

    def attempt(self, random: Random) -> None:
        """Make a sequence, and feed it."""
        session = random.choice(self._sessions)
        pipeline = session.new_pipeline()
        source = _Source(_START, random.choice((10**6, 10**7, 10**7, 10**8)), random.choice((0.0, 0.02, 0.2, 0.9)))
        for _ in range(random.randint(1, random.choice(_LONGEST))):
            self._send(session, pipeline, source, random)
            self._check(session, pipeline, source)
        pipeline.release()
        require(pipeline.waiting_count == 0, "messages are still held")
        self._check(session, pipeline, source)

    def _send(self, session: Session, pipeline: SignalPipeline, source: _Source, random: Random) -> None:
        _advance(source, random)
        topic = random.choice((JOINT_STATES, JOINT_STATES, *session.topics))
        source.sent[topic] += 1
        try:
            pipeline.push(parse(topic, _message(topic, session, source, random)))
        except GeomidError:
            return  # settings do not fit the messages' rate

    def _check(self, session: Session, pipeline: SignalPipeline, source: _Source) -> None:
        accounts = pipeline.ledger.topics
        told = {
            topic: account.accepted + account.rejected.total() + account.dropped.total()
            for topic, account in accounts.items()
        }
        require(sum(told.values()) + pipeline.waiting_count == source.sent.total(), f"{told} of {source.sent}")
        require(all(told[topic] <= source.sent[topic] for topic in told), f"{told} of {source.sent}")
        samples = pipeline.collect()
        if samples is None:
            return
        require(np.all(np.diff(samples.stamps) > 0), "samples that are not in order")
        for values in (samples.position, samples.velocity, samples.acceleration, samples.base_pose, samples.wrenches):
            require(np.all(np.isfinite(values)), "samples that are no numbers")
        require(not np.any(np.isinf(samples.effort)), "efforts that are no numbers")
        session.model.rows(samples)


def _advance(source: _Source, random: Random) -> None:
    source.stamp += source.period // 2 + random.randint(0, source.period // 20)
    if random.random() < 0.2 * source.faults:
        jump = random.choice((10**7, 10**8, 10**9, 10**10, 10**12, 10**17))
        source.stamp += random.choice((-1, 1)) * random.randint(0, jump)


def _message(topic: str, session: Session, source: _Source, random: Random) -> Any:
    if topic == JOINT_STATES:
        return _joint_state(session, source, random)
    if topic == IMU:
        return _imu(source, random)
    return _odometry(source, random) if topic == ODOM else _wrench(session, source, random)


def _header(source: _Source, random: Random) -> Any:
    seconds, nanoseconds = divmod(max(0, source.stamp), 10**9)
    frame = "tool"
    if random.random() < source.faults:
        seconds = random.choice((seconds, 0, -1, 2**31 - 1, -(2**31)))
        nanoseconds = random.choice((nanoseconds, nanoseconds, 0, 10**9, 2**32 - 1))
        frame = random.choice(("tool", "", "world", "link1", "\x1b[2J", "x" * 1000))
    return SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds), frame_id=frame)


def _numbers(count: int, source: _Source, random: Random) -> Any:
    values = [random.uniform(-1.0, 1.0) for _ in range(count)]
    if random.random() < source.faults:
        for _ in range(random.randint(0, 2)):
            if values:
                values[random.randrange(count)] = random.choice(_ODD)
        values = random.choice((values, values, values, [], values[:-1], values * 2))
    return random.choice((list, tuple, np.array))(values)


def _joint_state(session: Session, source: _Source, random: Random) -> Any:
    names = list(session.robot.joint_names)
    if random.random() < 0.3:
        random.shuffle(names)
    if random.random() < source.faults:
        change = random.randrange(5)
        names = [names[:-1], [*names, "finger"], [*names, names[0]], [], [f"left_{n}" for n in names]][change]
    parts = (_numbers(len(names), source, random) for _ in range(3))
    position, velocity, effort = parts
    return SimpleNamespace(
        header=_header(source, random), name=names, position=position, velocity=velocity, effort=effort
    )


def _odometry(source: _Source, random: Random) -> Any:
    angle = random.uniform(-0.1, 0.1)
    x, y, z, qx, qy, qz, qw = 0.0, 0.0, 1.0, 0.0, 0.0, math.sin(angle), math.cos(angle)
    if random.random() < source.faults:
        x, qw = random.choice(_ODD), random.choice(_ODD)
    pose = SimpleNamespace(position=SimpleNamespace(x=x, y=y, z=z), orientation=SimpleNamespace(x=qx, y=qy, z=qz, w=qw))
    return SimpleNamespace(header=_header(source, random), pose=SimpleNamespace(pose=pose))


def _imu(source: _Source, random: Random) -> Any:
    values = [random.uniform(-1.0, 1.0) for _ in range(6)]
    values[5] += 9.81
    if random.random() < source.faults:
        values[random.randrange(6)] = random.choice(_ODD)
    turning, force = (SimpleNamespace(x=v[0], y=v[1], z=v[2]) for v in (values[:3], values[3:]))
    covariance = np.full(9, random.choice((0.0, 0.0, -1.0)) if random.random() < source.faults else 0.0)
    return SimpleNamespace(
        header=_header(source, random),
        orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=covariance,
        angular_velocity=turning,
        angular_velocity_covariance=covariance,
        linear_acceleration=force,
        linear_acceleration_covariance=covariance,
    )


def _wrench(session: Session, source: _Source, random: Random) -> Any:
    values = [random.uniform(-10.0, 10.0) for _ in range(6)]
    if random.random() < source.faults:
        values[random.randrange(6)] = random.choice(_ODD)
    header = _header(source, random)
    if random.random() > source.faults:
        header.frame_id = session.model.sensors[0].frame
    force, torque = (SimpleNamespace(x=v[0], y=v[1], z=v[2]) for v in (values[:3], values[3:]))
    return SimpleNamespace(header=header, wrench=SimpleNamespace(force=force, torque=torque))
