"""The effects of a robot, with their places and sizes: as requested, or drawn from the seed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.simulation.description import Description, UrdfLimits
from geomid_ros.simulation.effects.physics import GEARS, TrueEffect
from geomid_ros.simulation.effects.sizes import SIZES, Site
from geomid_ros.simulation.options import Hidden, RandomStream, SimulationOptions, generator

WRENCH_TOPIC = "/wrench"
"""Where a recording has its wrench."""

_WHOLE_ROBOT = {"gravity_tilt", "effort_delay"}
_TWO_JOINTS = {"cable_force", "joint_coupling"}
_ABOVE_ZERO = {"speed", "gain", "gap", "mass", "stiffness", "damping", "rotor_inertia"}


def chosen_effects(options: SimulationOptions, robot: Description) -> tuple[TrueEffect, ...]:
    """The effects of a robot: those that ``options.hide`` names, or else some friction and the like at every joint."""
    if options.hide is None:
        numbers = generator(options.seed, RandomStream.EFFECTS)
        return tuple(effect for joint in robot.joints for effect in _everyday(options, joint, numbers))
    effects: list[TrueEffect] = []
    for index, request in enumerate(options.hide):
        numbers = generator(options.seed, RandomStream.HIDDEN, index)
        effects.append(_asked_for(request, robot, options, effects, numbers))
    return tuple(effects)


def _everyday(options: SimulationOptions, joint: UrdfLimits, rng: np.random.Generator) -> Iterable[TrueEffect]:
    viscous, dry, rotor, offset = rng.uniform(0.5, 1.5, 4).tolist()
    sign = -1.0 if rng.uniform() < 0.5 else 1.0
    slowness = joint.effort / joint.velocity
    for name, parameter, value in (
        ("viscous_friction", "coefficient", viscous * options.viscous_friction * slowness),
        ("coulomb_friction", "level", dry * options.coulomb_friction * joint.effort),
        ("rotor_inertia", "inertia", rotor * options.rotor_inertia * slowness),
        ("effort_offset", "offset", sign * offset * options.effort_offset * joint.effort),
    ):
        yield TrueEffect(name, joint.name, {parameter: value})


def _asked_for(
    request: Hidden, robot: Description, options: SimulationOptions, others: list[TrueEffect], rng: np.random.Generator
) -> TrueEffect:
    if request.effect not in SIZES:
        raise unknown_name("effect", request.effect, SIZES)
    joint, link = _place(request, robot, options, others, rng)
    limits = {limits.name: limits for limits in robot.joints}
    other = _neighbour(joint, list(limits)) if request.effect in _TWO_JOINTS else ""
    strongest = max(robot.joints, key=lambda limits: limits.effort)
    site = Site(limits.get(joint, strongest), limits.get(other, strongest), strongest.effort, {})
    effect = TrueEffect(request.effect, joint, _parameters(request, site, rng), link, other)
    _check_beside(effect, others)
    return effect


def _neighbour(joint: str, joints: list[str]) -> str:
    """The next joint of the URDF; the last one's is the one before."""
    if len(joints) < 2:
        raise InputError(f"joint '{joint}' is the only one; this effect depends on two.")
    at = joints.index(joint)
    return joints[at + 1] if at + 1 < len(joints) else joints[at - 1]


def _place(
    request: Hidden, robot: Description, options: SimulationOptions, others: list[TrueEffect], rng: np.random.Generator
) -> tuple[str, str]:
    """Joint (or topic, or nothing) and, for a payload, link."""
    if request.effect in _WHOLE_ROBOT:
        return _fixed_place(request, ""), ""
    if request.effect == "wrench_offset":
        if options.wrench_frame is None:
            raise InputError("wrench_offset needs a wrench sensor; add --wrench.")
        return _fixed_place(request, WRENCH_TOPIC), ""
    if request.effect == "payload":
        return _carrier(request.place or _drawn_link(robot, rng), robot)
    return _joint(request, robot, others, rng), ""


def _fixed_place(request: Hidden, place: str) -> str:
    if request.place not in ("", place):
        where = f"at the topic {place}" if place else "in the whole robot"
        raise InputError(f"{request.effect} is {where}; it cannot be at '{request.place}'.")
    return place


def _joint(request: Hidden, robot: Description, others: list[TrueEffect], rng: np.random.Generator) -> str:
    names = [joint.name for joint in robot.joints]
    taken = {effect.joint for effect in others if effect.name == request.effect}
    drawn = str(rng.choice([name for name in names if name not in taken] or names))
    if request.place and request.place not in names:
        raise unknown_name("joint", request.place, names)
    return request.place or drawn


def _drawn_link(robot: Description, rng: np.random.Generator) -> str:
    """Mostly the last link with a mass, sometimes one in the middle."""
    moving = [body.name for body in robot.inertias if robot.moved_by(body.name)]
    return moving[-1] if rng.uniform() < 0.6 else str(rng.choice(moving[len(moving) // 3 :]))


def _carrier(place: str, robot: Description) -> tuple[str, str]:
    joints = [joint.name for joint in robot.joints]
    link = robot.child(place) if place in joints else place
    moved_by = robot.moved_by(link)
    if moved_by is None:
        raise unknown_name("joint or moving link", place, [*joints, *filter(robot.moved_by, robot.links)])
    return moved_by, link


def _parameters(request: Hidden, site: Site, rng: np.random.Generator) -> dict[str, float]:
    names = list(SIZES[request.effect](site, np.random.default_rng()))
    given = dict(request.parameters) if request.value is None else {names[0]: request.value}
    for name, value in given.items():
        if name not in names:
            raise unknown_name(f"parameter of {request.effect}", name, names)
        _check_value(request.effect, name, value)
    drawn = SIZES[request.effect](replace(site, given=given), rng)
    return {**drawn, **given}


def _check_value(effect: str, name: str, value: float) -> None:
    friction = effect.endswith("friction") and name in ("coefficient", "level", "excess") and value < 0.0
    if friction or (name in _ABOVE_ZERO and value <= 0.0):
        raise InputError(f"{effect}: {name} is {value:g}; it has to be above 0.")
    if effect == "load_friction" and value >= 1.0:
        raise InputError(f"load_friction: {name} is {value:g}; from 1 on nothing moves the joint from behind it.")


def _check_beside(effect: TrueEffect, others: list[TrueEffect]) -> None:
    for other in others:
        twice = (other.name, other.joint, other.link) == (effect.name, effect.joint, effect.link)
        if twice or (other.joint == effect.joint and {effect.name, other.name} <= {*GEARS}):
            raise InputError(f"{other.name} and {effect.name} are both asked for at '{effect.joint}'; only one fits.")
