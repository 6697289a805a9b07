"""What the robot was measured to do, as arrays over N instants, and how well that tells the joints' dry friction.

The joint axis follows :attr:`Robot.joints`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from geomid_ros.model import se3
from geomid_ros.model.columns import NO_ENTRIES, Column, Entries, JointColumn, entries_of
from geomid_ros.model.effects import JointMotion, Motion, MotionEffect, Place
from geomid_ros.types import AnyArray, BoolArray, FloatArray, IntArray

_PAUSE = 1.5  # sampling periods
WIDEST = np.pi
"""[rad, m] to either side, where a joint has no ends."""
ACCELERATION_PER_SPEED = 4.0
"""[1/s] of usual motion."""
PIECE = 50
"""Samples: of so many the rows, and what else is computed of them, take little memory."""
STILL = 0.01
"""[rad/s or m/s] below this friction is no function of speed. (The node's ``still_speed`` is another one: below it all
instants of a pose say the same.)"""
# At a reversal friction depends on the past: within the filter's window a joint may stand still for so short a time,
# and must move so much one way.
_REST_SHARE = 0.3
_SAME_WAY = 0.97


@dataclass(frozen=True, eq=False)
class Samples:
    """Aligned, filtered and differentiated measurements at N common instants. Arrays are read-only.

    ``stamps (N,)`` ns; ``position, velocity, acceleration, effort (N, joints)`` in rad, m, N m, N (SI), NaN where an
    effort is not measured; ``base_pose (N, 7)`` position and quaternion xyzw of the base in the world,
    ``base_velocity, base_acceleration (N, 6)`` its spatial velocity and that velocity's derivative in the base frame
    (linear, angular), all with 0 columns for a fixed base; ``wrenches (N, sensors, 6)`` force and torque.
    ``effects (N, entries)`` are the ``entries`` of effects' columns, computed before the filter and filtered as the
    efforts were; a column that is not among them is computed from the motion given here, which is right when that is
    exact. ``standing (N, feet)``: which feet may touch the ground, none if it has no columns.
    ``commands (N, 4, joints)``: set-points of position and velocity, the feed-forward, and the efforts that messages
    report, where efforts are those of commands; else without joints.
    """

    stamps: IntArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    effort: FloatArray
    base_pose: FloatArray
    base_velocity: FloatArray
    base_acceleration: FloatArray
    wrenches: FloatArray
    effects: FloatArray = None  # type: ignore[assignment]  # replaced by an array without columns
    entries: Entries = NO_ENTRIES
    standing: BoolArray = None  # type: ignore[assignment]  # the same
    commands: FloatArray = None  # type: ignore[assignment]  # the same

    def __post_init__(self) -> None:
        if self.effects is None:
            object.__setattr__(self, "effects", np.zeros((len(self.position), 0)))
        if self.standing is None:
            object.__setattr__(self, "standing", np.zeros((len(self.position), 0), dtype=np.bool_))
        if self.commands is None:
            object.__setattr__(self, "commands", np.zeros((len(self.position), 4, 0)))
        if self.effects.shape[1] != len(self.entries):
            raise ValueError(f"{self.effects.shape[1]} entries of effects' columns, expected {len(self.entries)}")
        for name, values in self.arrays.items():
            array = np.asarray(values)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def arrays(self) -> dict[str, AnyArray]:
        """All arrays by name."""
        return {name: values for name, values in vars(self).items() if name != "entries"}

    @property
    def seconds(self) -> FloatArray:
        """Time since the first sample ``(N,)`` [s]."""
        return np.asarray((self.stamps - self.stamps[0]) * 1e-9)

    @property
    def states(self) -> FloatArray:
        """The state of the motion ``(N, S)``: that of the joints, and of a base but for its place and heading."""
        states = [self.position, self.velocity, self.acceleration]
        if self.base_pose.shape[1]:
            up = se3.turned_back(self.base_pose[:, 3:], np.array([0.0, 0.0, 1.0]))
            states += [up, self.base_velocity, self.base_acceleration]
        return np.concatenate(states, axis=1)

    @property
    def motion(self) -> Motion:
        """The joints' motion."""
        return Motion(np.array([self.position, self.velocity, self.acceleration]))

    def efforts_of(self, effects: Iterable[tuple[MotionEffect, Place, float]]) -> FloatArray:
        """What effects of motion, each at a place with its coefficient, add to the joints' efforts ``(N, J)``."""
        entries, strengths = entries_of(effects, self.position.shape[1])
        return np.asarray(self.values_of(entries) @ strengths)

    def values_of(self, entries: Entries) -> FloatArray:
        """The values ``(N, len(entries))`` of columns' entries."""
        if entries.columns == self.entries.columns:
            return self.effects
        values = np.empty((len(self), len(entries)))
        for column in entries.columns:
            places, joints = entries.of(column)
            values[:, places] = self.column(column)[:, joints]
        return values

    def column(self, column: Column) -> FloatArray:
        """One of the effects' columns ``(N, joints)``."""
        if column not in self.entries:
            return column.values(self.motion)
        places, joints = self.entries.of(column)
        if len(joints) == self.position.shape[1]:
            return np.asarray(self.effects[:, places])
        values = np.zeros(self.position.shape)
        values[:, joints] = self.effects[:, places]
        return values

    def select(self, index: AnyArray | slice) -> Samples:
        """The samples chosen by a mask, index array or slice."""
        return self._with({name: array[index] for name, array in self.arrays.items()})

    def _with(self, arrays: dict[str, AnyArray], **others: Entries) -> Samples:
        """A copy with other arrays; to make it anew would take longer than what is done with a few instants."""
        for array in arrays.values():
            array.setflags(write=False)
        found = object.__new__(Samples)
        vars(found).update(vars(self) | arrays | others)
        return found

    def in_pieces(self) -> Iterator[Samples]:
        """The same, a few at a time: what is computed for each takes little memory. At least one piece, be it empty."""
        for begin in range(0, max(len(self), 1), PIECE):
            yield self.select(slice(begin, begin + PIECE))

    def with_columns(self, chosen: Collection[Column]) -> Samples:
        """The same with none of the effects' columns but those that are ``chosen``."""
        columns = tuple(column for column in self.entries.columns if column in chosen)
        entries = Entries(columns, self.entries.joints)
        return self._with({"effects": self.values_of(entries)}, entries=entries)

    def with_joints(self, order: IntArray) -> Samples:
        """The samples in which joint j does what joint ``order[j]`` did; ``order (joints,)``. Columns of effects that
        act on several joints at once are not among theirs."""
        own = self.entries.of_own_motion
        effects = [self.effects[:, self.entries.of(column)[0]][:, order] for column in own.columns]
        arrays: dict[str, Any] = {
            name: self.arrays[name][:, order] for name in ("position", "velocity", "acceleration", "effort")
        }
        return replace(self, **arrays, effects=np.concatenate([self.effects[:, :0], *effects], axis=1), entries=own)

    def stretches(self) -> list[Samples]:
        """The parts without a pause between them: a step longer than 1.5 times the median one."""
        steps = np.diff(self.stamps)
        ends = np.flatnonzero(steps > _PAUSE * np.median(steps)) + 1 if len(steps) else steps
        return [self.select(slice(begin, end)) for begin, end in pairwise([0, *ends.tolist(), len(self)])]

    @staticmethod
    def concatenate(parts: list[Samples]) -> Samples:
        """All samples of ``parts`` (at least one), in order."""
        if len(parts) == 1:
            return parts[0]
        arrays: dict[str, Any] = {
            name: np.concatenate([part.arrays[name] for part in parts]) for name in parts[0].arrays
        }
        return replace(parts[0], **arrays)


def random_states(
    random: np.random.Generator, count: int, limits: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Random positions, velocities and accelerations ``(3, count, J)``: between position ``limits (J, 2)`` and within a
    turn, and as fast in either direction as ``velocity (J,)`` and ``acceleration (J,)`` at most."""
    low, high = np.clip(limits, -WIDEST, WIDEST).T
    position = random.uniform(low, high, (count, len(low)))
    return np.array([position, *(random.uniform(-1.0, 1.0, (2, *position.shape)) * [[velocity], [acceleration]])])


def samples_of(states: FloatArray, sensors: int = 0) -> Samples:
    """Samples at positions, velocities and accelerations ``(3, N, J)``, nothing measured by so many wrench sensors."""
    still, none = np.zeros_like(states[0]), np.zeros((states.shape[1], 0))
    return Samples(
        stamps=np.arange(states.shape[1], dtype=np.int64),
        position=states[0],
        velocity=states[1],
        acceleration=states[2],
        effort=still,
        base_pose=none,
        base_velocity=none,
        base_acceleration=none,
        wrenches=np.zeros((states.shape[1], sensors, 6)),
    )


class _Rest:
    """Whether a joint stands still."""

    def column(self, motion: JointMotion) -> FloatArray:
        return np.asarray(np.abs(motion.velocity) < STILL, dtype=np.float64)


@dataclass(frozen=True)
class _Direction:
    """The direction of motion, smoothed over a speed [rad/s or m/s]."""

    smoothing: float

    def column(self, motion: JointMotion) -> FloatArray:
        return np.tanh(motion.velocity / self.smoothing)


SIGN = JointColumn(_Direction(0.003))
"""The direction of motion."""
SMOOTH_SIGN = JointColumn(_Direction(0.02))
"""The same, of friction that sets in slowly."""
REST = JointColumn(_Rest())
"""The share of the filter's window in which the joint stands still."""


def moves_one_way(samples: Samples) -> BoolArray:
    """Whether each joint moves one way at an instant ``(N, joints)``: neither at rest nor near a reversal."""
    moving: BoolArray = (np.abs(samples.column(SIGN)) > _SAME_WAY) & (samples.column(REST) < _REST_SHARE)
    return moving


REGIMES = 3
"""How many regimes of a joint's motion there are."""


def regimes(samples: Samples) -> IntArray:
    """The regime of each joint's motion at an instant ``(N, joints)``: 0 if it moves so fast that dry friction has its
    full level, 1 if it moves one way more slowly, 2 at rest and near a reversal."""
    fast = np.abs(samples.column(SMOOTH_SIGN)) > _SAME_WAY
    return np.where(moves_one_way(samples), np.where(fast, 0, 1), REGIMES - 1)
