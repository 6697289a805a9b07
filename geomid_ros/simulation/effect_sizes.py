"""Effects of a robot with their places and sizes: as requested, or drawn from the seed within the range of real joints.

``E`` is the joint's effort limit, ``V`` its velocity limit. A bare number in a request sets the first parameter of an
effect. Units are those of a revolute joint; every effort is the one that the motor has to supply, with its sign.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from inspect import isfunction

import numpy as np

from geomid_ros.errors import InputError, check_name, unknown_name
from geomid_ros.simulation.description import Description, UrdfLimits
from geomid_ros.simulation.effects import TrueEffect
from geomid_ros.simulation.options import GEARS, Hidden, RandomStream, SimulationOptions, generator

_ROTOR_TIME = 1e-4  # [s] to V at E: a rotor as light as the integration allows, hardly visible in the noise


@dataclass(frozen=True)
class Site:
    """Place of an effect: a ``joint``, and the ``other`` one if it depends on two. ``strongest`` is the largest effort
    limit of the robot's joints. ``given`` are the parameters that the user chose."""

    joint: UrdfLimits
    other: UrdfLimits
    strongest: float
    given: Mapping[str, float]


Size = Callable[[Site, np.random.Generator], dict[str, float]]


def _between(low: float, high: float, rng: np.random.Generator) -> float:
    """Draw a number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _sign(rng: np.random.Generator) -> float:
    return -1.0 if rng.uniform() < 0.5 else 1.0


def viscous_friction(site: Site, rng: np.random.Generator) -> dict[str, float]:
    """Effort c v: ``coefficient`` [N m s/rad], 1 to 10 % of E at V."""
    return {"coefficient": _between(0.01, 0.1, rng) * site.joint.effort / site.joint.velocity}


def coulomb_friction(site: Site, rng: np.random.Generator) -> dict[str, float]:
    """Dry friction of ``level`` [N m], 1 to 8 % of E."""
    return {"level": _between(0.01, 0.08, rng) * site.joint.effort}


def stribeck_friction(site: Site, rng: np.random.Generator) -> dict[str, float]:
    """Dry friction of ``level + excess exp(-(v/speed)^2)`` [N m, rad/s]."""
    level = _between(0.01, 0.06, rng) * site.joint.effort
    speed = _between(0.03, 0.12, rng) * site.joint.velocity
    return {"level": level, "excess": rng.uniform(0.4, 1.2) * level, "speed": speed}


def load_friction(_: Site, rng: np.random.Generator) -> dict[str, float]:
    """Dry friction of ``coefficient`` [-] times the magnitude of the effort that the gear transmits."""
    return {"coefficient": _between(0.03, 0.15, rng)}


def rotor_inertia(site: Site, rng: np.random.Generator) -> dict[str, float]:
    """Reflected ``inertia`` [kg m^2] at the joint; the bare rotor reaches V at E in 1 to 6 ms."""
    return {"inertia": _between(1e-3, 6e-3, rng) * site.joint.effort / site.joint.velocity}


def spring(site: Site, rng: np.random.Generator) -> dict[str, float]:
    """Effort k (q - q0): ``stiffness`` [N m/rad], 4 to 30 % of E at the end of the range; ``equilibrium`` [rad]."""
    stiffness = _between(0.04, 0.3, rng) * site.joint.effort / site.joint.half_range
    return {"stiffness": stiffness, "equilibrium": site.joint.centre + rng.uniform(-0.5, 0.5) * site.joint.half_range}


def effort_offset(site: Site, rng: np.random.Generator) -> dict[str, float]:
    """Measured minus true effort: ``offset`` [N m], 1 to 5 % of E."""
    return {"offset": _sign(rng) * _between(0.01, 0.05, rng) * site.joint.effort}


def effort_gain(_: Site, rng: np.random.Generator) -> dict[str, float]:
    """Measured over true effort: ``gain`` [-], 4 to 20 % from 1."""
    return {"gain": 1.0 + _sign(rng) * _between(0.04, 0.2, rng)}


def gravity_tilt(_: Site, rng: np.random.Generator) -> dict[str, float]:
    """Rotation vector of the base, ``tilt_x``, ``tilt_y`` [rad], of 0.5 to 5 degrees."""
    angle, direction = math.radians(_between(0.5, 5.0, rng)), rng.uniform(0.0, 2.0 * math.pi)
    return {"tilt_x": angle * math.cos(direction), "tilt_y": angle * math.sin(direction)}


def effort_delay(_: Site, rng: np.random.Generator) -> dict[str, float]:
    """``delay`` of the measured efforts [s], 2 to 12 ms of either sign."""
    return {"delay": _sign(rng) * _between(0.002, 0.012, rng)}


def payload(site: Site, rng: np.random.Generator) -> dict[str, float]:
    """Box of ``mass`` [kg], ``com_*`` [m] in the link frame, ``i**`` [kg m^2] about its centre in the link's axes."""
    mass = site.given.get("mass", _between(0.02, 0.08, rng) * site.strongest / 9.81 / 0.5)
    x, y, z = rng.uniform(-0.1, 0.1, 3).tolist()
    a, b, c = (np.cbrt(mass / 2000.0) * rng.uniform(0.5, 2.0, 3)).tolist()
    box = {"ixx": b * b + c * c, "iyy": a * a + c * c, "izz": a * a + b * b}
    moments = {name: mass / 12.0 * value for name, value in box.items()}
    return {"mass": mass, "com_x": x, "com_y": y, "com_z": z, **moments, "ixy": 0.0, "ixz": 0.0, "iyz": 0.0}


def joint_elasticity(site: Site, rng: np.random.Generator) -> dict[str, float]:
    """Elastic gear of ``stiffness`` [N m/rad], twisted by 0.01 to 0.05 rad at E, with ``damping`` and a light rotor."""
    stiffness = site.given.get("stiffness", site.joint.effort / _between(0.01, 0.05, rng))
    return {"stiffness": stiffness, **_light_rotor(site, stiffness)}


def backlash(site: Site, rng: np.random.Generator) -> dict[str, float]:
    """Play of ``gap`` [rad], 3 to 20 mrad, between flanks of some ``stiffness`` and ``damping``, with a light rotor."""
    gap = site.given.get("gap", _between(0.003, 0.02, rng))
    stiffness = site.given.get("stiffness", site.joint.effort / (0.2 * gap))
    return {"gap": gap, "stiffness": stiffness, **_light_rotor(site, stiffness)}


def _light_rotor(site: Site, stiffness: float) -> dict[str, float]:
    rotor = site.given.get("rotor_inertia", _ROTOR_TIME * site.joint.effort / site.joint.velocity)
    return {"damping": math.sqrt(stiffness * rotor), "rotor_inertia": rotor}


def wrench_offset(_: Site, rng: np.random.Generator) -> dict[str, float]:
    """Measured minus true wrench in the sensor's axes, ``fx`` to ``fz`` [N], ``tx`` to ``tz`` [N m]."""
    force = [_sign(rng) * _between(0.5, 5.0, rng) for _ in range(3)]
    torque = [_sign(rng) * _between(0.02, 0.3, rng) for _ in range(3)]
    return dict(zip(("fx", "fy", "fz", "tx", "ty", "tz"), force + torque, strict=True))


def cogging(site: Site, rng: np.random.Generator) -> dict[str, float]:
    """Effort A sin(cycles q + phase): ``amplitude`` [N m], 1 to 6 % of E, some ``cycles`` per turn."""
    amplitude = _between(0.01, 0.06, rng) * site.joint.effort
    return {"amplitude": amplitude, "cycles": float(rng.integers(5, 21)), "phase": rng.uniform(0.0, 2.0 * math.pi)}


def cable_force(site: Site, rng: np.random.Generator) -> dict[str, float]:
    """Cable over pulleys on two joints, stretched by w = q + ratio q_other - start where that is above 0: efforts
    k w and ratio k w; ``stiffness`` k [N m/rad], 8 to 40 % of E of the weaker joint over half the range, ``ratio`` [-],
    ``start`` [rad]."""
    weaker = min(site.joint.effort, site.other.effort)
    stiffness, ratio = _between(0.08, 0.4, rng) * weaker / site.joint.half_range, rng.uniform(0.4, 0.9)
    slack = rng.uniform(-0.2, 0.2) * site.joint.half_range
    return {"stiffness": stiffness, "ratio": ratio, "start": site.joint.centre + ratio * site.other.centre + slack}


def drift(site: Site, rng: np.random.Generator) -> dict[str, float]:
    """Measured minus true effort grows from 0 at ``rate`` [N m/s], 1 to 6 % of E in 30 s."""
    return {"rate": _sign(rng) * _between(0.01, 0.06, rng) * site.joint.effort / 30.0}


def position_friction(site: Site, rng: np.random.Generator) -> dict[str, float]:
    """Dry friction of ``level (1 + modulation sin(cycles q + phase))`` [N m]: a bent shaft, an uneven seal."""
    level, modulation = _between(0.02, 0.08, rng) * site.joint.effort, rng.uniform(0.6, 1.0)
    cycles, phase = float(rng.integers(1, 4)), rng.uniform(0.0, 2.0 * math.pi)
    return {"level": level, "modulation": modulation, "cycles": cycles, "phase": phase}


def joint_coupling(site: Site, rng: np.random.Generator) -> dict[str, float]:
    """Effort c v_other, as in a differential wrist: ``coefficient`` [N m s/rad], 2 to 10 % of E at V."""
    return {"coefficient": _sign(rng) * _between(0.02, 0.1, rng) * site.joint.effort / site.joint.velocity}


SIZES: dict[str, Size] = {
    name: size
    for name, size in globals().items()
    if isfunction(size) and size.__module__ == __name__ and not name.startswith("_")
}
"""Functions that draw the parameters of each effect, by name: the public functions of this file."""


WRENCH_TOPIC = "/wrench"
"""Topic of the wrench in a recording."""

_FIXED_PLACES = {"gravity_tilt": "", "effort_delay": "", "wrench_offset": WRENCH_TOPIC}
_TWO_JOINTS = {"cable_force", "joint_coupling"}
_ABOVE_ZERO = {"speed", "gain", "gap", "mass", "stiffness", "damping", "rotor_inertia"}


def chosen_effects(options: SimulationOptions, robot: Description) -> tuple[TrueEffect, ...]:
    """Effects of a robot: those in ``options.hide``, or else friction, rotor inertia and offset at every joint."""
    if options.hide is None:
        numbers = generator(options.seed, RandomStream.EFFECTS)
        return tuple(effect for joint in robot.joints for effect in _default_effects(options, joint, numbers))
    effects: list[TrueEffect] = []
    for index, request in enumerate(options.hide):
        numbers = generator(options.seed, RandomStream.HIDDEN, index)
        effects.append(_requested(request, robot, options, effects, numbers))
    return tuple(effects)


def _default_effects(options: SimulationOptions, joint: UrdfLimits, rng: np.random.Generator) -> Iterable[TrueEffect]:
    viscous, dry, rotor, offset = rng.uniform(0.5, 1.5, 4).tolist()
    sign = _sign(rng)
    slowness = joint.effort / joint.velocity
    for name, parameter, value in (
        ("viscous_friction", "coefficient", viscous * options.viscous_friction * slowness),
        ("coulomb_friction", "level", dry * options.coulomb_friction * joint.effort),
        ("rotor_inertia", "inertia", rotor * options.rotor_inertia * slowness),
        ("effort_offset", "offset", sign * offset * options.effort_offset * joint.effort),
    ):
        yield TrueEffect(name, joint.name, {parameter: value})


def _requested(
    request: Hidden, robot: Description, options: SimulationOptions, others: list[TrueEffect], rng: np.random.Generator
) -> TrueEffect:
    check_name("effect", request.effect, SIZES)
    joint, link = _place(request, robot, options, others, rng)
    limits = {limits.name: limits for limits in robot.joints}
    other = _neighbour(joint, list(limits)) if request.effect in _TWO_JOINTS else ""
    strongest = max(robot.joints, key=lambda limits: limits.effort)
    site = Site(limits.get(joint, strongest), limits.get(other, strongest), strongest.effort, {})
    effect = TrueEffect(request.effect, joint, _parameters(request, site, rng), link, other)
    _check_conflicts(effect, others)
    return effect


def _neighbour(joint: str, joints: list[str]) -> str:
    """Next joint of the URDF; for the last one, the previous joint."""
    if len(joints) < 2:
        raise InputError(f"joint '{joint}' is the only one; this effect depends on two.")
    index = joints.index(joint)
    return joints[index + 1] if index + 1 < len(joints) else joints[index - 1]


def _place(
    request: Hidden, robot: Description, options: SimulationOptions, others: list[TrueEffect], rng: np.random.Generator
) -> tuple[str, str]:
    """Joint (or topic, or nothing) and, for a payload, its link."""
    if request.effect in _FIXED_PLACES:
        place = _FIXED_PLACES[request.effect]
        if place and options.wrench_frame is None:
            raise InputError(f"{request.effect} needs a wrench sensor; add --wrench.")
        if request.place not in ("", place):
            where = f"at the topic {place}" if place else "in the whole robot"
            raise InputError(f"{request.effect} is {where}; it cannot be at '{request.place}'.")
        return place, ""
    if request.effect == "payload":
        return _carrier(request.place or _drawn_link(robot, rng), robot)
    return _joint(request, robot, others, rng), ""


def _joint(request: Hidden, robot: Description, others: list[TrueEffect], rng: np.random.Generator) -> str:
    names = [joint.name for joint in robot.joints]
    taken = {effect.joint for effect in others if effect.name == request.effect}
    drawn = str(rng.choice([name for name in names if name not in taken] or names))
    if request.place and request.place not in names:
        raise unknown_name("joint", request.place, names)
    return request.place or drawn


def _drawn_link(robot: Description, rng: np.random.Generator) -> str:
    """Draw the last moving link with a mass in most cases, else one of the last two thirds."""
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
        check_name(f"parameter of {request.effect}", name, names)
        _check_value(request.effect, name, value)
    drawn = SIZES[request.effect](replace(site, given=given), rng)
    return {**drawn, **given}


def _check_value(effect: str, name: str, value: float) -> None:
    friction = effect.endswith("friction") and name in ("coefficient", "level", "excess") and value < 0.0
    if friction or (name in _ABOVE_ZERO and value <= 0.0):
        raise InputError(f"{effect}: {name} is {value:g}; it must be above 0.")
    if effect == "load_friction" and value >= 1.0:
        raise InputError(f"load_friction: {name} is {value:g}; from 1 on the joint cannot be back-driven.")


def _check_conflicts(effect: TrueEffect, others: list[TrueEffect]) -> None:
    for other in others:
        duplicate = (other.name, other.joint, other.link) == (effect.name, effect.joint, effect.link)
        if duplicate or (other.joint == effect.joint and {effect.name, other.name} <= {*GEARS}):
            raise InputError(f"{other.name} and {effect.name} are both requested at '{effect.joint}'; choose one.")
