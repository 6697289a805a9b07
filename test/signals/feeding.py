"""Messages made from formulas, and pipelines fed with them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.robot import Joint
from geomid_ros.model.samples import Column, Samples
from geomid_ros.signals.joint_messages import JointReader
from geomid_ros.signals.messages import Block
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.types import FloatArray, IntArray

from .sent import JointMessage, Message, WrenchMessage

START = 1_700_000_000_000_000_000  # [ns] an ordinary day's clock
JOINTS = ("shoulder", "elbow", "wrist")
AT_ONCE = 240  # messages


def seconds(stamps: IntArray) -> FloatArray:
    """Seconds since ``START``."""
    return (np.asarray(stamps) - START) * 1e-9


def regular(period: float, duration: float, offset: float = 0.0) -> IntArray:
    """Stamps ``(N,)`` every ``period`` seconds."""
    return START + np.round((offset + period * np.arange(int(duration / period))) * 1e9).astype(np.int64)


def jittered(period: float, duration: float, seed: int = 0) -> IntArray:
    """Stamps off the regular ones by up to a third of the period."""
    stamps = regular(period, duration)
    return stamps + np.random.default_rng(seed).integers(-int(period / 3e-9), int(period / 3e-9), len(stamps))


@dataclass(frozen=True)
class Motion:
    """Joints that move as sums of two sines below the cutoff, each joint its own; efforts likewise."""

    frequencies: FloatArray = field(default_factory=lambda: np.array([[0.3, 0.9], [0.5, 1.3], [0.7, 1.1]]))
    amplitudes: FloatArray = field(default_factory=lambda: np.array([[1.0, 0.2], [0.8, 0.1], [0.5, 0.3]]))

    def derivative(self, stamps: IntArray, order: int) -> FloatArray:
        """Position ``(N, joints)`` for order 0, then its derivatives."""
        rate = 2.0 * np.pi * self.frequencies
        phase = seconds(stamps)[:, None, None] * rate + 0.5 * np.pi * order
        return np.sum(self.amplitudes * rate**order * np.sin(phase), axis=2)

    def effort(self, stamps: IntArray) -> FloatArray:
        """Efforts ``(N, joints)``."""
        return 10.0 * np.cos(2.0 * np.pi * seconds(stamps)[:, None] * self.frequencies[:, 0])


def joint_messages(stamps: IntArray, motion: Motion | None = None, velocity: bool = False) -> list[JointMessage]:
    """Joint messages of a motion."""
    motion = motion or Motion()
    position, rate, effort = motion.derivative(stamps, 0), motion.derivative(stamps, 1), motion.effort(stamps)
    return [
        JointMessage(int(stamp), JOINTS, position[i], rate[i] if velocity else (), effort[i])
        for i, stamp in enumerate(stamps)
    ]


def wrench_messages(stamps: IntArray) -> list[WrenchMessage]:
    """Wrenches of six sines."""
    return [
        WrenchMessage("/wrench", int(stamp), "tool", wrench)
        for stamp, wrench in zip(stamps, wrenches(stamps), strict=True)
    ]


def wrenches(stamps: IntArray) -> FloatArray:
    """The wrenches' formula, ``(N, 6)``."""
    return np.sin(2.0 * np.pi * seconds(stamps)[:, None] * np.linspace(0.2, 1.2, 6) + np.arange(6.0))


def in_time(*topics: Iterable[Message]) -> list[Message]:
    """All messages in the order of their stamps."""
    return sorted((message for topic in topics for message in topic), key=lambda message: message.stamp)


def blocks(messages: Sequence[Message]) -> list[Block]:
    """Those of one layout in one block, as a decoder gives them."""
    groups: dict[Any, list[tuple[int, Message, tuple[FloatArray, ...]]]] = {}
    for place, message in enumerate(messages):
        arrays = message.arrays
        layout = (message.topic, message.names, *(array.shape[0] for array in arrays))
        groups.setdefault(layout, []).append((place, message, arrays))
    return [
        Block(
            topic,
            np.array([place for place, _, _ in several]),
            np.array([message.stamp for _, message, _ in several]),
            names,
            tuple(map(np.array, zip(*(arrays for _, _, arrays in several), strict=True))),
        )
        for (topic, names, *_), several in groups.items()
    ]


def pipeline_of(
    joints: Sequence[str],
    *,
    floating_base: bool = False,
    sensors: Sequence[WrenchSensor] = (),
    settings: SignalSettings | None = None,
    continuous: Sequence[str] = (),
    turning: Sequence[str] = (),
    limits: FloatArray | None = None,
    effect_columns: tuple[Column, ...] = (),
    **others: Any,
) -> SignalPipeline:
    """A pipeline of joints that no URDF describes."""
    speeds, efforts = np.full((2, len(joints)), np.inf) if limits is None else limits
    robot = SimpleNamespace(
        joint_names=tuple(joints),
        joints=[Joint(name, 0, 0, name in continuous, "N m" if name in turning else "N") for name in joints],
        floating_base=floating_base,
        speed_limits=speeds,
        effort_limits=efforts,
    )
    model: Any = SimpleNamespace(robot=robot, sensors=sensors, columns=effect_columns, legs=None)
    return SignalPipeline(model, settings or SignalSettings(), **others)


def push(pipeline: SignalPipeline, messages: Iterable[Message]) -> Iterator[None]:
    """Push messages, many at once: test_blocks holds that this makes no difference. Yields after each time."""
    waiting = list(messages)
    for begin in range(0, len(waiting), AT_ONCE):
        pipeline.push(blocks(waiting[begin : begin + AT_ONCE]))
        yield


def completed(pipeline: SignalPipeline, messages: Iterable[Message]) -> Iterator[Samples]:
    """The samples that messages complete."""
    for _ in push(pipeline, messages):
        samples = pipeline.collect()
        if samples is not None:
            yield samples


def feed(pipeline: SignalPipeline, messages: Iterable[Message]) -> Samples:
    """Push all messages, and collect when no more will come."""
    for _ in push(pipeline, messages):
        pass
    pipeline.release()
    samples = pipeline.collect()
    assert samples is not None
    return samples


class RejectedError(Exception):
    """A reader refuses a message."""


def read(reader: JointReader, message: JointMessage) -> FloatArray:
    """What a reader makes of one message ``(3 joints,)``. Raises RejectedError."""
    block = Block.of(message)
    numbers, (refusal,) = reader.numbers(block)
    if refusal is not None:
        raise RejectedError(refusal)
    values, (refusal,) = reader.read(block.stamps, numbers)
    if refusal is not None:
        raise RejectedError(refusal)
    return values[0]


def without(message: JointMessage, joint: str) -> JointMessage:
    """The message without one of its joints."""
    kept = [place for place, name in enumerate(message.names) if name != joint]
    arrays: dict[str, Any] = {
        key: [getattr(message, key)[place] for place in kept] if len(getattr(message, key)) else ()
        for key in ("position", "velocity", "effort")
    }
    return replace(message, names=tuple(message.names[place] for place in kept), **arrays)


def assert_same(actual: Samples, expected: Samples, tolerance: float = 1e-9) -> None:
    """All arrays of two batches agree, relative to the size of each column."""
    np.testing.assert_array_equal(actual.stamps, expected.stamps)
    assert len(actual) > 0
    assert actual.entries == expected.entries
    for kind in expected.arrays.keys() - {"stamps"}:
        first, second = actual.arrays[kind], expected.arrays[kind]
        assert first.shape == second.shape
        size = np.maximum(np.nanmax(np.abs(second), axis=0, initial=0.0), 1e-3)
        np.testing.assert_allclose(first / size, second / size, rtol=0, atol=tolerance, err_msg=kind)


def balanced(pipeline: SignalPipeline, messages: Sequence[Message]) -> bool:
    """Whether the ledger accounts for every message."""
    accounts = pipeline.ledger.topics.values()
    return sum(account.received for account in accounts) + pipeline.waiting_count == len(messages)
