"""ROS messages are read by attribute: anything shaped like them will do."""

from __future__ import annotations

from array import array
from types import SimpleNamespace

import numpy as np
import pytest

from geomid_ros.model.sensors import WrenchSensor
from geomid_ros.signals import messages
from geomid_ros.signals.pipeline import SignalPipeline, SignalSettings


def header(seconds: int, nanoseconds: int, frame: str = "") -> SimpleNamespace:
    return SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds), frame_id=frame)


def quantity(**numbers: float) -> SimpleNamespace:
    return SimpleNamespace(**numbers)


class Recorder(SignalPipeline):
    """A pipeline that keeps what is pushed."""

    def __init__(self) -> None:
        sensors = [WrenchSensor("/ft", "tool", "mounted")]
        super().__init__(["a", "b"], floating_base=True, sensors=sensors, settings=SignalSettings(period=0.01))
        self.seen: list[tuple[str, int, list[float]]] = []

    def _take(self, grid: object, topic: str, stamp: int, values: np.ndarray) -> None:
        del grid
        self.seen.append((topic, stamp, values.tolist()))


def test_a_stamp_is_nanoseconds_since_the_epoch() -> None:
    assert messages.stamp_of(header(1_700_000_000, 123_456_789)) == 1_700_000_000_123_456_789
    assert messages.stamp_of(header(0, 0)) == 0
    assert messages.stamp_of(header(5, 999_999_999)) == 5_999_999_999


@pytest.mark.parametrize(("seconds", "nanoseconds"), [(1, 1_000_000_000), (1, 4_294_967_295), (-1, 5), (1, -1)])
def test_a_stamp_out_of_range_is_rejected(seconds: int, nanoseconds: int) -> None:
    pipeline = Recorder()
    message = SimpleNamespace(
        header=header(seconds, nanoseconds), name=["a", "b"], position=[1.0, 2.0], velocity=[], effort=[]
    )
    messages.feed_joint_state(pipeline, message)
    assert pipeline.ledger.topics["joint_states"].rejected == {"stamp is not valid": 1}


ARRAYS = {"list": list, "tuple": tuple, "numpy": np.array, "array": lambda numbers: array("d", numbers)}


@pytest.mark.parametrize("kind", ARRAYS)
def test_a_joint_state_is_read_whatever_its_arrays_are(kind: str) -> None:
    """rosbags gives numpy arrays, rclpy arrays of its own kind."""
    pipeline = Recorder()
    arrays = {"position": [1.0, 2.0], "velocity": [3.0, 4.0], "effort": [5.0, 6.0]}
    made = {key: ARRAYS[kind](numbers) for key, numbers in arrays.items()}
    message = SimpleNamespace(header=header(7, 1), name=["b", "a"], **made)
    messages.feed_joint_state(pipeline, message)
    assert pipeline.seen == [("joint_states", 7_000_000_001, [2.0, 1.0, 4.0, 3.0, 6.0, 5.0])]


def test_an_odometry_is_position_then_quaternion() -> None:
    pipeline = Recorder()
    orientation = quantity(x=0.5, y=-0.5, z=0.5, w=-0.5)
    pose = SimpleNamespace(position=quantity(x=1.0, y=2.0, z=3.0), orientation=orientation)
    messages.feed_odometry(pipeline, SimpleNamespace(header=header(7, 1), pose=SimpleNamespace(pose=pose)))
    assert pipeline.seen == [("odom", 7_000_000_001, [1.0, 2.0, 3.0, 0.5, -0.5, 0.5, -0.5])]


def test_a_wrench_is_force_then_torque() -> None:
    pipeline = Recorder()
    wrench = SimpleNamespace(force=quantity(x=1.0, y=2.0, z=3.0), torque=quantity(x=4.0, y=5.0, z=6.0))
    for frame in ("tool", "elsewhere"):
        message = SimpleNamespace(header=header(7, 1 if frame == "tool" else 2, frame), wrench=wrench)
        messages.feed_wrench(pipeline, "/ft", message)
    assert pipeline.seen == [("/ft", 7_000_000_001, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])]
    assert pipeline.ledger.topics["/ft"].rejected == {"frame 'elsewhere' is not the declared 'tool'": 1}
