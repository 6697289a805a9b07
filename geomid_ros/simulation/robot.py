"""The robot as it truly is."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from geomid_ros.simulation.description import Description, LinkInertia, UrdfLimits, read_description
from geomid_ros.simulation.effects.choice import chosen_effects
from geomid_ros.simulation.effects.physics import TrueEffect
from geomid_ros.simulation.inertias import perturbed
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.plant import Plant
from geomid_ros.simulation.robots import robot_description
from geomid_ros.simulation.seeds import RandomStream, generator
from geomid_ros.simulation.simulator import Simulator


@dataclass(frozen=True, eq=False)
class TrueRobot:
    """The ``nominal`` model that its users know, the true ``bodies`` and ``effects``, and the ``plant`` made of them.

    ``joints`` are in the plant's order, ``bodies`` in that of the URDF.
    """

    nominal: Description
    bodies: tuple[LinkInertia, ...]
    effects: tuple[TrueEffect, ...]
    plant: Simulator
    joints: tuple[UrdfLimits, ...]


Builder = Callable[[Description, Iterable[LinkInertia], Iterable[TrueEffect], str | None], Simulator]
"""Makes a simulator of a kinematic tree, true bodies, effects and the frame of a wrench sensor."""


def build_robot(options: SimulationOptions, builder: Builder = Plant) -> TrueRobot:
    """The robot that ``options`` and their seed describe, in the simulator that ``builder`` makes."""
    nominal = read_description(robot_description(options.robot))
    numbers = generator(options.seed, RandomStream.INERTIA)
    bodies = tuple(perturbed(body, options.inertia_error, numbers) for body in nominal.inertias)
    effects = chosen_effects(options, nominal)
    plant = builder(nominal, bodies, effects, options.wrench_frame)
    limits = {joint.name: joint for joint in nominal.joints}
    return TrueRobot(nominal, bodies, effects, plant, tuple(limits[name] for name in plant.joints))
