"""Interface of physical effects. A subclass in a file of this folder defines everything about one effect.

Results, reports, files, the search for missing effects and the simulation of results query the class; no other file
knows its name. Every member has a default, so an effect defines only what is special about it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self, TypeAlias

import numpy as np

from geomid_ros.model.effects.parameters import ByEffect, Found, ParameterForm, Quantities, Quantity, Values, quantities
from geomid_ros.model.effects.situation import JointMotion, Motion, Place, PlaceKind, Situation, joint_of, joints_of
from geomid_ros.types import FloatArray

FRICTION_DRIFT = 0.2
"""Relative change of friction between motions, due to heat, grease and rest: the difference between halves of
recordings of ten robots, in addition to the standard deviations of each half (``benchmarks.exchanged``)."""


@dataclass(frozen=True)
class Hinge:
    """A second hinge (or slide) on the link side of a joint, for an elastic gear or backlash, as MJCF attributes.

    ``stiffness`` [N m/rad], 0 for none; ``damping`` [N m s/rad]; ``half_range`` [rad], 0 for no ends.
    """

    name: str
    stiffness: float = 0.0
    damping: float = 0.0
    half_range: float = 0.0


class Effect(ABC):
    """A physical effect; instances differ in the constants that enter nonlinearly.

    Texts and tables:

    Attributes:
        name: name in files and on the command line.
        label: name in sentences and tables.
        meaning: its equation, in terms of its ``parameters``, of a joint's position q, velocity v and acceleration a,
            and of the effort tau that the joint's gear transmits to the link.
        parameters: names, units and ranges of its parameters: those of the coefficients, then those of the constants.
        settled_by: recording that distinguishes it from rival effects.
        place: kind of place where it acts.
        stated_parameter_count: number of parameters that a sentence states; None for all.
    """

    name: ClassVar[str]
    label: ClassVar[str]
    meaning: ClassVar[str]
    parameters: ClassVar[tuple[ParameterForm, ...]]
    settled_by: ClassVar[str]
    place: ClassVar[PlaceKind] = "joint"
    stated_parameter_count: ClassVar[int | None] = None

    def __eq__(self, other: object) -> bool:
        """True for the same effect with the same constants."""
        return type(self) is type(other) and vars(self) == vars(other)

    def __hash__(self) -> int:
        return hash((self.name, *vars(self).values()))

    # Relations to other effects.
    contains: ClassVar[str] = ""
    """Effect that is a special case of it; the simpler one is preferred unless the data require the richer one."""
    confusable_with_payload: ClassVar[bool] = False
    """True if a payload may be identified instead of it, because their columns are similar."""
    relinearise_beyond: ClassVar[tuple[float, ...]] = ()
    """Changes of its coefficients beyond which all effects' columns must be recomputed; empty if never."""
    before_gear: ClassVar[bool] = False
    """True if it acts on the motor side of the gear only, so a sensor on the link side does not measure it."""
    is_dry_friction: ClassVar[bool] = False
    """True if its coefficient counts in full in the dry friction at very low speed."""
    levels_off: ClassVar[bool] = False
    """True if it is friction that tends to a constant level as speed grows."""
    turns_gravity: ClassVar[bool] = False
    """True if it rotates gravity, which affects wrench sensors too."""
    adds_up: ClassVar[bool] = True
    """True if two at one place equal one with the sums of their parameters; else the second replaces the first. Must be
    False for an effect with a constant to choose."""

    load_error: ClassVar[float] = 0.0
    """Standard deviation of its coefficients due to errors of the links' effort, as a fraction of its channel's
    measurements. Blocks of one recording do not show it."""

    # Fitting.
    count: ClassVar[int] = 1
    """Number of coefficients of its columns, without those of its other :attr:`parts`."""
    constant: ClassVar[str] = ""
    """Parameter that enters nonlinearly: the field in which the instances of :meth:`grid` differ."""
    default_constant: ClassVar[str] = ""
    """Another such field and parameter, which files leave out if it has the class's default."""
    compensated_in_samples: ClassVar[bool] = False
    """True if its estimate is built into the model (gravity, time, scale); its column is then for the change only."""
    largest: ClassVar[float] = np.inf
    """Largest plausible absolute coefficient of a robot that works."""
    is_sensor_error: ClassVar[bool] = False
    """True if it is a measurement error without effect on the motion, so robot files need not contain it."""
    prior_std_fraction: ClassVar[float | None] = None
    """Prior standard deviation about zero, as a fraction of its channel's measurements; None if its prior comes from a
    first fit."""
    default_prior_std: ClassVar[tuple[float, ...]] = ()
    """Default prior standard deviations of its coefficients, the same for any robot; empty if they scale with the
    measurements."""
    depends_on_past: ClassVar[bool] = False
    """True if it depends on the past motion too, as friction at rest does."""
    scales_measurement: ClassVar[bool] = False
    """True if it acts on the measurement, after all other effects."""
    has_columns: ClassVar[bool] = True
    """True if coefficients of it can be fitted to rows; else it is found in another way."""
    absent_value: ClassVar[float] = 0.0
    """Value of its sizes when the effect is absent."""
    drift: ClassVar[float] = 0.0
    """Relative standard deviation of its coefficients between motions. The robot itself changes; the scatter within one
    motion does not show it."""

    @classmethod
    def grid(cls) -> tuple[Effect, ...]:
        """Return the instances to choose from if its constants are unknown, in the order of its constant."""
        return (cls(),)

    @classmethod
    def is_one_number(cls) -> bool:
        """True if one coefficient describes it completely, given default constants."""
        return len(cls.parameters) == (2 if cls.default_constant else 1)

    @classmethod
    def coarse_grid(cls) -> tuple[Effect, ...]:
        """Return the few instances that an identification tries in addition to the default effects."""
        return (cls(),)

    @property
    def grid_value(self) -> float:
        """Value of the constant in which the instances of :meth:`grid` differ, above zero; 0 if it has none."""
        return float(getattr(self, self.constant)) if self.constant else 0.0

    @property
    def positives(self) -> int:
        """Number of its coefficients, the first ones, that cannot be negative: 1 if its parameter must be above zero.
        With inertias, such a coefficient is on P(1) (the metric is dc^2/c^2); the others are on real lines."""
        return int(self.parameters[0].above == 0.0)

    @property
    def column_positives(self) -> int:
        """Number of coefficients of its own columns that cannot be negative when identified with the inertias."""
        return self.positives

    @property
    def parts(self) -> tuple[Effect, ...]:
        """Effects of one coefficient that it is composed of, in the order of its coefficients."""
        return (self,)

    @property
    def column_parameters(self) -> tuple[ParameterForm, ...]:
        """Parameters of the coefficients of its own columns; its other parts define theirs."""
        first = self.parts.index(self)
        return self.parameters[first : first + self.count]

    def sizes(self, parameters: Mapping[str, Quantity]) -> dict[str, Quantity]:
        """Return those of its ``parameters`` that measure its size: all but constants; for a body, all."""
        count = sum(part.count for part in self.parts)
        constants = {form.name for form in self.parameters[count:]} if count else set[str]()
        return {name: quantity for name, quantity in parameters.items() if name not in constants}

    @classmethod
    def between_motions(cls, size: Quantity) -> Quantity:
        """Return a ``size`` whose std includes the drift between motions."""
        return replace(size, std=float(np.hypot(size.std, cls.drift * size.value)))

    @classmethod
    def within_motion(cls, size: Quantity) -> float:
        """Return the std of a ``size`` within one motion, without the drift between motions if its std includes it."""
        squared = size.std**2 - (cls.drift * size.value) ** 2
        return float(np.sqrt(squared)) if squared >= 0.0 else size.std

    def is_out_of_range(self, coefficients: FloatArray) -> bool:
        """True if the ``coefficients (k,)`` are out of range for a robot that works, whatever their signs."""
        return bool(np.any(np.abs(coefficients) > self.largest))

    @property
    def needs(self) -> tuple[Effect, ...]:
        """Effects at its place without which it does not act."""
        return ()

    def is_supported(self, effects_at_place: Mapping[Effect, float]) -> bool:  # noqa: ARG002
        """True if all effects at its place, given with coefficients, together show the behaviour it stands for."""
        return True

    def linearised_at(self, coefficients: FloatArray) -> FloatArray:
        """Return the nearest coefficients ``(k,)`` at which columns may be computed."""
        return coefficients

    # Coefficients to parameters and back.

    def transformed(self, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the first parameters ``(p,)`` and their derivatives ``(p, k)`` by the ``coefficients (k,)``."""
        return coefficients, np.eye(len(coefficients))

    def values(self, coefficients: FloatArray) -> dict[str, float]:
        """Return the first parameters by name, from the ``coefficients (k,)``."""
        parameters = self.transformed(coefficients)[0]
        return {form.name: float(value) for form, value in zip(self.parameters, parameters, strict=False)}

    def quantities(
        self,
        coefficients: FloatArray,
        covariance: FloatArray,
        *,
        sliding: bool = False,
        log_std: float = 0.0,
        usual_load: float = 0.0,
    ) -> dict[str, Quantity]:
        """Return its parameters by name.

        Args:
            coefficients: fitted coefficients ``(k,)``, with their ``covariance (k, k)``.
            sliding: True if its joint is prismatic.
            log_std: standard deviation of the logarithm of the chosen constant.
            usual_load: standard deviation of the joint's gear load [N m or N].

        If a coefficient is zero, its parameter may be infinite or NaN: a spring without stiffness has no equilibrium.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            values, jacobian = self.transformed(coefficients)
            stds = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian), 0.0))
        first = [(float(value), float(std)) for value, std in zip(values, stds, strict=True)]
        return quantities(self.parameters, [*first, *self.constants(first, log_std, usual_load)], sliding=sliding)

    def constants(self, found: Sequence[Found], log_std: float, usual_load: float) -> list[Found]:  # noqa: ARG002
        """Return values and stds of the parameters that are constants, given those of the first parameters."""
        constants = [(self.grid_value, log_std * self.grid_value)] if self.constant else []
        name = self.default_constant
        if name and getattr(self, name) != getattr(type(self), name):
            constants.append((float(getattr(self, name)), 0.0))
        return constants

    @classmethod
    def from_values(cls, values: Values, usual_load: float = 0.0) -> Self:  # noqa: ARG003
        """Return the instance with the constants in ``values``."""
        given = {cls.constant: values[cls.constant]} if cls.constant else {}
        if values.get(cls.default_constant):
            given[cls.default_constant] = values[cls.default_constant]
        return cls(**given)

    @classmethod
    def coefficients(cls, values: Values, usual_load: float = 0.0) -> dict[Effect, tuple[float, ...]]:
        """Convert parameters to coefficients, by the :attr:`parts` that they belong to."""
        instance = cls.from_values(values, usual_load)
        return {instance: tuple(values[form.name] for form in instance.column_parameters)}

    @classmethod
    def updated(cls, known: Quantities, found: ByEffect) -> tuple[Quantities, ByEffect]:
        """Update its parameters with the estimates at its place.

        Args:
            known: its previous parameters.
            found: parameters of the estimated effects, by the effects' names.

        Returns:
            its parameters, and the entries of ``found`` that remain for other effects.
        """
        if cls.name not in found or cls.corrected_in_samples:
            return known, found
        updated = {
            form.name: found[cls.name][form.name] for form in cls().column_parameters if form.name in found[cls.name]
        }
        return {**known, **updated}, {name: other for name, other in found.items() if name != cls.name}

    @classmethod
    def combined(cls, first: Quantities, second: Quantities) -> Quantities:
        """Combine the parameters of two at one place into one; ``second`` was found in addition to ``first``."""
        if not cls.adds_up:
            return second
        added = second.keys() & first.keys() - {cls.default_constant}
        return {**first, **{name: first[name].plus(q) if name in added else q for name, q in second.items()}}

    # Action on the world and on sensors; the defaults do nothing.

    corrected_in_samples: ClassVar[bool] = False
    """True if samples are corrected for it where it is known, by the hooks below."""

    @classmethod
    def tilted_gravity(cls, gravity: FloatArray, values: Values) -> FloatArray:  # noqa: ARG003
        """Return gravity ``(3,)`` in the base frame, given that of a level base."""
        return gravity

    @classmethod
    def effort_scale(cls, values: Values) -> float:  # noqa: ARG003
        """Return the factor from true to measured efforts at its joint."""
        return 1.0

    @classmethod
    def load_scale(cls, values: Values) -> float:  # noqa: ARG003
        """Return the factor of the links' effort in the measured one at its joint."""
        return 1.0

    @classmethod
    def effort_shift(cls, values: Values) -> float:  # noqa: ARG003
        """Return the offset of measured efforts at its joint from the scaled true ones [N m or N]."""
        return 0.0

    @classmethod
    def effort_lag(cls, values: Values) -> float:  # noqa: ARG003
        """Return the delay of effort measurements after the motion [s]."""
        return 0.0

    @classmethod
    def wrench_shift(cls, values: Values) -> dict[str, float]:  # noqa: ARG003
        """Return the offset of its wrench sensor from the true wrench, by axis [N, N m]."""
        return {}

    # Friction by motion and load, in addition to that in URDF and MJCF.

    @classmethod
    def dry_friction(cls, coefficient: float, load: FloatArray) -> FloatArray:  # noqa: ARG003
        """Return the size ``(N,)`` of friction of unknown sign near standstill, under the gear's ``load (N,)``."""
        return np.zeros(load.shape)

    @classmethod
    def friction_by_load(cls, values: Values) -> float:  # noqa: ARG003
        """Return the friction per unit of gear load."""
        return 0.0

    @classmethod
    def holding_friction(cls, values: Values) -> float:  # noqa: ARG003
        """Return the friction that holds a joint at rest, in addition to that in the MJCF [N m or N]."""
        return 0.0

    def efforts_not_in_mjcf(self, values: Values, motion: Motion, place: Place) -> FloatArray | float:  # noqa: ARG002
        """Return efforts ``(..., J)`` of a moving robot that the MJCF does not contain."""
        return 0.0

    @classmethod
    def hinge(cls, values: Values, carried: float) -> Hinge | None:  # noqa: ARG003
        """Return the additional hinge that the MJCF needs; ``carried``: inertia distal to the joint [kg m^2, kg]."""
        return None


class MotionEffect(Effect):
    """An effect of one coefficient that adds ``coefficient * efforts(motion)`` to the joints' efforts.

    It can be identified with the inertias. Its column is computed before the filter, then filtered like the efforts.
    """

    @abstractmethod
    def at_joints(self, motion: Motion, place: Place) -> FloatArray | Sequence[FloatArray]:
        """Return the efforts ``(...)`` of the joints that it affects per unit of the coefficient, each instant
        independently."""

    def efforts(self, motion: Motion, place: Place) -> FloatArray:
        """Return the efforts ``(..., J)`` of all joints per unit of the coefficient."""
        efforts = np.zeros(motion.position.shape)
        for joint, effort in zip(joints_of(place), self.at_joints(motion, place), strict=True):
            efforts[..., joint] = effort
        return efforts

    def efforts_not_in_mjcf(self, values: Values, motion: Motion, place: Place) -> FloatArray | float:
        """Return all of its efforts, unless the MJCF contains the effect or it is not an effort, but a sensor error."""
        if self.is_sensor_error or any(form.mjcf for form in self.parameters):
            return 0.0
        return values[self.column_parameters[0].name] * self.efforts(motion, place)


class JointEffect(MotionEffect):
    """Function of one joint's motion, with one coefficient per joint."""

    @abstractmethod
    def column(self, motion: JointMotion) -> FloatArray:
        """Return the joint's effort ``(...)`` per unit of the coefficient, each instant independently."""

    @classmethod
    def states(cls, effects: Sequence[Self], moved: FloatArray, before: FloatArray) -> FloatArray:  # noqa: ARG003
        """Return the states ``(N, n, J)`` of n ``effects`` of this class after each of the position steps ``moved (N,
        J)``, from their states ``before (n, J)``."""
        return np.zeros((len(moved), *before.shape))

    def at_joints(self, motion: Motion, place: Place) -> FloatArray | Sequence[FloatArray]:
        return (self.column(motion.joints[joint_of(place)]),)


class PairEffect(MotionEffect):
    """Function of two joints' motion, with one coefficient per pair."""

    place = "joints"

    @abstractmethod
    def columns(self, first: JointMotion, second: JointMotion) -> tuple[FloatArray, FloatArray]:
        """Return efforts ``(...)`` of the two joints per unit of the coefficient, each instant independently."""

    def at_joints(self, motion: Motion, place: Place) -> FloatArray | Sequence[FloatArray]:
        first, second = joints_of(place)
        return self.columns(motion.joints[first], motion.joints[second])


class RobotEffect(MotionEffect):
    """Function of all joints' motion, with one coefficient for the robot."""

    place: ClassVar[PlaceKind] = "robot"

    @abstractmethod
    def efforts(self, motion: Motion, place: Place) -> FloatArray:
        """Return the efforts ``(..., J)`` of all joints per unit of the coefficient, each instant independently."""

    def at_joints(self, motion: Motion, place: Place) -> FloatArray | Sequence[FloatArray]:
        return np.moveaxis(self.efforts(motion, place), -1, 0)


class SensorEffect(Effect):
    """An effect of a wrench sensor: adds ``columns(motion, axes) . coefficients`` to the sensor's reading.

    It has one parameter per axis, named after it, fx to tz: the axis's coefficient.
    """

    place: ClassVar[PlaceKind] = "sensor"
    count = 6
    is_sensor_error = True

    def columns(self, motion: Motion, axes: Sequence[str]) -> FloatArray:
        """Return wrenches ``(..., axes, coefficients)`` in the sensor's frame per unit of each axis's coefficient:
        those of an offset, unless a class has others."""
        return np.broadcast_to(np.eye(len(axes)), (*motion.position.shape[:-1], len(axes), len(axes)))


class SituationEffect(Effect):
    """An effect that depends on the model's state: adds ``columns(situation, place) . coefficients`` to the channels,
    to first order in the coefficients."""

    @abstractmethod
    def columns(self, situation: Situation, place: Place) -> FloatArray:
        """Return the change of the channels per unit of each coefficient, ``(N, C, k)``."""


class LoadEffect(SituationEffect):
    """Function of one joint's direction of motion and of its gear load, with one coefficient per joint.

    It can be identified with the inertias. Its column then uses the gear load known beforehand: that of the URDF's
    rigid bodies, or of a given model.
    """

    @abstractmethod
    def column(self, load: FloatArray, sign: FloatArray) -> FloatArray:
        """Return the joint's effort ``(...)`` per unit of the coefficient, from the gear's ``load`` and the ``sign`` of
        motion."""

    def columns(self, situation: Situation, place: Place) -> FloatArray:
        """Return the columns ``(N, C, 1)``, nonzero at the one joint."""
        joint = joint_of(place)
        return situation.column_of(joint, self.column(situation.transmitted[:, joint], situation.sign[:, joint]))


class GravityEffect(SituationEffect):
    """A change of gravity in the base frame.

    It can be identified with the inertias. Its columns then use the bodies known beforehand, as those of
    :class:`LoadEffect` do.
    """

    @abstractmethod
    def slopes(self, gravity: FloatArray, coefficients: FloatArray) -> FloatArray:
        """Return the derivative ``(3, k)`` of gravity in the base frame by the ``coefficients (k,)``, from ``gravity
        (3,)`` in the frame of a level base."""

    def columns(self, situation: Situation, place: Place) -> FloatArray:
        coefficients = situation.coefficients.get((self.name, place), np.zeros(self.count))
        return np.asarray(situation.by_gravity @ self.slopes(situation.gravity, coefficients))


IdentifiedEffect: TypeAlias = MotionEffect | SensorEffect | LoadEffect | GravityEffect
"""Effects that a measurement model may contain: linear in coefficients, with columns independent of the estimate."""
