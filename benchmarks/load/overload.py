"""More than the node can carry: it sheds, counts what it sheds, and is itself again soon after.

How late it is comes from the efforts that it predicts: when they arrive, less their stamp and the filter's fixed lag.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from sensor_msgs.msg import JointState

from benchmarks.load.publisher import Sent
from benchmarks.load.robots import Robot
from benchmarks.load.watched import Account, Watched, sent_by, watched

_NORMAL = 1000.0  # Hz
_STEP = 2.0**0.5  # from one rate that is tried to the next
_MOST = 32_000.0  # Hz
_TIMES = 4.0
_NORMAL_SECONDS = 10.0
_LATE = 0.1  # [s] whoever is less late keeps up
_USUAL = 0.95  # of the predictions
_STEADY = 1.0  # [s] without a late one


@dataclass(frozen=True)
class Overload:
    """The highest rate that was ``carried`` [Hz], the rate that was ``offered`` for some ``seconds`` and what the
    publisher made of it (``achieved``); messages ``sent`` in all and what became of them; the seconds until the node
    was itself again (``recovery``) when the load was; and the latest [s] that it was (``latest``)."""

    carried: float
    offered: float
    achieved: float
    seconds: float
    sent: int
    account: Account
    latest: float
    recovery: float

    @property
    def unaccounted(self) -> int:
        """Messages that are in no account."""
        return self.sent - self.account.received - self.account.lost


class _Lateness:
    """Of every prediction: when it came, and how late."""

    def __init__(self, node: Watched) -> None:
        self._node = node
        self.entries: list[tuple[float, float]] = []
        node.stage.observer.node.create_subscription(JointState, "geomid/predicted_joint_states", self._hear, 10_000)

    def _hear(self, message: JointState) -> None:
        stamp, now = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec, time.time()
        self.entries.append((now, now - stamp - float(self._node.values.get("lag", 0.0))))

    def between(self, begin: float, end: float) -> list[float]:
        """All of some time; infinite if nothing came."""
        return [late for when, late in self.entries if begin <= when <= end] or [float("inf")]

    def recovery(self, begin: float) -> float:
        """Seconds from ``begin`` until one comes in time, and for some time none late."""
        since = [(when, late > _LATE) for when, late in self.entries if when >= begin]
        late, end = [when for when, is_late in since if is_late], self.entries[-1][0] - _STEADY
        fine = (when for when, is_late in since if not is_late and when <= end)
        steady = (when for when in fine if not any(when <= other <= when + _STEADY for other in late))
        return next(steady, float("inf")) - begin


def overload(robot: Robot, seconds: float) -> Overload:
    """Find what a node can carry, and let it have four times as much for some time."""
    carried = _carried(robot, seconds)
    with watched(robot, {}) as node:
        lateness = _Lateness(node)
        offered = _TIMES * carried
        publisher = node.publish((_NORMAL_SECONDS, _NORMAL), (seconds, offered), (_NORMAL_SECONDS, _NORMAL))
        node.stage.spin_while(publisher)
        node.settle()
        phases = sent_by(publisher)
        much, normal = phases[1:]
        return Overload(
            carried,
            offered,
            much.ticks / (much.end - much.begin),
            seconds,
            sum(phase.ticks for phase in phases) * len(robot.kinds),
            node.account,
            max(lateness.between(much.begin, normal.end)),
            lateness.recovery(normal.begin),
        )


def _carried(robot: Robot, seconds: float) -> float:
    """The highest rate at which nothing is lost or dropped and everything keeps up."""
    with watched(robot, {}) as node:
        lateness = _Lateness(node)
        carried, rate = 0.0, _NORMAL
        while rate <= _MOST:
            phases, before = _tried(node, rate, seconds), node.account
            if not _kept_up(lateness, phases[-1], rate) or before.lost or before.refused:
                break
            carried, rate = rate, rate * _STEP
        return carried


def _tried(node: Watched, rate: float, seconds: float) -> list[Sent]:
    publisher = node.publish((2.0, _NORMAL), (seconds, rate))
    node.stage.spin_while(publisher)
    node.settle()
    return sent_by(publisher)


def _kept_up(lateness: _Lateness, phase: Sent, rate: float) -> bool:
    """Whether the publisher did, and in the second half of the time the node, but for moments."""
    achieved = phase.ticks / (phase.end - phase.begin)
    late = np.quantile(lateness.between(0.5 * (phase.begin + phase.end), phase.end), _USUAL)
    return achieved > 0.98 * rate and bool(late < _LATE)
