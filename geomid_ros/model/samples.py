"""Measured motion, efforts and wrenches as arrays of N samples, and regimes of motion for dry friction; effect columns,
which are computed before the filter, then filtered like the efforts.

The joint axis follows :attr:`Robot.joints`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar, Protocol, TypeAlias

import numpy as np

from geomid_ros.model import se3
from geomid_ros.model.effects import JointEffect, JointMotion, Motion, MotionEffect, OnRobot, Place, joints_of
from geomid_ros.types import AnyArray, BoolArray, FloatArray, IntArray


class JointFunction(Protocol):
    """A function of one joint's motion."""

    def column(self, motion: JointMotion) -> FloatArray:
        """Return its values ``(...)``, each instant independently."""


@dataclass(frozen=True)
class JointColumn:
    """A per-joint function of the joint's motion."""

    function: JointFunction
    place: ClassVar[Place] = OnRobot()

    def values(self, motion: Motion) -> FloatArray:
        """Return its values ``(N, J)``."""
        return self.function.column(motion)

    def at_joints(self, motion: Motion) -> FloatArray | Sequence[FloatArray]:
        """Return its values ``(N,)`` at each joint."""
        return self.values(motion).T


@dataclass(frozen=True)
class PlacedColumn:
    """Efforts of an effect that acts on several joints at once."""

    effect: MotionEffect
    place: Place

    def values(self, motion: Motion) -> FloatArray:
        """Return efforts ``(N, J)`` per unit of its coefficient."""
        return self.effect.efforts(motion, self.place)

    def at_joints(self, motion: Motion) -> FloatArray | Sequence[FloatArray]:
        """Return efforts ``(N,)`` at the joints that the effect affects."""
        return self.effect.at_joints(motion, self.place)


Column: TypeAlias = JointColumn | PlacedColumn


def column_of(effect: MotionEffect, place: Place) -> Column:
    """Return the column of an effect at a place."""
    return JointColumn(effect) if isinstance(effect, JointEffect) else PlacedColumn(effect, place)


def affected_joints(place: Place, joints: int) -> tuple[int, ...]:
    """Return the joints whose efforts an effect at a place affects: all for an effect of the whole robot."""
    return tuple(range(joints)) if isinstance(place, OnRobot) else joints_of(place)


@dataclass(frozen=True)
class Entries:
    """Entries of columns ``(joints, K)`` that can be nonzero: those of the joints that each column reaches, column by
    column. With effects of two joints, about half of all entries can be."""

    columns: tuple[Column, ...]
    joints: int

    def __len__(self) -> int:
        return self._count

    def __contains__(self, column: Column) -> bool:
        return column in self._spans

    def of(self, column: Column) -> tuple[slice, tuple[int, ...]]:
        """Return the slice of a column's entries, and the joints that they belong to."""
        return self._spans[column]

    def at(self, column: Column, joint: int) -> int:
        """Return the index of a column's entry at a joint that the column reaches."""
        entries, joints = self._spans[column]
        return int(entries.start) + joints.index(joint)

    def values(self, motion: Motion) -> FloatArray:
        """Compute the values ``(N, entries)`` for a motion of arrays ``(N, joints)``."""
        values = np.empty((len(self), len(motion.position)))
        for column, (entries, _) in self._spans.items():
            values[entries] = column.at_joints(motion)
        return values.T

    @cached_property
    def remembering(self) -> Mapping[type[JointEffect], list[JointEffect]]:
        """Effects whose columns depend on the past motion, by class."""
        by_class: dict[type[JointEffect], list[JointEffect]] = {}
        for function in (column.function for column in self.columns if isinstance(column, JointColumn)):
            if isinstance(function, JointEffect) and function.depends_on_past:
                by_class.setdefault(type(function), []).append(function)
        return by_class

    @cached_property
    def _count(self) -> int:
        return sum(len(joints) for _, joints in self._spans.values())

    @cached_property
    def _spans(self) -> Mapping[Column, tuple[slice, tuple[int, ...]]]:
        spans, begin = dict[Column, tuple[slice, tuple[int, ...]]](), 0
        for column in self.columns:
            joints = affected_joints(column.place, self.joints)
            spans[column] = slice(begin, begin + len(joints)), joints
            begin += len(joints)
        return spans


NO_ENTRIES = Entries((), 0)


def entries_of(effects: Iterable[tuple[MotionEffect, Place, float]], joints: int) -> tuple[Entries, FloatArray]:
    """Return the entries of the columns of ``effects``, given as (effect, place, coefficient), and a matrix ``(entries,
    joints)`` that turns their values into the effects' efforts at all ``joints``."""
    columns = [(column_of(effect, place), place, value) for effect, place, value in effects]
    entries = Entries(tuple(dict.fromkeys(column for column, _, _ in columns)), joints)
    strengths = np.zeros((len(entries), joints))
    for column, place, value in columns:
        for joint in affected_joints(place, joints):
            strengths[entries.at(column, joint), joint] += value
    return entries, strengths


_PAUSE = 1.5  # sampling periods
UNLIMITED_RANGE = np.pi
"""Range to either side of zero for a joint without position limits [rad, m]."""
ACCELERATION_PER_SPEED = 4.0
"""Ratio of acceleration to speed in typical motion [1/s]."""
SAMPLES_PER_PIECE = 50
"""Number of samples per piece, so that their rows and other results need little memory."""
REST_SPEED = 0.01
"""Speed below which friction is not a function of speed [rad/s or m/s]. (The node's ``still_speed`` is another
threshold: below it all samples of a pose carry the same information.)"""
# At a reversal friction depends on the past. In a sample that counts as one-way motion, the joint may be at rest for
# this fraction of the filter's window at most, and must move one way by this much.
_REST_SHARE = 0.3
_SAME_WAY = 0.97


@dataclass(frozen=True, eq=False)
class Samples:
    """Aligned, filtered and differentiated measurements at N common times. Arrays are read-only.

    ``stamps (N,)`` ns; ``position, velocity, acceleration, effort (N, joints)`` in rad, m, N m, N (SI), NaN where an
    effort is not measured; ``base_pose (N, 7)`` position and quaternion xyzw of the base in the world;
    ``base_velocity, base_acceleration (N, 6)`` its spatial velocity and that velocity's derivative in the base frame
    (linear, angular). Base arrays have 0 columns for a fixed base. ``wrenches (N, sensors, 6)`` force and torque.
    ``effects (N, entries)``: values of the ``entries`` of effect columns, computed before the filter and filtered like
    the efforts. A column that is not among them is computed from the motion here, which is right if that is exact.
    ``standing (N, feet)``: True where a foot may touch the ground; no columns: no foot does.
    ``commands (N, 4, joints)``: set-points of position and velocity, feed-forward, and the efforts that messages
    report, where efforts are computed from commands; else it has 0 joints.
    ``acceleration_noise (N, joints)``: values with the variance of the accelerations' noise; no columns: not known.
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
    standing: BoolArray = None  # type: ignore[assignment]  # likewise
    commands: FloatArray = None  # type: ignore[assignment]  # likewise
    acceleration_noise: FloatArray = None  # type: ignore[assignment]  # likewise

    def __post_init__(self) -> None:
        nothing = np.zeros((len(self.position), 0))
        defaults = {"effects": nothing, "standing": nothing > 0.0, "commands": np.zeros((len(nothing), 4, 0))}
        defaults["acceleration_noise"] = nothing
        for name, default in defaults.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, default)
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
        """Arrays by name."""
        return {name: values for name, values in vars(self).items() if name != "entries"}

    @property
    def seconds(self) -> FloatArray:
        """Time since the first sample ``(N,)`` [s]."""
        return np.asarray((self.stamps - self.stamps[0]) * 1e-9)

    @property
    def states(self) -> FloatArray:
        """State of the motion ``(N, S)``: that of the joints, and of a base except its position and heading."""
        states = [self.position, self.velocity, self.acceleration]
        if self.base_pose.shape[1]:
            up = se3.rotate_inverse(self.base_pose[:, 3:], np.array([0.0, 0.0, 1.0]))
            states += [up, self.base_velocity, self.base_acceleration]
        return np.concatenate(states, axis=1)

    @property
    def motion(self) -> Motion:
        """Motion of the joints."""
        return Motion(np.array([self.position, self.velocity, self.acceleration]))

    def efforts_of(self, effects: Iterable[tuple[MotionEffect, Place, float]]) -> FloatArray:
        """Compute joint efforts ``(N, J)`` due to motion effects, each given as (effect, place, coefficient)."""
        entries, strengths = entries_of(effects, self.position.shape[1])
        return np.asarray(self.values_of(entries) @ strengths)

    def values_of(self, entries: Entries) -> FloatArray:
        """Return the values ``(N, len(entries))`` of column entries."""
        if entries.columns == self.entries.columns:
            return self.effects
        values = np.empty((len(self), len(entries)))
        for column in entries.columns:
            span, joints = entries.of(column)
            values[:, span] = self.column(column)[:, joints]
        return values

    def column(self, column: Column) -> FloatArray:
        """Return the values ``(N, joints)`` of an effect column."""
        if column not in self.entries:
            return column.values(self.motion)
        span, joints = self.entries.of(column)
        if len(joints) == self.position.shape[1]:
            return np.asarray(self.effects[:, span])
        values = np.zeros(self.position.shape)
        values[:, joints] = self.effects[:, span]
        return values

    def select(self, index: AnyArray | slice) -> Samples:
        """Return the samples chosen by a mask, index array or slice."""
        return self._with({name: array[index] for name, array in self.arrays.items()})

    def _with(self, arrays: dict[str, AnyArray], **others: Entries) -> Samples:
        """Return a copy with other arrays, without the constructor, which takes longer than work on a few samples."""
        for array in arrays.values():
            array.setflags(write=False)
        copy = object.__new__(Samples)
        vars(copy).update(vars(self) | arrays | others)
        return copy

    def in_pieces(self) -> Iterator[Samples]:
        """Yield pieces of at most :data:`SAMPLES_PER_PIECE` samples, to limit memory; at least one, perhaps empty."""
        for begin in range(0, max(len(self), 1), SAMPLES_PER_PIECE):
            yield self.select(slice(begin, begin + SAMPLES_PER_PIECE))

    def with_columns(self, chosen: Collection[Column]) -> Samples:
        """Return the samples with only the ``chosen`` effect columns."""
        columns = tuple(column for column in self.entries.columns if column in chosen)
        entries = Entries(columns, self.entries.joints)
        return self._with({"effects": self.values_of(entries)}, entries=entries)

    def with_joints(self, order: IntArray) -> Samples:
        """Return samples in which joint j has the data of joint ``order[j]``; ``order (joints,)``. They lack columns of
        effects that act on several joints."""
        own = tuple(column for column in self.entries.columns if isinstance(column, JointColumn))
        entries = Entries(own, self.entries.joints)
        effects = [self.effects[:, self.entries.of(column)[0]][:, order] for column in entries.columns]
        of_joints = ("position", "velocity", "acceleration", "effort", "acceleration_noise")
        arrays: dict[str, Any] = {name: self.arrays[name][:, order] for name in of_joints if self.arrays[name].shape[1]}
        return replace(self, **arrays, effects=np.concatenate([self.effects[:, :0], *effects], axis=1), entries=entries)

    def segments(self) -> list[Samples]:
        """Split into parts at pauses: steps longer than 1.5 times the median step."""
        steps = np.diff(self.stamps)
        ends = np.flatnonzero(steps > _PAUSE * np.median(steps)) + 1 if len(steps) else steps
        return [self.select(slice(begin, end)) for begin, end in pairwise([0, *ends.tolist(), len(self)])]

    @staticmethod
    def concatenate(parts: list[Samples]) -> Samples:
        """Join ``parts`` (at least one) in order."""
        if len(parts) == 1:
            return parts[0]
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in parts[0].arrays
        }
        return replace(parts[0], **arrays)


def random_states(
    random: np.random.Generator, count: int, limits: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Draw random positions, velocities and accelerations ``(3, count, J)``: positions within ``limits (J, 2)`` and
    +-:data:`UNLIMITED_RANGE`, the others up to ``velocity (J,)`` and ``acceleration (J,)`` in either direction."""
    lower, upper = np.clip(limits, -UNLIMITED_RANGE, UNLIMITED_RANGE).T
    position = random.uniform(lower, upper, (count, len(lower)))
    return np.array([position, *(random.uniform(-1.0, 1.0, (2, *position.shape)) * [[velocity], [acceleration]])])


def samples_of(states: FloatArray, sensors: int = 0) -> Samples:
    """Return samples of positions, velocities and accelerations ``(3, N, J)``, with zero efforts and wrenches."""
    zeros, no_base = np.zeros_like(states[0]), np.zeros((states.shape[1], 0))
    return Samples(
        stamps=np.arange(states.shape[1], dtype=np.int64),
        position=states[0],
        velocity=states[1],
        acceleration=states[2],
        effort=zeros,
        base_pose=no_base,
        base_velocity=no_base,
        base_acceleration=no_base,
        wrenches=np.zeros((states.shape[1], sensors, 6)),
    )


class _Rest:
    """1 where a joint is at rest (speed below :data:`REST_SPEED`), else 0."""

    def column(self, motion: JointMotion) -> FloatArray:
        return np.asarray(np.abs(motion.velocity) < REST_SPEED, dtype=np.float64)


@dataclass(frozen=True)
class _Direction:
    """Direction of motion, smoothed over a speed [rad/s or m/s]."""

    smoothing: float

    def column(self, motion: JointMotion) -> FloatArray:
        return np.tanh(motion.velocity / self.smoothing)


SIGN = JointColumn(_Direction(0.003))
"""Direction of motion, -1 to 1."""
SMOOTH_SIGN = JointColumn(_Direction(0.02))
"""Direction of motion, smoothed for friction that sets in slowly."""
REST = JointColumn(_Rest())
"""Fraction of the filter's window in which the joint is at rest."""


def moves_one_way(samples: Samples) -> BoolArray:
    """True where a joint moves one way ``(N, joints)``: neither at rest nor near a reversal."""
    moving: BoolArray = (np.abs(samples.column(SIGN)) > _SAME_WAY) & (samples.column(REST) < _REST_SHARE)
    return moving


REGIMES = 3
"""Number of regimes of a joint's motion."""


def regimes(samples: Samples) -> IntArray:
    """Return the regime of each joint's motion ``(N, joints)``: 0 if fast enough that dry friction has its full level,
    1 if it moves one way more slowly, 2 at rest or near a reversal."""
    fast = np.abs(samples.column(SMOOTH_SIGN)) > _SAME_WAY
    return np.where(moves_one_way(samples), np.where(fast, 0, 1), REGIMES - 1)
