"""The realistic robot of a seed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.simulation.description import Description, LinkInertia, UrdfLimits, read_description
from geomid_ros.simulation.effects.choice import chosen_effects
from geomid_ros.simulation.effects.physics import FRICTION, GEARS, TrueEffect
from geomid_ros.simulation.inertias import perturbed
from geomid_ros.simulation.options import Hidden, SimulationOptions
from geomid_ros.simulation.plant import Plant
from geomid_ros.simulation.realistic.joint import LuGre, Motors, WarmUp
from geomid_ros.simulation.realistic.sensors import Sensors
from geomid_ros.simulation.robot import TrueRobot
from geomid_ros.simulation.robots import robot_description
from geomid_ros.simulation.seeds import RandomStream, generator
from geomid_ros.types import FloatArray

LINK_MASS = "link_mass"
"""The hidden change that only realistic robots know: ``factor`` times the mass and inertia of the ``link``."""

_CAD_ERROR = (0.1, 0.3)
_WAVES = ((8, 40), (60, 200))  # per turn: of the magnets, of the gear


@dataclass(frozen=True, eq=False)
class RealisticRobot(TrueRobot):
    """A robot whose ``plant`` has no dry or viscous friction of its own.

    Attributes:
        standing, hidden: The effects that the robot has anyhow, and those on top; ``effects`` are all of them, with the
            delays added up.
        friction, motors, warm_up, sensors: What makes it realistic.
    """

    plant: Plant
    standing: tuple[TrueEffect, ...]
    hidden: tuple[TrueEffect, ...]
    friction: LuGre
    motors: Motors
    warm_up: WarmUp
    sensors: Sensors

    def dry(self, velocity: FloatArray, position: FloatArray, effort: FloatArray) -> FloatArray:
        """Dry friction ``(n,)`` of steady sliding, what is hidden included [N m]."""
        level = self.friction.sliding(velocity)
        for effect in self.effects:
            if effect.name in FRICTION:
                at = self.plant.joints.index(effect.joint)
                state = float(position[at]), float(velocity[at]), float(effort[at])
                level[at] += FRICTION[effect.name](effect.parameters, *state)
        return level


def build_realistic(options: SimulationOptions) -> RealisticRobot:
    """The robot of ``options.seed`` with what ``options.hide`` asks for on top."""
    nominal = read_description(robot_description(options.robot))
    numbers = generator(options.seed, RandomStream.REALISTIC, 0)
    bodies = [perturbed(body, numbers.uniform(*_CAD_ERROR), numbers) for body in nominal.inertias]
    requests = options.hide or ()
    masses = tuple(_changed_mass(request, nominal) for request in requests if request.effect == LINK_MASS)
    others = tuple(request for request in requests if request.effect != LINK_MASS)
    hidden = chosen_effects(replace(options, hide=others), nominal)
    for effect in hidden:
        if effect.name in GEARS:
            raise InputError(f"{effect.name} cannot be hidden in a realistic robot; leave out --realistic.")
    standing = tuple(_standing(nominal.joints, generator(options.seed, RandomStream.REALISTIC, 1)))
    in_plant = [effect for effect in (*standing, *hidden) if effect.name not in FRICTION]
    loaded = tuple(_scaled(body, masses) for body in bodies)
    plant = Plant(nominal, loaded, in_plant, options.wrench_frame)
    limits = {joint.name: joint for joint in nominal.joints}
    joints = tuple(limits[name] for name in plant.joints)
    rotors = {effect.joint: effect.parameters["inertia"] for effect in standing if effect.name == "rotor_inertia"}
    return RealisticRobot(
        nominal=nominal,
        bodies=loaded,
        effects=_all(standing, hidden),
        plant=plant,
        joints=joints,
        standing=standing,
        hidden=(*masses, *hidden),
        friction=_friction(joints, rotors, generator(options.seed, RandomStream.REALISTIC, 2)),
        motors=_motors(joints, generator(options.seed, RandomStream.REALISTIC, 3)),
        warm_up=_warm_up(len(joints), options),
        sensors=_sensors(joints, options, generator(options.seed, RandomStream.REALISTIC, 5)),
    )


def _all(*effects: Iterable[TrueEffect]) -> tuple[TrueEffect, ...]:
    """With one delay, the sum of all."""
    every = list(chain(*effects))
    delay = sum(effect.parameters.get("delay", 0.0) for effect in every)
    return (*(e for e in every if e.name != "effort_delay"), TrueEffect("effort_delay", "", {"delay": delay}))


def _changed_mass(request: Hidden, robot: Description) -> TrueEffect:
    names = [body.name for body in robot.inertias if robot.moved_by(body.name)]
    if request.place not in names:
        raise unknown_name("moving link with a mass", request.place, names)
    factor = dict(request.parameters).get("factor", request.value)
    if factor is None or factor <= 0.0:
        raise InputError(f"{LINK_MASS} needs a factor above 0, as in {LINK_MASS}:{request.place}=1.3.")
    return TrueEffect(LINK_MASS, robot.moved_by(request.place) or "", {"factor": factor}, request.place)


def _scaled(body: LinkInertia, masses: Iterable[TrueEffect]) -> LinkInertia:
    for change in masses:
        if change.link == body.name:
            factor = change.parameters["factor"]
            body = replace(body, mass=factor * body.mass, inertia=factor * body.inertia)
    return body


def _standing(joints: Sequence[UrdfLimits], rng: np.random.Generator) -> Iterable[TrueEffect]:
    for joint in joints:
        size = joint.effort / joint.velocity
        yield TrueEffect("rotor_inertia", joint.name, {"inertia": 2e-3 * rng.uniform(0.5, 1.5) * size})
        yield TrueEffect("effort_gain", joint.name, {"gain": 1.0 + 0.03 * rng.standard_normal()})
        offset = float(rng.choice([-1.0, 1.0])) * rng.uniform(1e-3, 5e-3) * joint.effort
        yield TrueEffect("effort_offset", joint.name, {"offset": offset})
    yield TrueEffect("effort_delay", "", {"delay": rng.uniform(0.0, 1.3e-3)})


def _friction(joints: Sequence[UrdfLimits], rotors: dict[str, float], rng: np.random.Generator) -> LuGre:
    limit, top, rotor = np.array([(joint.effort, joint.velocity, rotors[joint.name]) for joint in joints]).T
    n = len(joints)
    level = 0.025 * rng.uniform(0.5, 1.5, n) * limit
    speed = rng.uniform(0.01, 0.05, n) * top
    stiffness = level / rng.uniform(3e-4, 1e-3, n)
    return LuGre(
        level=level,
        excess=rng.uniform(0.1, 0.5, n) * level,
        speed=speed,
        stiffness=stiffness,
        damping=np.sqrt(stiffness * rotor),
        viscous=0.03 * rng.uniform(0.5, 1.5, n) * limit / top,
    )


def _motors(joints: Sequence[UrdfLimits], rng: np.random.Generator) -> Motors:
    limit = np.array([joint.effort for joint in joints])
    n = len(joints)
    return Motors(
        cogging=np.stack([rng.uniform(0.5e-3, 3e-3, n) * limit for _ in _WAVES]),
        ripple=rng.uniform(3e-3, 1.5e-2, n),
        cycles=np.stack([rng.integers(*waves, n).astype(np.float64) for waves in _WAVES]),
        phase=rng.uniform(0.0, 2.0 * np.pi, (len(_WAVES), n)),
        limit=limit,
    )


def _warm_up(joints: int, options: SimulationOptions) -> WarmUp:
    """The robot's by its seed; how cold it is when the recording starts by that of the recording."""
    rng = generator(options.seed, RandomStream.REALISTIC, 4)
    excess, time = rng.uniform(0.05, 0.2, joints), rng.uniform(30.0, 120.0)
    return WarmUp(excess * generator(options.recording_seed, RandomStream.REALISTIC, 6).uniform(0.3, 1.0), time)


def _sensors(joints: Sequence[UrdfLimits], options: SimulationOptions, rng: np.random.Generator) -> Sensors:
    limit = np.array([joint.effort for joint in joints])
    n = len(joints)
    return Sensors(
        encoder=2.0 * np.pi * 0.5 ** rng.integers(17, 21, n).astype(np.float64),
        window=rng.uniform(1e-3, 3e-3),
        effort_noise=rng.uniform(1e-3, 4e-3, n) * limit,
        effort_step=rng.uniform(2e-4, 1.5e-3, n) * limit,
        wrench_noise=np.repeat([options.force_noise, options.torque_noise], 3),
        jitter=rng.uniform(0.02, 0.06) / options.rate,
        lost=rng.uniform(1e-3, 1e-2),
        burst=rng.uniform(1.0, 3.0),
    )
