"""Robots of one type with a planted truth: the type differs from its URDF, and each robot from its type."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from geometry import bodies

from geomid_ros.estimation.population import RobotLikelihood
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import FloatArray

from .arms import Case, Truth, arm, efforts, motion, parameters, samples, solved

NOISE = 0.05


@dataclass(frozen=True, eq=False)
class Type:
    """A type of robot: the ``case`` of its mean, and how far robots are from it, links in geodesic distance per
    direction, friction and rotors relatively, offsets in N m."""

    case: Case
    links: float = 0.05
    effects: float = 0.15

    def robot(self, seed: int) -> Truth:
        """One of its robots."""
        rng = np.random.default_rng([seed, 7])
        mean = self.case.true
        effects = {
            name: values + self.effects * rng.normal(size=len(values))
            if name == "effort_offset"
            else values * np.exp(self.effects * rng.normal(size=len(values)))
            for name, values in mean.effects.items()
        }
        return Truth(changed(mean.links, self.links * bodies.symmetric(rng, len(mean.links))), effects)

    def recorded(self, true: Truth, seed: int, seconds: float) -> Case:
        """A noisy recording of a robot."""
        robot = self.case.model.robot
        rng = np.random.default_rng([seed, 8])
        moving = motion(rng, len(robot.joints), max(seconds, 1.0))
        clean = efforts(robot, true, moving)
        noisy = clean + NOISE * rng.normal(size=clean.shape)
        return Case(self.case.model, samples(moving, noisy), clean, parameters(self.case.model, true), true)

    def fleet(self, robots: int, seconds: float = 10.0, first: int = 0) -> list[RobotLikelihood]:
        """What the data of so many robots say."""
        seeds = range(first, first + robots)
        return [RobotLikelihood.of(solved(self.recorded(self.robot(seed), seed, seconds))) for seed in seeds]


def typical(name: str, seed: int) -> Type:
    """A type of one of the shipped arms."""
    return Type(arm(name, seed))


def changed(links: FloatArray, tangent: FloatArray) -> FloatArray:
    """Links ``(bodies, 10)`` moved along geodesics by symmetric matrices ``(bodies, 4, 4)``."""
    values, vectors = np.linalg.eigh(pseudo_inertia.from_parameters(links))
    root = (vectors * np.sqrt(values)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    values, vectors = np.linalg.eigh(tangent)
    change = (vectors * np.exp(values)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return pseudo_inertia.to_parameters(root @ change @ root)


def with_tool(true: Truth, mass: float, link: int = -1) -> Truth:
    """The same robot with a point mass, and a little size, left on a link."""
    tool = pseudo_inertia.assemble(np.array(mass), np.array([0.02, 0.0, 0.08]), 1e-3 * mass * np.eye(3))
    links = true.links.copy()
    links[link] += tool
    return replace(true, links=links)
