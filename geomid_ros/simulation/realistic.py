"""Realistic robot of a seed, its control and its integration.

It has friction with presliding, motors with cogging and ripple, encoders with finite resolution, clock jitter and lost
messages. All of it is drawn from the seed; hidden effects are added. MuJoCo computes the rigid bodies, and this file
the rest. Nothing is shared with the effects of the estimator.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from geomid_ros.errors import InputError, check_name
from geomid_ros.simulation.description import (
    Description,
    LinkInertia,
    UrdfLimits,
    perturbed,
    read_description,
    robot_description,
)
from geomid_ros.simulation.effect_sizes import chosen_effects
from geomid_ros.simulation.effects import FRICTION, TrueEffect, added_friction, is_by_load, noiseless_measurement
from geomid_ros.simulation.motion import RunTrace
from geomid_ros.simulation.options import GEARS, LINK_MASS, Hidden, RandomStream, SimulationOptions, generator
from geomid_ros.simulation.plant import Plant
from geomid_ros.simulation.robot import ControlLoop, JointController, TrueRobot, rounded
from geomid_ros.types import BoolArray, FloatArray

_WAVES = ((8, 40), (60, 200))  # cycles per turn: of the magnets, of the gear


@dataclass(frozen=True, eq=False)
class LuGre:
    """LuGre friction of n joints (Canudas de Wit et al. 1995), whose bristles are deflected by ``z (n,)`` [rad].

    ``dz/dt = v - |v| stiffness z / g(v)`` and ``F = stiffness z + damping exp(-(v/speed)^2) dz/dt + viscous v``, with
    the dry friction ``g(v) = level + excess exp(-(v/speed)^2)`` of steady sliding. The bristles' damping fades with
    speed; otherwise friction would drive a joint that slides fast (Olsson 1996).

    Attributes:
        level, excess: Dry friction while sliding fast ``(n,)``, and its increase near standstill [N m].
        speed: Speed at which the excess has fallen to 37 % ``(n,)`` [rad/s].
        stiffness, damping: Of the bristles ``(n,)`` [N m/rad, N m s/rad].
        viscous: Viscous friction of a warm joint ``(n,)`` [N m s/rad].
    """

    level: FloatArray
    excess: FloatArray
    speed: FloatArray
    stiffness: FloatArray
    damping: FloatArray
    viscous: FloatArray

    def sliding(self, velocity: FloatArray) -> FloatArray:
        """Dry friction ``g(v) (n,)`` of steady sliding [N m]."""
        return self.level + self.excess * self._slow(velocity)

    def bent(self, z: FloatArray, velocity: FloatArray, dry: FloatArray, step: float) -> FloatArray:
        """Bristle deflection ``(n,)`` after ``step`` [s] at constant velocity, under ``dry`` friction g (exact)."""
        end = np.sign(velocity) * dry / self.stiffness
        bent: FloatArray = end + (z - end) * np.exp(-step * np.abs(velocity) * self.stiffness / dry)
        return bent

    def force(self, z: FloatArray, velocity: FloatArray, dry: FloatArray, cold: FloatArray | float = 1.0) -> FloatArray:
        """Friction ``(n,)`` [N m], positive for positive velocity; viscous friction: ``cold`` times its warm value."""
        rate = velocity - np.abs(velocity) * self.stiffness * z / dry
        force: FloatArray = (
            self.stiffness * z + self.damping * self._slow(velocity) * rate + cold * self.viscous * velocity
        )
        return force

    def _slow(self, velocity: FloatArray) -> FloatArray:
        slow: FloatArray = np.exp(-((velocity / self.speed) ** 2))
        return slow

    @staticmethod
    def drawn(joints: Sequence[UrdfLimits], rotors: dict[str, float], rng: np.random.Generator) -> LuGre:
        """Draw the friction of joints with these rotor inertias, by joint."""
        limit, velocity, rotor = np.array([(joint.effort, joint.velocity, rotors[joint.name]) for joint in joints]).T
        n = len(joints)
        level = 0.025 * rng.uniform(0.5, 1.5, n) * limit
        speed = rng.uniform(0.01, 0.05, n) * velocity
        stiffness = level / rng.uniform(3e-4, 1e-3, n)
        return LuGre(
            level=level,
            excess=rng.uniform(0.1, 0.5, n) * level,
            speed=speed,
            stiffness=stiffness,
            damping=np.sqrt(stiffness * rotor),
            viscous=0.03 * rng.uniform(0.5, 1.5, n) * limit / velocity,
        )


@dataclass(frozen=True, eq=False)
class Motors:
    """n motors with their gears.

    Attributes:
        cogging: Amplitudes of effort without current, by magnets and gear teeth ``(waves, n)`` [N m].
        ripple: Amplitude of the torque ripple as a fraction of the commanded effort ``(n,)``.
        cycles, phase: Cycles of cogging per turn of the joint, and their phases ``(waves, n)`` [rad]; the ripple has
            twice the first.
        limit: Largest effort ``(n,)`` [N m].
    """

    cogging: FloatArray
    ripple: FloatArray
    cycles: FloatArray
    phase: FloatArray
    limit: FloatArray

    def unmeasured_effort(self, effort: FloatArray, position: FloatArray) -> FloatArray:
        """Cogging and ripple: efforts at the joints ``(n,)`` that the currents do not show."""
        angles = self.cycles * position + self.phase
        cogging = (self.cogging * np.sin(angles)).sum(axis=0)
        unseen: FloatArray = cogging + self.ripple * effort * np.sin(2.0 * angles[0])
        return unseen

    @staticmethod
    def drawn(joints: Sequence[UrdfLimits], rng: np.random.Generator) -> Motors:
        """Draw the motors of joints."""
        limit = np.array([joint.effort for joint in joints])
        n = len(joints)
        return Motors(
            cogging=np.stack([rng.uniform(0.5e-3, 3e-3, n) * limit for _ in _WAVES]),
            ripple=rng.uniform(3e-3, 1.5e-2, n),
            cycles=np.stack([rng.integers(*waves, n).astype(np.float64) for waves in _WAVES]),
            phase=rng.uniform(0.0, 2.0 * np.pi, (len(_WAVES), n)),
            limit=limit,
        )


@dataclass(frozen=True, eq=False)
class WarmUp:
    """Viscous friction is ``1 + excess exp(-t / time)`` times its warm value; ``excess (n,)``, ``time`` [s]."""

    excess: FloatArray
    time: float

    def cold(self, instant: float) -> FloatArray:
        """Factor of viscous friction ``(n,)`` at an instant [s]."""
        return 1.0 + self.excess * math.exp(-instant / self.time)

    @staticmethod
    def drawn(joints: int, options: SimulationOptions) -> WarmUp:
        """Draw the warm-up by the robot's seed, and the fraction of it that remains at the start by the recording's."""
        rng = generator(options.seed, RandomStream.REALISTIC, 4)
        excess, time = rng.uniform(0.05, 0.2, joints), rng.uniform(30.0, 120.0)
        return WarmUp(excess * generator(options.recording_seed, RandomStream.REALISTIC, 6).uniform(0.3, 1.0), time)


@dataclass(frozen=True, eq=False)
class Sensors:
    """Sensors of n joints and the transport of their messages.

    Attributes:
        encoder: Resolution of the positions ``(n,)`` [rad].
        window: Time over which the drive differentiates positions [s].
        effort_noise, effort_step: Standard deviation and resolution of efforts ``(n,)`` [N m].
        wrench_noise: Standard deviations of force and torque ``(6,)`` [N, N m].
        jitter: Standard deviation of the stamps [s].
        lost: Fraction of lost messages. burst: Mean number of consecutive lost messages.
    """

    encoder: FloatArray
    window: float
    effort_noise: FloatArray
    effort_step: FloatArray
    wrench_noise: FloatArray
    jitter: float
    lost: float
    burst: float

    @staticmethod
    def drawn(joints: Sequence[UrdfLimits], options: SimulationOptions, rng: np.random.Generator) -> Sensors:
        """Draw the sensors of joints."""
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


def published(trace: RunTrace, sensors: Sensors, rng: np.random.Generator) -> RunTrace:
    """Messages that arrive, from a ``trace`` of true positions, velocities, accelerations, and efforts before noise."""
    earlier = trace.position - sensors.window * (trace.velocity - 0.5 * sensors.window * trace.acceleration)
    position, previous = (rounded(values, sensors.encoder) for values in (trace.position, earlier))
    effort = trace.effort + sensors.effort_noise * rng.standard_normal(trace.effort.shape)
    wrench = trace.wrench + sensors.wrench_noise[: trace.wrench.shape[1]] * rng.standard_normal(trace.wrench.shape)
    jitter = _jitter(trace.time, sensors.jitter, rng)
    measured = replace(
        trace,
        time=trace.time + jitter,
        wrench_time=trace.wrench_time + jitter,
        position=position,
        velocity=(position - previous) / sensors.window,
        effort=rounded(effort, sensors.effort_step),
        wrench=wrench,
    )
    return _arrived(measured, arrival_mask(len(trace.time), sensors.lost, sensors.burst, rng))


def arrival_mask(messages: int, lost: float, burst: float, rng: np.random.Generator) -> BoolArray:
    """Mask of the messages that arrive ``(T,)``: a two-state chain (Gilbert 1960); the first and last always do."""
    ends, begins = 1.0 / burst, lost / (burst * (1.0 - lost))
    draws, arrives, up = rng.uniform(size=messages), np.ones(messages, dtype=np.bool_), True
    for index, draw in enumerate(draws.tolist()):
        up = draw >= begins if up else draw < ends
        arrives[index] = up
    arrives[[0, -1]] = True
    return arrives


def _jitter(time: FloatArray, size: float, rng: np.random.Generator) -> FloatArray:
    """Errors of stamps ``(T,)`` [s], limited so that stamps stay in order and the first is not before zero."""
    limit = 0.45 * float(np.min(np.diff(time)))
    errors: FloatArray = np.clip(size * rng.standard_normal(len(time)), -limit, limit)
    errors[0] = abs(errors[0])
    return errors


def _arrived(trace: RunTrace, arrives: BoolArray) -> RunTrace:
    per_message = ("time", "position", "velocity", "acceleration", "effort", "wrench_time", "wrench", "feedforward")
    arrays = {name: getattr(trace, name)[arrives] for name in per_message}
    return replace(trace, commands=trace.commands.select(arrives), **arrays)


_CAD_ERROR = (0.1, 0.3)


@dataclass(frozen=True, eq=False)
class RealisticRobot(TrueRobot):
    """Realistic robot: all friction but hidden viscous friction is computed outside of its ``plant``.

    Attributes:
        standing, hidden: The effects that the robot always has, and the hidden ones; ``effects`` are all of them, with
            the delays added up.
        friction, motors, warm_up, sensors: The realistic parts.
    """

    plant: Plant
    standing: tuple[TrueEffect, ...]
    hidden: tuple[TrueEffect, ...]
    friction: LuGre
    motors: Motors
    warm_up: WarmUp
    sensors: Sensors

    def dry(self, velocity: FloatArray, position: FloatArray, effort: FloatArray) -> FloatArray:
        """Dry friction ``(n,)`` of steady sliding, including hidden friction [N m]."""
        level = self.friction.sliding(velocity)
        for effect in self._frictions:
            index = self.plant.joints.index(effect.joint)
            state = float(position[index]), float(velocity[index]), float(effort[index])
            level[index] += added_friction(effect, *state, level=level[index], viscous=self.friction.viscous[index])
        return level

    @cached_property
    def _frictions(self) -> list[TrueEffect]:
        return sorted((e for e in self.effects if e.name in FRICTION), key=is_by_load)

    def controlled(self, controller: JointController, step: float) -> ControlLoop:
        """Put the robot under control, in steps of ``step`` [s]."""
        return RealisticLoop(self.plant, controller, step, self)

    def published(self, trace: RunTrace, options: SimulationOptions) -> RunTrace:
        """Measurements of a true motion, as they arrive."""
        numbers = generator(options.recording_seed, RandomStream.NOISE)
        return published(noiseless_measurement(trace, self.plant.joints, self.effects), self.sensors, numbers)

    def noise(self, options: SimulationOptions) -> dict[str, FloatArray]:  # noqa: ARG002 its sensors have their own
        """Noise standard deviations of the channels; of position and velocity, the encoder's rounding."""
        rounding = self.sensors.encoder / np.sqrt(12.0)
        return {
            "position": rounding,
            "velocity": np.sqrt(2.0) * rounding / self.sensors.window,
            "effort": self.sensors.effort_noise,
            "wrench": self.sensors.wrench_noise,
        }

    def document(self) -> dict[str, Any]:
        """Entries of the truth file: hidden (``effects``) and ``standing`` effects, and the values of the realistic
        parts, in the order of the plant's joints and the units of their classes."""
        parts = {name: vars(getattr(self, name)) for name in ("friction", "motors", "warm_up", "sensors")}
        return {
            "effects": [effect.document for effect in self.hidden],
            "standing": [effect.document for effect in self.standing],
            **{name: {key: np.asarray(value).tolist() for key, value in part.items()} for name, part in parts.items()},
        }


def build_realistic(options: SimulationOptions) -> RealisticRobot:
    """Build the robot of ``options.seed``, with the hidden effects of ``options.hide`` added."""
    nominal = read_description(robot_description(options.robot))
    numbers = generator(options.seed, RandomStream.REALISTIC, 0)
    bodies = [perturbed(body, numbers.uniform(*_CAD_ERROR), numbers) for body in nominal.inertias]
    requests = options.hide or ()
    masses = tuple(_changed_mass(request, nominal) for request in requests if request.effect == LINK_MASS)
    requested = tuple(request for request in requests if request.effect != LINK_MASS)
    hidden = chosen_effects(replace(options, hide=requested), nominal)
    for effect in hidden:
        if effect.name in GEARS:
            raise InputError(f"{effect.name} cannot be hidden in a realistic robot; leave out --realistic.")
    standing = tuple(_standing(nominal.joints, generator(options.seed, RandomStream.REALISTIC, 1)))
    in_plant = [effect for effect in (*standing, *hidden) if effect.name not in FRICTION]
    true_bodies = tuple(_scaled(body, masses) for body in bodies)
    plant = Plant(nominal, true_bodies, in_plant, options.wrench_frame)
    limits = {joint.name: joint for joint in nominal.joints}
    joints = tuple(limits[name] for name in plant.joints)
    rotors = {effect.joint: effect.parameters["inertia"] for effect in standing if effect.name == "rotor_inertia"}
    return RealisticRobot(
        nominal=nominal,
        bodies=true_bodies,
        effects=_with_one_delay([*standing, *hidden]),
        plant=plant,
        joints=joints,
        standing=standing,
        hidden=(*masses, *hidden),
        friction=LuGre.drawn(joints, rotors, generator(options.seed, RandomStream.REALISTIC, 2)),
        motors=Motors.drawn(joints, generator(options.seed, RandomStream.REALISTIC, 3)),
        warm_up=WarmUp.drawn(len(joints), options),
        sensors=Sensors.drawn(joints, options, generator(options.seed, RandomStream.REALISTIC, 5)),
    )


def _with_one_delay(effects: Sequence[TrueEffect]) -> tuple[TrueEffect, ...]:
    """Return the effects with the sum of their delays in place of all delays."""
    delay = sum(effect.parameters.get("delay", 0.0) for effect in effects)
    return (*(e for e in effects if e.name != "effort_delay"), TrueEffect("effort_delay", "", {"delay": delay}))


def _changed_mass(request: Hidden, robot: Description) -> TrueEffect:
    names = [body.name for body in robot.inertias if robot.moved_by(body.name)]
    check_name("moving link with a mass", request.place, names)
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
    """Realistic robot under control, integrated with one evaluation per step.

    Rigid bodies advance by the second-order method of Beeman and Schofield. The bristles' equation is solved exactly,
    at the step's mean speed and the dry friction at its beginning: in fast sliding the bristles settle within much less
    than a step, which would make any explicit method unstable.

    Besides positions and velocities, a step needs the bristle deflection ``bend (n,)`` [rad], the ``dry`` friction of
    steady sliding ``(n,)`` at its beginning, and the acceleration one step ``before``.
    """

    robot: Plant
    truth: RealisticRobot
    bend: FloatArray = field(default_factory=lambda: np.zeros(1))
    dry: FloatArray = field(default_factory=lambda: np.ones(1))
    before: FloatArray | None = None

    def acceleration(self, half_step: int, position: FloatArray, velocity: FloatArray) -> FloatArray:
        truth = self.truth
        commanded, limit = self.controller.effort(half_step, position, velocity), truth.motors.limit
        effort = np.clip(commanded, -limit, limit)
        self.dry = truth.dry(velocity, position, effort)
        cold = truth.warm_up.cold(0.5 * half_step * self.step)
        friction = truth.friction.force(self.bend, velocity, self.dry, cold)
        unseen = truth.motors.unmeasured_effort(effort, position)
        return self.robot.acceleration(position, velocity, effort, unseen - friction)

    def advance(
        self, _: int, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        step = self.step
        previous = acceleration if self.before is None else self.before
        velocity_step = step * (1.5 * acceleration - 0.5 * previous)
        position_step = step * velocity + step**2 / 6.0 * (4.0 * acceleration - previous)
        self.bend = self.truth.friction.bent(self.bend, position_step / step, self.dry, step)
        self.before = acceleration
        return position + position_step, velocity + velocity_step
