"""Serialised messages are decoded by the layout of one of them: the same numbers as message by message."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from files.recordings import BAGS, TYPES, recorded

from geomid_ros.signals import messages as module
from geomid_ros.signals.message_batch import imu_readings
from geomid_ros.signals.messages import IMU, JOINT_STATES, ODOM, Block, Decoder, Raw, message_type, parse

NAMES = {"/joint_states": JOINT_STATES, "/wrench": "/wrench"}
KIND = TYPES.types
ITEMS = [item for item in recorded(BAGS / "arm3")[:200] if item.topic in NAMES]


def imu(index: int) -> Any:
    vector = KIND["geometry_msgs/msg/Vector3"]
    return KIND["sensor_msgs/msg/Imu"](
        replace(ITEMS[0].message.header, frame_id="imu_link"),
        KIND["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.6, 0.8),
        np.full(9, 0.1),
        vector(1.0, 2.0, float(index)),
        np.full(9, 0.2 * index),
        vector(4.0, 5.0, 6.0 + index),
        np.full(9, 0.3),
    )


def odometry(index: int) -> Any:
    vector, number = KIND["geometry_msgs/msg/Vector3"], float(index)
    place, turn = KIND["geometry_msgs/msg/Point"](1.0, 2.0, number), imu(index).orientation
    twist = KIND["geometry_msgs/msg/Twist"](vector(number, 0.0, 0.0), vector(0.0, 0.0, 0.0))
    return KIND["nav_msgs/msg/Odometry"](
        replace(ITEMS[0].message.header, frame_id="odometry"),
        "base",
        KIND["geometry_msgs/msg/PoseWithCovariance"](KIND["geometry_msgs/msg/Pose"](place, turn), np.full(36, number)),
        KIND["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
    )


def serialised(topic: str, message: Any, little_endian: bool = True) -> Raw:
    return topic, bytes(TYPES.serialize_cdr(message, message_type(topic), little_endian=little_endian))


def messages() -> list[tuple[str, Any]]:
    """Joint states in two orders, some of them without velocities, some of another length; wrenches, poses whose
    velocities differ, and what IMUs send."""
    result = [(kind, make(index)) for index in range(5) for kind, make in ((ODOM, odometry), (IMU, imu))]
    for index, item in enumerate(ITEMS):
        message = item.message
        if item.topic == "/joint_states" and index % 7 == 3:
            keys = ("position", "velocity", "effort")
            message = replace(
                message, name=message.name[::-1], **{key: getattr(message, key)[::-1].copy() for key in keys}
            )
        if item.topic == "/joint_states" and index % 11 == 4:
            message = replace(message, velocity=np.zeros(0))
        if item.topic == "/wrench" and index % 5 == 0:
            message = replace(message, header=replace(message.header, frame_id="another" * (index % 3)))
        result.append((NAMES[item.topic], message))
    return result


def fail(place: int, why: str) -> None:
    pytest.fail(f"message {place}: {why}")


def assert_read(blocks: list[Block], expected: list[tuple[str, Any]]) -> None:
    """Every message is in one block, as the attributes of rosbags' say."""
    found = {int(place): (block, row) for block in blocks for row, place in enumerate(block.order)}
    assert sorted(found) == list(range(len(expected)))
    for place, (topic, message) in enumerate(expected):
        block, row = found[place]
        one = Block.of(parse(topic, message))
        assert (block.topic, block.names, block.stamps[row]) == (topic, one.names, one.stamps[0])
        for actual, array in zip(block.arrays, one.arrays, strict=True):
            np.testing.assert_array_equal(actual[row], array[0])


@pytest.mark.parametrize("little_endian", [True, False])
def test_messages_are_read_as_rosbags_reads_them(little_endian: bool) -> None:
    expected = messages()
    decoder = Decoder()
    raw = [serialised(topic, message, little_endian) for topic, message in expected]
    assert_read(decoder.blocks(raw, fail), expected)
    again = decoder.blocks(raw[:50], fail)
    assert_read(again, expected[:50])
    if little_endian:
        assert len(again) < 14, "known layouts"


def test_the_numbers_of_an_imu_stand_between_others() -> None:
    """Angular velocity and acceleration between orientation and covariances."""
    raw = [serialised(IMU, imu(index)) for index in range(5)]
    decoder = Decoder()
    decoder.blocks(raw, fail)
    (block,) = decoder.blocks(raw, fail)
    values, refusals = imu_readings(block)
    np.testing.assert_array_equal(values[3], [1.0, 2.0, 3.0, 4.0, 5.0, 9.0])
    assert set(refusals) == {None}


@pytest.mark.parametrize(("seconds", "nanoseconds"), [(1, 1_000_000_000), (-(2**31), 0)])
def test_a_stamp_that_is_not_valid_is_said_to_be_so(seconds: int, nanoseconds: int) -> None:
    first = ITEMS[0].message
    stamp = type(first.header.stamp)(seconds, nanoseconds)
    odd = replace(first, header=replace(first.header, stamp=stamp))
    topic = NAMES[ITEMS[0].topic]
    blocks = Decoder().blocks([serialised(topic, first), serialised(topic, odd)], fail)
    stamps = np.concatenate([block.stamps for block in blocks])
    assert stamps[1] == parse(topic, odd).stamp


def test_what_lies_between_the_fields_does_not_matter() -> None:
    """Some publishers leave what was in memory there."""
    topic, message = next(item for item in messages() if item[0] == JOINT_STATES)
    message = replace(message, header=replace(message.header, frame_id="ab"))
    raw = serialised(topic, message)[1]
    padded = bytearray(raw)
    assert padded[16:19] == b"ab\0"
    padded[19] = 77
    decoder = Decoder()
    decoder.blocks([(topic, raw)], fail)
    (block,) = decoder.blocks([(topic, raw), (topic, bytes(padded))], fail)
    np.testing.assert_array_equal(block.arrays[0][0], block.arrays[0][1])


SPOILED: dict[str, Callable[[bytes, int], bytes]] = {  # of a message, and where its first name is
    "cut": lambda data, _: data[:-9],
    "longer": lambda data, _: data + bytes(8),
    "text": lambda data, name: data[:name] + b"\xff" + data[name + 1 :],
    "count": lambda data, name: data[: name - 8] + b"\xc8" + data[name - 7 :],
    "encoding": lambda data, _: data[:1] + b"\x07" + data[2:],
}


@pytest.mark.parametrize("spoil", SPOILED)
def test_other_bytes_are_refused_and_the_rest_is_read(spoil: str) -> None:
    raw = [serialised(*item) for item in messages() if item[0] == JOINT_STATES][:20]
    data = raw[10][1]
    raw[10] = (JOINT_STATES, SPOILED[spoil](data, data.index(b"joint1")))
    refused: list[int] = []
    decoder = Decoder()
    decoder.blocks(raw[:3], fail)
    blocks = decoder.blocks(raw, lambda place, _: refused.append(place))
    assert refused == [10]
    assert sum(len(block.stamps) for block in blocks) == 19


def test_as_many_layouts_are_remembered_as_are_needed_and_no_more() -> None:
    topic, message = next(item for item in messages() if item[0] == "/wrench")
    decoder = Decoder()
    for length in range(300):
        other = replace(message, header=replace(message.header, frame_id="x" * length))
        assert_read(decoder.blocks([serialised(topic, other)], fail), [(topic, other)])
    assert 0 < sum(map(len, decoder._layouts.values())) <= 64


def test_messages_are_read_by_what_there_is_where_rosbags_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    monkeypatch.setattr(module, "_without_rosbags", [])
    own = object()
    with pytest.raises(ModuleNotFoundError):
        module.message_types.__wrapped__()
    module.read_without_rosbags(own)
    assert module.message_types.__wrapped__() is own
