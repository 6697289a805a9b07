"""The interface of a simulated robot, and what all simulators share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence

import numpy as np

from geomid_ros.simulation.effects.physics import FORCES, FRICTION, GEARS, Places, TrueEffect, play_name, wound
from geomid_ros.types import FloatArray, IntArray

_WINDINGS = 10  # each leaves a few per cent of the last one's error in how far gears are wound up at rest


class Simulator(ABC):
    """A robot with a fixed base, hinges and slides, driven by the joints' efforts. Nothing collides.

    ``joints`` are its n motors. States ``(m,)`` have the motors at ``driven (n,)``, and among them the hinges that
    gears with play or elasticity add; ``names`` are those of all m, for which see :func:`play_name`.
    """

    def __init__(self, names: Sequence[str], motors: Iterable[str], effects: Iterable[TrueEffect]) -> None:
        motors = set(motors)
        self.joints = tuple(name for name in names if name in motors)
        self.driven: IntArray = np.array([names.index(name) for name in self.joints])
        places = [
            (effect, Places(*(_index(names, name) for name in (effect.joint, effect.other, play_name(effect.joint)))))
            for effect in effects
        ]
        self._frictions = [(effect, at.joint) for effect, at in places if effect.name in FRICTION]
        self._forces = [(effect, at) for effect, at in places if effect.name in FORCES]
        self._gears = [(effect, at) for effect, at in places if effect.name in GEARS]
        self._places = places

    def at_rest(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A state, positions and velocities ``(m,)``, with the motors held at ``position (n,)``."""
        size = len(self.driven) + len({at.play for _, at in self._gears})
        state, rest = np.zeros(size), np.zeros(size)
        state[self.driven] = position
        for _ in range(_WINDINGS if self._gears else 0):
            load = self.inverse_dynamics(state, rest, rest)
            for effect, at in self._gears:
                state[at.play] = -wound(effect.parameters, float(load[at.joint]))
        return state, rest

    def _friction_levels(self, position: FloatArray, velocity: FloatArray, effort: FloatArray) -> FloatArray:
        """Magnitude of dry friction ``(m,)`` at a state under the motors' ``effort (n,)``."""
        levels = np.zeros(len(position))
        motors = self.driven.tolist()
        for effect, at in self._frictions:
            state = float(position[at]), float(velocity[at]), float(effort[motors.index(at)])
            levels[at] += FRICTION[effect.name](effect.parameters, *state)
        return levels

    def _needed(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """What the motors supply ``(m,)`` against forces that depend on the state."""
        needed = np.zeros(len(position))
        positions, velocities = position.tolist(), velocity.tolist()
        for effect, at in self._forces:
            FORCES[effect.name](effect.parameters, at, positions, velocities, needed)
        return needed

    @abstractmethod
    def moves(self, link: str) -> bool:
        """Whether any joint moves the link."""

    @abstractmethod
    def acceleration(self, position: FloatArray, velocity: FloatArray, effort: FloatArray) -> FloatArray:
        """Accelerations ``(m,)`` of a state under commanded ``effort (n,)``, cut to the joints' effort limits."""

    @abstractmethod
    def effort(self) -> FloatArray:
        """The motors' efforts ``(n,)`` at the state last given to :meth:`acceleration`."""

    @abstractmethod
    def wrench(self) -> FloatArray:
        """Force [N] and torque [N m], ``(6,)``, at the state last given to :meth:`acceleration`; ``(0,)`` unsensed.

        It is what the side of the base applies to the far side, about the sensor frame's origin in its axes: at rest
        the force points up and equals the weight that the sensor carries.
        """

    @abstractmethod
    def inverse_dynamics(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Efforts ``(m,)`` that the motion of a state takes, dry friction apart."""

    @abstractmethod
    def inertia_matrix(self, position: FloatArray) -> FloatArray:
        """The joint-space inertia matrix ``(m, m)`` of a state, rotors included [kg m^2 or kg]."""


def _index(names: Sequence[str], name: str) -> int:
    return names.index(name) if name in names else -1
