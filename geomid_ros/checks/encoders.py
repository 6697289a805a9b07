"""What a joint's encoder may count: from another zero, the other way round, or the angle of another joint, too.

A wrong zero is an unknown among others, ``tau(q + c) = tau(q) + dtau/dq c``: its evidence is found by the linearisation
at the links that fit, and this is repeated from where it leads. Zeros that are off by right angles, and axes that are
turned round, are tried from there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.checks import words
from geomid_ros.checks.evidence import Evidence
from geomid_ros.checks.hypotheses import Cause, Hypothesis
from geomid_ros.checks.readings import World, as_it_is
from geomid_ros.checks.subject import Subject
from geomid_ros.model.moving import SIGN
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

_RIGHT = 0.5 * np.pi
_SPREAD = 0.5  # [rad] of a zero that is off
_STEP = 1e-4  # [rad] of the derivative
_ROUNDS = 3
_FEW = 64  # instants that tell which encoders are worth a closer look
_BEST = 3


@dataclass(frozen=True)
class Encoder:
    """What a joint's position is: ``sign * counted + zero - share * counted of another``.

    Attributes:
        joint: its place among the robot's.
        sign: of position, speed and effort.
        zero: [rad] what has to be added.
        other: the place of a joint whose position is counted, too, or none.
        share: 1 or -1.
    """

    joint: int
    sign: float = 1.0
    zero: float = 0.0
    other: int | None = None
    share: float = 1.0

    def read(self, samples: Samples) -> Samples:
        """The samples as they are with this encoder."""
        moved = {name: getattr(samples, name).copy() for name in ("position", "velocity", "acceleration", "effort")}
        for values in moved.values():
            values[:, self.joint] *= self.sign
        moved["position"][:, self.joint] += self.zero
        effects = samples.effects.copy()
        if self.other is not None:
            for name in ("position", "velocity", "acceleration"):
                moved[name][:, self.joint] -= self.share * getattr(samples, name)[:, self.other]
        if SIGN in samples.entries.columns.place:
            sign = samples.entries.at(SIGN, self.joint)
            effects[:, sign] *= self.sign
            if self.other is not None:
                effects[:, sign] = np.sign(moved["velocity"][:, self.joint])
        return replace(samples, **moved, effects=effects)

    def shifted(self, zero: float) -> Encoder:
        """The same with another zero."""
        return replace(self, zero=zero)


def encoder_hypotheses(subject: Subject, world: World, nominal: Evidence) -> Iterator[Hypothesis]:
    """The encoders that explain a recording best.

    Args:
        subject: what was recorded.
        world: the robot as it is.
        nominal: its evidence.
    """
    turning = [place for place, joint in enumerate(subject.robot.joints) if joint.unit != "N"]
    links = subject.prior + subject.factor @ world.links(nominal.links)
    near, far = [], list(_far(subject.robot, turning))
    for joint in turning:
        encoder = Encoder(joint)
        found = world.with_unknown(_rate(subject, encoder, links), 0.0).judge(as_it_is(len(subject.joints)))
        near.append((found.log - nominal.log, encoder))
    choices = len(near) + len(far)
    for judged in (near, _screened(subject, far)):
        best = sorted(judged, key=lambda pair: -pair[0])[:_BEST]
        yield from (_hypothesis(subject, encoder, choices) for gain, encoder in best if gain > 0.0)


def _screened(subject: Subject, encoders: list[Encoder]) -> list[tuple[float, Encoder]]:
    """Encoders that are no linearisation away, with their gain of log evidence at a few instants."""
    samples, reading = subject.samples, as_it_is(len(subject.joints))
    few = samples.select(slice(None, None, -(-len(samples) // _FEW)))
    nominal = subject.world(few).judge(reading).log
    return [(subject.world(encoder.read(few)).judge(reading).log - nominal, encoder) for encoder in encoders]


def _far(robot: Robot, turning: list[int]) -> Iterator[Encoder]:
    for joint in turning:
        for sign in (1.0, -1.0):
            for quarters in (0, 1, 2, -1) if sign < 0.0 else (1, 2, -1):
                yield Encoder(joint, sign, quarters * _RIGHT)
        for other in robot.parallel_joints(joint):
            for share in (1.0, -1.0) if other in turning else ():
                yield Encoder(joint, other=other, share=share)


def _rate(subject: Subject, encoder: Encoder, links: FloatArray) -> FloatArray:
    """What a likely error of a joint's zero does to efforts of links with parameters ``links``, ``(N, C)``."""
    ahead, behind = (
        subject.regressor(encoder.shifted(encoder.zero + step).read(subject.samples)) for step in (_STEP, -_STEP)
    )
    return np.asarray((ahead - behind) @ links * (0.5 * _SPREAD / _STEP))


def _hypothesis(subject: Subject, start: Encoder, choices: int) -> Hypothesis:
    """An encoder with the zero that fits best near where it starts."""
    encoder, reading = start, as_it_is(len(subject.joints))
    world = subject.world(encoder.read(subject.samples))
    found = world.judge(reading)
    for _ in range(_ROUNDS):
        links = subject.prior + subject.factor @ world.links(found.links)
        centre = (start.zero - encoder.zero) / _SPREAD
        world = subject.world(encoder.read(subject.samples)).with_unknown(_rate(subject, encoder, links), centre)
        found = world.judge(reading)
        encoder = encoder.shifted(start.zero + _SPREAD * float(found.links[-1]))
    deviation = _SPREAD * float(world.deviations_of_links(reading)[-1])
    cause = _cause(subject.robot.joint_names, encoder, deviation)
    return subject.hypothesis(cause, found, choices)


def _cause(names: Sequence[str], encoder: Encoder, deviation: float) -> Cause:
    if encoder.other is not None:
        return words.absolute(names[encoder.joint], names[encoder.other], encoder.share)
    described = words.turned_axis if encoder.sign < 0.0 else words.other_zero
    return described(names[encoder.joint], encoder.zero, deviation)
