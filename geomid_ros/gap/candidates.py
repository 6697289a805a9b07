"""The library of effects: what may be named, and the columns that samples carry for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.model.effects import EFFECTS, Effect, JointMotion, SituationEffect
from geomid_ros.model.effects.backlash import CROSSINGS, Backlash
from geomid_ros.model.effects.coulomb_friction import CoulombFriction
from geomid_ros.model.effects.effort_delay import EffortDelay
from geomid_ros.model.effects.effort_gain import EffortGain
from geomid_ros.model.effects.effort_offset import EffortOffset
from geomid_ros.model.effects.gravity_tilt import GravityTilt
from geomid_ros.model.effects.joint_elasticity import JointElasticity
from geomid_ros.model.effects.load_friction import LoadFriction
from geomid_ros.model.effects.rotor_inertia import RotorInertia
from geomid_ros.model.effects.spring import Spring
from geomid_ros.model.effects.stribeck_friction import StribeckFriction
from geomid_ros.model.effects.viscous_friction import ViscousFriction
from geomid_ros.model.measurement import Coefficient, MeasurementModel
from geomid_ros.types import FloatArray

# [rad/s or m/s] What enters nonlinearly: over which speed dry friction changes its sign, and Stribeck's speed.
SMOOTHINGS = (0.003, 0.02, 0.08)
STRIBECK_SPEEDS = tuple(float(speed) for speed in np.geomspace(0.03, 0.6, 25).round(4))
RICHER = {"coulomb_friction": "stribeck_friction", "effort_offset": "spring"}
"""Names that contain another one as a special case: of the two, the simpler is right unless the richer is needed."""
_SCOUTS = 4  # one of so many scanned constants is tried before its name is chosen
STILL = 0.01  # [rad/s or m/s] below this friction is no function of speed

_OFFSET = EffortOffset()
_FIRST: tuple[Effect, ...] = (
    ViscousFriction(),
    RotorInertia(),
    _OFFSET,
    Spring(),
    *(CoulombFriction(smoothing) for smoothing in SMOOTHINGS),
    *(StribeckFriction(speed, SMOOTHINGS[0]) for speed in STRIBECK_SPEEDS),
)
_MORE = tuple(effect for effect in EFFECTS.values() if effect.name not in {first.name for first in _FIRST})
MOTION_EFFECTS = (*_FIRST, *_MORE)
"""All functions of one joint's motion, in the order of the samples' columns; what other files add comes last."""
SIGN = MOTION_EFFECTS.index(CoulombFriction(SMOOTHINGS[0]))  # the direction of motion
SMOOTH_SIGN = MOTION_EFFECTS.index(CoulombFriction(SMOOTHINGS[1]))  # the same, of friction that sets in slowly
DRY = [place for place, effect in enumerate(MOTION_EFFECTS) if isinstance(effect, CoulombFriction)]
REST = len(MOTION_EFFECTS)  # the last column: the share of the filter's window in which the joint stands still


def effect_columns(position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Columns ``(N, joints, library)`` for ``SignalPipeline(effect_columns=...)``; motions each ``(N, joints)``."""
    columns = np.empty((*position.shape, REST + 1))
    motion = JointMotion(position, velocity, acceleration)
    for index, effect in enumerate(MOTION_EFFECTS):
        columns[:, :, index] = effect.column(motion)
    columns[:, :, REST] = np.abs(velocity) < STILL
    return columns


@dataclass(frozen=True)
class Term:
    """One linear coefficient. Its column is that of ``motion`` at ``joint`` in the samples; or the one of ``index`` of
    a ``situation``; or a constant of one ``channel``; or the one of ``index`` of a free ``curve``."""

    joint: int
    motion: int = -1
    situation: SituationEffect | None = None
    index: int = 0
    channel: int = -1
    curve: str = ""


@dataclass(frozen=True)
class Candidate:
    """A name at a place, for some value of the constant that is ``scanned`` (0 for names without one).

    ``terms``: its coefficients, the first ``positives`` of which cannot be negative. ``payload``: the place of the
    link, among the identified ones, to which a body is fixed, -1 for other effects. ``penalty``: how many parameters it
    counts for. ``group``: candidates of one group are the same name with other constants; those that ``scout`` stand
    for the others until one is chosen.
    """

    effect: str
    joint: int
    terms: tuple[Term, ...]
    positives: int = 0
    payload: int = -1
    penalty: float = 1.0
    scanned: float = 0.0
    scout: bool = True

    def excludes(self, other: Candidate) -> bool:
        """Whether both at once make no sense: one name and place, one a special case of the other, two payloads."""
        if self.payload >= 0 and other.payload >= 0:
            return True
        names = {self.effect, other.effect}
        nested = any(names == {simple, rich} for simple, rich in RICHER.items())
        return self.group == other.group or (nested and self.joint == other.joint)

    @property
    def group(self) -> tuple[str, int, int]:
        """Name and place."""
        return self.effect, self.joint, self.payload

    def __hash__(self) -> int:
        return hash((self.group, self.terms))


_SITUATION: tuple[SituationEffect, ...] = (LoadFriction(), EffortGain(), JointElasticity())


def candidates(model: MeasurementModel) -> list[Candidate]:
    """All names for a robot with its sensors."""
    found: list[Candidate] = []
    joints = range(len(model.robot.joints)) if model.efforts_usable else range(0)
    for joint in joints:
        found += _joint_candidates(joint)
    if joints and not model.robot.floating_base:
        found.append(Candidate("effort_delay", -1, (Term(-1, situation=EffortDelay()),)))
    if not model.robot.floating_base:
        tilt = GravityTilt()
        found.append(
            Candidate("gravity_tilt", -1, (Term(-1, situation=tilt), Term(-1, situation=tilt, index=1)), penalty=2)
        )
    found += [
        Candidate("payload", _mover(model, place), (), payload=place, penalty=4)
        for place in range(len(model.identified))
    ]
    return found + _wrench_offsets(model)


def _joint_candidates(joint: int) -> list[Candidate]:
    found = [_motion_candidate(joint, effect) for effect in MOTION_EFFECTS]
    found += [
        Candidate(effect.name, joint, (Term(joint, situation=effect),), int(effect.positive)) for effect in _SITUATION
    ]
    found += [
        Candidate(
            "backlash",
            joint,
            (Term(joint, situation=Backlash(place)),),
            1,
            penalty=2,
            scanned=crossing,
            scout=place % _SCOUTS == 0,
        )
        for place, crossing in enumerate(CROSSINGS)
    ]
    return found


def _motion_candidate(joint: int, effect: Effect) -> Candidate:
    def term(of: Effect) -> Term:
        return Term(joint, motion=MOTION_EFFECTS.index(of))

    if isinstance(effect, Spring):
        return Candidate(effect.name, joint, (term(effect), term(_OFFSET)), 1, penalty=2)
    if isinstance(effect, StribeckFriction):
        terms = term(CoulombFriction(effect.smoothing)), term(effect)
        scout = effect.speed in STRIBECK_SPEEDS[::_SCOUTS]
        return Candidate(effect.name, joint, terms, 2, penalty=3, scanned=effect.speed, scout=scout)
    return Candidate(effect.name, joint, (term(effect),), int(effect.positive))


def _mover(model: MeasurementModel, place: int) -> int:
    """The joint that moves an identified body, -1 for none."""
    children = [joint.child for joint in model.robot.tree.joints if joint.name in model.robot.joint_names]
    name = model.body_names[place]
    owners = [j for j in model.robot.tree.joints if j.name in model.robot.joint_names]
    moved = {joint.child: joint.name for joint in owners}
    while name not in children:
        parent = next((joint.parent for joint in model.robot.tree.joints if joint.child == name), None)
        if parent is None:
            return -1
        name = parent
    return model.robot.joint_names.index(moved[name])


def _wrench_offsets(model: MeasurementModel) -> list[Candidate]:
    first = len(model.robot.joints) if model.efforts_usable else 0
    found = []
    for sensor in model.mounted:
        channels = range(first, first + len(sensor.axes))
        terms = tuple(Term(-1, channel=channel) for channel in channels)
        found.append(Candidate("wrench_offset", -1, terms, penalty=len(terms)))
        first = channels.stop
    return found


def base_term(coefficient: Coefficient) -> Term:
    """The term of an effect that the model already has."""
    names = [effect.name for effect in MOTION_EFFECTS]
    if coefficient.effect in MOTION_EFFECTS:
        return Term(coefficient.joint, motion=MOTION_EFFECTS.index(coefficient.effect))
    return Term(coefficient.joint, motion=names.index(coefficient.effect.name))
