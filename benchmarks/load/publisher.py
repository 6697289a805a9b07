"""Publishes a robot's messages at given rates, and says what it has achieved: ``ROBOT SECONDS:RATE ...``."""

from __future__ import annotations

import argparse
import json
import signal
import struct
import sys
import time
from dataclasses import asdict, dataclass, field

import rclpy
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from benchmarks.load.robots import STAMP, Robot, robots

_MATCHING = 1.0  # [s] a subscriber knows of a publisher a little later than the publisher of it
_PERIOD = 8.0  # [s] after which the motion is the same again
_LATEST = 0.05  # [s] whoever publishes later than that has given up to make up for it


@dataclass
class Sent:
    """What a phase was: ticks of so many messages ``sent`` per topic, from ``begin`` to ``end`` (time of day), and how
    ``late`` [s] the latest one was."""

    rate: float
    begin: float = field(default_factory=time.time)
    end: float = 0.0
    ticks: int = 0
    late: float = 0.0


class Stream:
    """The messages of a robot, one after the other."""

    def __init__(self, node: Node, robot: Robot, rate: float, period: float = _PERIOD) -> None:
        """``rate`` [Hz] and ``period`` [s] of the motion: its instants, and when it begins anew."""
        qos = QoSProfile(depth=1000, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)
        messages = robot.messages(rate, period)
        self._topics = [
            (node.create_publisher(kind, topic, qos), memoryview(messages[topic].tobytes()), messages[topic].shape[1])
            for topic, kind in robot.kinds.items()
        ]
        self._messages = len(messages["joint_states"])

    @property
    def heard(self) -> bool:
        """Whether somebody listens to all topics."""
        return all(publisher.get_subscription_count() for publisher, _, _ in self._topics)

    def publish(self, instant: int, stamp: int) -> None:
        """Publish the messages of an instant of the motion with this stamp [ns]."""
        index = instant % self._messages
        time_stamp = struct.pack("<iI", *divmod(stamp, 1_000_000_000))
        for publisher, messages, length in self._topics:
            data = bytearray(messages[index * length : (index + 1) * length])
            data[STAMP : STAMP + 8] = time_stamp
            publisher.publish(bytes(data))


def _phase(stream: Stream, seconds: float, rate: float, stride: int, first: int) -> Sent:
    """Publish ``rate`` ticks a second, every ``stride``-th instant of the motion."""
    sent = Sent(rate)
    begin, origin = time.perf_counter(), time.time_ns()
    skipped = 0.0
    while True:
        due = sent.ticks / rate + skipped
        ahead = due - (time.perf_counter() - begin)
        if due >= seconds:
            break
        if ahead > 0.0:
            time.sleep(ahead)
        elif -ahead > _LATEST:
            skipped -= ahead
        sent.late = max(sent.late, -ahead)
        stream.publish(first + sent.ticks * stride, origin + round(due * 1e9))
        sent.ticks += 1
    sent.end = time.time()
    return sent


def main() -> None:
    """Wait until somebody listens to all topics, then publish; a line of JSON for each phase."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robot", choices=robots())
    parser.add_argument("phases", nargs="+", type=lambda text: tuple(map(float, text.split(":"))))
    arguments = parser.parse_args()
    signal.signal(signal.SIGINT, lambda *_: sys.exit(0))  # whoever has enough need not wait for the last phase
    finest = max(rate for _, rate in arguments.phases)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("robot")
    stream = Stream(node, robots()[arguments.robot], finest)
    while not stream.heard:
        time.sleep(0.05)
    time.sleep(_MATCHING)
    instant = 0
    for seconds, rate in arguments.phases:
        stride = round(finest / rate)
        sent = _phase(stream, seconds, rate, stride, instant)
        instant += sent.ticks * stride
        print(json.dumps(asdict(sent)), flush=True)
    time.sleep(_MATCHING)  # what was published last must leave
    rclpy.shutdown()


if __name__ == "__main__":
    main()
