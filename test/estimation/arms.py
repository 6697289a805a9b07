"""Arms with a planted truth: random chains, or those of ``bags/``, and what their joints feel, by pinocchio's RNEA.

A chain's URDF can be written with link frames of one's choice and in other units: the same robot to the eye, other
numbers to the estimator.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
from geometry import bodies
from model.robots import fixed_base

from geomid_ros.estimation.estimate import EffectEstimate, Estimate
from geomid_ros.estimation.estimator import EstimatorSettings
from geomid_ros.estimation.identifier import Identifier
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import DriveGain, IdentifiedEffect, identifiable, joint_of
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray, IntArray

BAGS = Path(__file__).parents[2] / "bags"
ALL_EFFECTS = ("viscous_friction", "coulomb_friction", "rotor_inertia", "effort_offset")
COULOMB_SPEED = 0.02


@cache
def shipped(name: str) -> str:
    """The text of ``bags/NAME.urdf``."""
    return (BAGS / f"{name}.urdf").read_text(encoding="utf-8")


@dataclass(frozen=True, eq=False)
class Motion:
    """Joint motion over N instants, each ``(N, joints)``."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray

    def __len__(self) -> int:
        return len(self.position)


def motion(rng: np.random.Generator, joints: int, seconds: float, rate: float = 100.0) -> Motion:
    """A sum of five sines per joint, of period 10 s and its harmonics."""
    times = np.arange(round(seconds * rate))[:, None] / rate
    position, velocity, acceleration = np.zeros((3, len(times), joints))
    for harmonic in range(1, 6):
        omega = 2.0 * np.pi * harmonic / 10.0
        size, phase = 1.2 * rng.normal(size=joints) / harmonic, rng.uniform(0.0, 2.0 * np.pi, size=joints)
        position += size * np.sin(omega * times + phase)
        velocity += size * omega * np.cos(omega * times + phase)
        acceleration -= size * omega**2 * np.sin(omega * times + phase)
    return Motion(position, velocity, acceleration)


@dataclass(frozen=True, eq=False)
class Truth:
    """True links ``(bodies, 10)`` in their link frames, and the effects' coefficients ``(joints,)`` by name."""

    links: FloatArray
    effects: dict[str, FloatArray]


def truth(rng: np.random.Generator, robot: Robot, size: float = 0.2) -> Truth:
    """Links at the geodesic distance of about ``sqrt(10) size`` from the URDF's, and joints with all effects."""
    links = np.array([body.parameters for body in robot.bodies])
    root = np.linalg.cholesky(pseudo_inertia.from_parameters(links))
    draw = size * bodies.symmetric(rng, len(links))
    values, vectors = np.linalg.eigh(draw)
    change = (vectors * np.exp(values)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    joints = len(robot.joints)
    effects = {
        "viscous_friction": rng.uniform(0.1, 1.0, size=joints),
        "coulomb_friction": rng.uniform(0.2, 1.5, size=joints),
        "rotor_inertia": rng.uniform(0.02, 0.2, size=joints),
        "effort_offset": 0.5 * rng.normal(size=joints),
    }
    return Truth(pseudo_inertia.to_parameters(root @ change @ np.swapaxes(root, 1, 2)), effects)


def parameters(model: MeasurementModel, true: Truth) -> FloatArray:
    """The truth as the model's parameter vector ``(D,)``."""
    effects = [true.effects[c.effect.name][joint_of(c.place)] for c in model.coefficients]
    return np.concatenate([true.links[list(model.identified)].ravel(), effects])


def efforts(robot: Robot, true: Truth, moving: Motion, gravity: Sequence[float] = (0.0, 0.0, -9.81)) -> FloatArray:
    """What the joints of a fixed-base arm feel ``(N, joints)``: RNEA with the true inertias, plus the effects."""
    model = pin.buildModelFromXML(robot.urdf)
    model.gravity.linear = np.array(gravity)
    for index in range(1, model.njoints):
        model.inertias[index] = pin.Inertia.Zero()
    for body, ten in zip(robot.bodies, true.links, strict=True):
        frame = model.frames[model.getFrameId(body.name, pin.BODY)]
        model.inertias[frame.parentJoint] += frame.placement.act(pin.Inertia.FromDynamicParameters(ten))
    data = model.createData()
    q, v, a = moving.position, moving.velocity, moving.acceleration
    rigid = np.array([pin.rnea(model, data, *state) for state in zip(q, v, a, strict=True)])
    columns = {
        "viscous_friction": v,
        "coulomb_friction": np.tanh(v / COULOMB_SPEED),
        "rotor_inertia": a,
        "effort_offset": np.ones_like(v),
    }
    return rigid + sum(coefficients * columns[name] for name, coefficients in true.effects.items())


def samples(moving: Motion, measured: FloatArray, rate: float = 100.0) -> Samples:
    """Samples of a fixed-base arm without wrench sensors."""
    stamps = (np.arange(len(moving)) / rate * 1e9).astype(np.int64)
    return fixed_base(stamps, moving.position, moving.velocity, moving.acceleration, measured)


@dataclass(frozen=True, eq=False)
class Case:
    """A model, noisy samples of it, and what is true."""

    model: MeasurementModel
    samples: Samples
    noiseless: FloatArray
    truth: FloatArray
    true: Truth

    @property
    def effects(self) -> list[IdentifiedEffect]:
        """The effects of its model, at every joint."""
        return [identifiable()[name] for name in self.true.effects]

    def fresh(self, seed: int, seconds: float = 20.0) -> Case:
        """The same robot in another motion."""
        robot = self.model.robot
        moving = motion(np.random.default_rng([seed, 1]), len(robot.joints), seconds)
        clean = efforts(robot, self.true, moving)
        return replace(self, samples=samples(moving, clean), noiseless=clean)

    def error(self, found: FloatArray) -> FloatArray:
        """RMS error of the predicted efforts against the noiseless ones, by joint."""
        exact, predicted = self.model.predict(replace(self.samples, effort=self.noiseless), found)
        return np.sqrt(np.mean((predicted - exact) ** 2, axis=0))

    def with_efforts(self, measured: FloatArray) -> Case:
        """The same motion, other measurements."""
        return replace(self, samples=replace(self.samples, effort=measured))


@cache
def arm(
    name: str,
    seed: int,
    seconds: float = 20.0,
    noise: float = 0.05,
    effects: tuple[str, ...] = ALL_EFFECTS,
    links: tuple[str, ...] | None = None,
    size: float = 0.2,
) -> Case:
    """An arm of ``bags/`` with a hidden truth (in all links and effects named), moved and measured."""
    rng = np.random.default_rng(seed)
    robot = Robot(shipped(name))
    model = MeasurementModel(robot, [identifiable()[effect] for effect in effects], links=links)
    true = truth(rng, robot, size)
    if links is not None:
        known = [index for index in range(len(robot.bodies)) if index not in model.identified]
        true.links[known] = [robot.bodies[index].parameters for index in known]
    true = Truth(true.links, {effect: true.effects[effect] for effect in effects})
    moving = motion(rng, len(robot.joints), seconds)
    clean = efforts(robot, true, moving)
    noisy = clean + noise * rng.normal(size=clean.shape)
    return Case(model, samples(moving, noisy), clean, parameters(model, true), true)


def identifier(case: Case, prior: FloatArray | None = None, **settings: object) -> Identifier:
    """That was given the samples."""
    result = Identifier(case.model, EstimatorSettings(**settings), prior=prior)
    result.add(case.samples)
    return result


def solved(case: Case, **settings: object) -> Estimate:
    """The estimate of the samples."""
    return identifier(case, **settings).solve()


def without_gains(effects: Sequence[EffectEstimate]) -> list[EffectEstimate]:
    """The effects of the model's coefficients."""
    return [effect for effect in effects if effect.name != DriveGain.name]


def summary(
    model: MeasurementModel, coefficients: FloatArray, targets: FloatArray, regimes: IntArray | int = 0
) -> RowSummary:
    """Of rows all at once, of fast motion unless it is said."""
    result = RowSummary(model.channels)
    result.add(coefficients, targets, regimes=regimes)
    return result
