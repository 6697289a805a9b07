"""Sequences of messages with faults of all kinds, drawn at random, and pipelines that are fed with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.samples import Samples
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import SignalSettings

from .feeding import JOINTS, blocks, in_time, jittered, joint_messages, pipeline_of, regular, without, wrench_messages
from .sent import JointMessage, Message

TURN = 2.0 * np.pi
Change = Callable[[np.random.Generator, list[Message]], list[Message]]


def with_number(message: JointMessage, key: str, place: int, value: float) -> JointMessage:
    """The message with another number in one place."""
    values = np.array(getattr(message, key), dtype=float)
    values[place % len(values)] = value
    return replace(message, **{key: values})


def _some(rng: np.random.Generator, messages: list[Message], count: int) -> set[int]:
    return set(rng.integers(40, len(messages), rng.integers(1, count)).tolist())


def _early(rng: np.random.Generator, messages: list[Message]) -> list[Message]:
    places, ahead = _some(rng, messages, 6), int(rng.integers(5_000_000, 900_000_000))
    return [replace(m, stamp=m.stamp + ahead) if place in places else m for place, m in enumerate(messages)]


def _late(rng: np.random.Generator, messages: list[Message]) -> list[Message]:
    places, behind = _some(rng, messages, 6), int(rng.integers(0, 200_000_000))
    return [replace(m, stamp=m.stamp - behind) if place in places else m for place, m in enumerate(messages)]


def _glitch(rng: np.random.Generator, messages: list[Message]) -> list[Message]:
    places, key = _some(rng, messages, 8), rng.choice(["position", "effort"])
    places |= {place + 1 for place in places if rng.random() < 0.5}
    joint, value = int(rng.integers(3)), rng.choice([0.0, 1.5, -40.0, 300.0, float("nan")])
    return [
        with_number(m, key, joint, value) if place in places and isinstance(m, JointMessage) else m
        for place, m in enumerate(messages)
    ]


def _wrap(rng: np.random.Generator, messages: list[Message]) -> list[Message]:
    joint, level = int(rng.integers(3)), rng.uniform(-1.0, 1.0)

    def wrapped(message: Message) -> Message:
        if not isinstance(message, JointMessage):
            return message
        place = joint % len(message.position)
        value = float(np.remainder(message.position[place] - level, TURN) + level)
        return with_number(message, "position", place, value)

    return [wrapped(message) for message in messages]


def _bursts(rng: np.random.Generator, messages: list[Message]) -> list[Message]:
    size, kind = int(rng.integers(2, 8)), rng.choice([JointMessage, type(messages[-1])])
    begin, first, result = int(rng.integers(len(messages))), {}, []
    for place, message in enumerate(messages):
        if place < begin or not isinstance(message, kind):
            result.append(message)
            continue
        key = type(message), message.names if isinstance(message, JointMessage) else ()
        stamp, count = first.get(key, (0, size))
        first[key] = (message.stamp, 0) if count >= size else (stamp, count + 1)
        result.append(replace(message, stamp=first[key][0] + 1000 * first[key][1]))
    return result


def _again(rng: np.random.Generator, messages: list[Message]) -> list[Message]:
    """The clock of one source, or of all, is set back or ahead."""
    begin, by = int(rng.integers(60, len(messages))), int(rng.choice([-3e9, -2e8, 2e8, 3e9]))
    kinds = rng.choice([0, 1, 2])
    return [
        replace(m, stamp=m.stamp + by)
        if place >= begin and (kinds == 0 or isinstance(m, JointMessage) == (kinds == 1))
        else m
        for place, m in enumerate(messages)
    ]


def _odd(rng: np.random.Generator, messages: list[Message]) -> list[Message]:
    """Some come again with something that they cannot be used with, or with their numbers a little later."""
    places, frozen = _some(rng, messages, 30), int(rng.integers(1, 4))
    odd: list[Callable[[Any], Any]] = [
        lambda m: replace(m, stamp=int(rng.integers(-1, 1))),
        lambda m: replace(m, effort=()) if isinstance(m, JointMessage) else replace(m, frame="base"),
        lambda m: replace(m, effort=np.zeros(len(m.names)), velocity=()) if isinstance(m, JointMessage) else m,
        lambda m: replace(m, names=m.names[::-1]) if isinstance(m, JointMessage) else m,
        lambda m: without(m, "elbow") if isinstance(m, JointMessage) else m,
    ]
    result = []
    for place, message in enumerate(messages):
        result.append(message)
        if place in places:
            result.append(odd[rng.integers(len(odd))](message))
            result += [replace(message, stamp=message.stamp + 1000 * step) for step in range(1, frozen)]
    return result


def _lost(rng: np.random.Generator, messages: list[Message]) -> list[Message]:
    begin, count = int(rng.integers(len(messages))), int(rng.integers(1, 150))
    return messages[:begin] + messages[begin + count :]


def _twice(rng: np.random.Generator, messages: list[Message]) -> list[Message]:
    begin, count = int(rng.integers(len(messages))), int(rng.integers(1, 60))
    return messages[: begin + count] + messages[begin:]


def _dead(rng: np.random.Generator, messages: list[Message]) -> list[Message]:
    """A publisher that ends, often with a message that is off."""
    end, which = int(rng.integers(60, len(messages))), messages[int(rng.integers(len(messages)))]
    names = getattr(which, "names", None)
    left = [m for place, m in enumerate(messages) if place < end or getattr(m, "names", None) != names]
    if isinstance(which, JointMessage) and rng.random() < 0.7:
        ends = [place for place, m in enumerate(left) if getattr(m, "names", None) == names]
        last = left[ends[-1]]
        left[ends[-1]] = replace(with_number(last, "position", 0, 2.5), stamp=last.stamp + 30_000_000)  # type: ignore[arg-type]
    return left


CHANGES: tuple[Change, ...] = (_early, _late, _glitch, _odd, _wrap, _bursts, _again, _lost, _twice, _dead)


def spoiled(rng: np.random.Generator, *, merge: bool) -> list[Message]:
    """Messages of a robot and a wrench sensor, in the order in which they come, with one to four kinds of faults."""
    duration = rng.uniform(2.0, 3.5)
    joints = joint_messages(jittered(0.01, duration, int(rng.integers(99))), velocity=bool(rng.integers(2)))
    topics: list[Sequence[Message]] = [joints]
    if merge:
        parts = [without(m, "wrist") for m in joints], [without(without(m, "elbow"), "shoulder") for m in joints]
        topics = [parts[0], [replace(m, stamp=m.stamp + 3_000_000) for m in parts[1]][:: int(rng.integers(1, 3))]]
    messages = in_time(*topics, wrench_messages(regular(rng.choice([0.004, 0.01]), duration, offset=0.0007)))
    for change in rng.choice(len(CHANGES), rng.integers(1, 5)):
        messages = CHANGES[change](rng, messages)
    return messages


def pipeline(*, merge: bool, **told: Any) -> SignalPipeline:
    """Of this robot and its sensor."""
    sensor = WrenchSensor("/wrench", "tool", "mounted", axes=("fx", "fz"))
    limits = np.array([[3.0, np.inf, 4.0], [80.0, np.inf, 20.0]])
    settings = SignalSettings(merge=merge)
    return pipeline_of(
        JOINTS, sensors=[sensor], settings=settings, continuous=["wrist"], turning=JOINTS, limits=limits, **told
    )


def in_parts(target: SignalPipeline, messages: Sequence[Message], ends: Sequence[int]) -> Samples | None:
    """Push messages in blocks that end there, and collect when no more will come."""
    begin = 0
    for end in (*ends, len(messages)):
        if end > begin:
            target.push(blocks(messages[begin:end]))
        begin = max(begin, end)
    target.release()
    return target.collect()
