"""The realistic robot of a seed, its control and its integration.

It is a robot as robots are: friction that slips before it slides, motors with cogging and ripple, encoders with steps,
clocks that jitter and messages that are lost. All of it is drawn from the seed; what is hidden comes on top. The rigid
bodies are MuJoCo's, the rest is computed here, and nothing is shared with the effects that the estimator knows.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.simulation.description import Description, LinkInertia, UrdfLimits, perturbed, read_description
from geomid_ros.simulation.effects.choice import chosen_effects
from geomid_ros.simulation.effects.physics import FRICTION, GEARS, TrueEffect, sensed
from geomid_ros.simulation.motion import RunTrace
from geomid_ros.simulation.options import LINK_MASS, Hidden, RandomStream, SimulationOptions, generator
from geomid_ros.simulation.plant import Plant
from geomid_ros.simulation.realistic.parts import LuGre, Motors, Sensors, WarmUp, published
from geomid_ros.simulation.robot import ControlLoop, JointController, TrueRobot
from geomid_ros.simulation.robots import robot_description
from geomid_ros.types import FloatArray

_CAD_ERROR = (0.1, 0.3)


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

    def controlled(self, controller: JointController, step: float) -> ControlLoop:
        """The robot under control, in steps of ``step`` [s]."""
        return RealisticLoop(self.plant, controller, step, self)

    def published(self, trace: RunTrace, options: SimulationOptions) -> RunTrace:
        """What arrives of a true motion."""
        numbers = generator(options.recording_seed, RandomStream.NOISE)
        return published(sensed(trace, self.plant.joints, self.effects), self.sensors, numbers)

    def noise(self, options: SimulationOptions) -> dict[str, FloatArray]:  # noqa: ARG002 its sensors have their own
        """Standard deviations of each channel, those of rounding where an encoder makes it."""
        rounding = self.sensors.encoder / np.sqrt(12.0)
        return {
            "position": rounding,
            "velocity": np.sqrt(2.0) * rounding / self.sensors.window,
            "effort": self.sensors.effort_noise,
            "wrench": self.sensors.wrench_noise,
        }

    def document(self) -> dict[str, Any]:
        """What is hidden (``effects``) and ``standing``, and the numbers of what makes it realistic, in the order of
        the plant's joints and in the units that the classes of these names describe."""
        parts = {name: vars(getattr(self, name)) for name in ("friction", "motors", "warm_up", "sensors")}
        return {
            "effects": [effect.document for effect in self.hidden],
            "standing": [effect.document for effect in self.standing],
            **{name: {key: np.asarray(value).tolist() for key, value in part.items()} for name, part in parts.items()},
        }


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
        friction=LuGre.drawn(joints, rotors, generator(options.seed, RandomStream.REALISTIC, 2)),
        motors=Motors.drawn(joints, generator(options.seed, RandomStream.REALISTIC, 3)),
        warm_up=WarmUp.drawn(len(joints), options),
        sensors=Sensors.drawn(joints, options, generator(options.seed, RandomStream.REALISTIC, 5)),
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


@dataclass(eq=False)
class RealisticLoop(ControlLoop):
    """A realistic robot under control, in steps with one evaluation each.

    Rigid bodies advance by the method of Beeman and Schofield, of second order. The bristles follow their own equation
    exactly, at the step's mean speed and the dry friction of its beginning: in fast sliding they settle within much
    less than a step, which no explicit method would bear.

    A step needs, beside positions and velocities, how far the bristles are bent ``bend (n,)`` [rad], the ``dry``
    friction of steady sliding ``(n,)`` at its beginning, and the acceleration one step ``before``.
    """

    robot: Plant
    truth: RealisticRobot
    bend: FloatArray = field(default_factory=lambda: np.zeros(1))
    dry: FloatArray = field(default_factory=lambda: np.ones(1))
    before: FloatArray | None = None

    def acceleration(self, half_step: int, position: FloatArray, velocity: FloatArray) -> FloatArray:
        truth = self.truth
        effort = truth.motors.supplied(self.controller.effort(half_step, position, velocity))
        self.dry = truth.dry(velocity, position, effort)
        cold = truth.warm_up.cold(0.5 * half_step * self.step)
        friction = truth.friction.force(self.bend, velocity, self.dry, cold)
        unseen = truth.motors.unseen(effort, position)
        return self.robot.acceleration(position, velocity, effort, unseen - friction)

    def advance(
        self, _: int, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        step = self.step
        before = acceleration if self.before is None else self.before
        change = step * (1.5 * acceleration - 0.5 * before)
        moved = step * velocity + step**2 / 6.0 * (4.0 * acceleration - before)
        self.bend = self.truth.friction.bent(self.bend, moved / step, self.dry, step)
        self.before = acceleration
        return position + moved, velocity + change
