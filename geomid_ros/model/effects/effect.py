"""The contract of physical effects. A subclass in a file of this folder holds all that is known of one effect.

Results, reports, files, the search for missing effects and the simulation of what was found ask the effect; no other
file knows its name. Everything has a default, so that an effect says only what is peculiar to it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self, TypeAlias

import numpy as np

from geomid_ros.model.effects.parameters import ByEffect, Found, ParameterForm, Quantities, Quantity, Values, quantities
from geomid_ros.model.effects.situation import JointMotion, Motion, Place, PlaceKind, Situation, joint_of, joints_of
from geomid_ros.types import FloatArray

FRICTION_DRIFT = 0.2
"""Friction changes with heat, grease and rest: so far apart do halves of recordings of ten robots find it, beside what
each half says of itself (``benchmarks.exchanged``)."""


@dataclass(frozen=True)
class Hinge:
    """A second hinge (or slide) behind a joint's own, for a gear that gives, as MJCF attributes.

    ``stiffness`` [N m/rad], 0 for none; ``damping`` [N m s/rad]; ``half_range`` [rad], 0 for no ends.
    """

    name: str
    stiffness: float = 0.0
    damping: float = 0.0
    half_range: float = 0.0


class Effect(ABC):
    """A physical effect; instances differ in the constants that enter nonlinearly.

    What it says of itself, within a sentence:

    Attributes:
        name: in files and on the command line.
        label: what it is called.
        meaning: its equation, in terms of its ``parameters``, of a joint's position q, velocity v and acceleration a,
            and of the effort tau that its gear transmits to the link.
        parameters: their names, units and ranges. The coefficients' come first, then those of the constants.
        settled_by: the recording that tells it from its rivals.
        place: where it acts.
        said_first: how many of its parameters a sentence says; None for all.
    """

    name: ClassVar[str]
    label: ClassVar[str]
    meaning: ClassVar[str]
    parameters: ClassVar[tuple[ParameterForm, ...]]
    settled_by: ClassVar[str]
    place: ClassVar[PlaceKind] = "joint"
    said_first: ClassVar[int | None] = None

    def __eq__(self, other: object) -> bool:
        """Whether it is the same effect with the same constants."""
        return type(self) is type(other) and vars(self) == vars(other)

    def __hash__(self) -> int:
        return hash((self.name, *vars(self).values()))

    # How it stands to other effects.
    contains: ClassVar[str] = ""
    """The effect that is a special case of it: of the two the simpler is right unless the richer one is needed."""
    like_a_payload: ClassVar[bool] = False
    """Whether a payload may be found in its place."""
    far: ClassVar[tuple[float, ...]] = ()
    """Changes of its coefficients after which the columns of all effects are others; empty if none does that."""
    before_gear: ClassVar[bool] = False
    """Whether it acts on the motor's side alone, so that a sensor behind the gear does not feel it."""
    is_dry_friction: ClassVar[bool] = False
    """Whether its coefficient counts in full in the dry friction just beside standstill."""
    levels_off: ClassVar[bool] = False
    """Whether it is friction that ends at a level as speed grows."""
    turns_gravity: ClassVar[bool] = False
    """Whether it turns gravity, which wrench sensors feel, too."""
    adds_up: ClassVar[bool] = True
    """Whether two at one place are one with the sums of their parameters; else the second takes the first's place. An
    effect with a constant to choose does not."""

    # How it is fitted.
    count: ClassVar[int] = 1
    """How many coefficients its own columns have."""
    constant: ClassVar[str] = ""
    """The parameter that enters nonlinearly, a field of the instances, in which the :meth:`variants` differ."""
    usual_constant: ClassVar[str] = ""
    """Another field and parameter of this kind, which files leave out where it is as usual, the class's own."""
    absorbed: ClassVar[bool] = False
    """Whether what was found of it is built into the model (gravity, time, scale), and only its change is a column."""
    largest: ClassVar[float] = np.inf
    """The largest coefficient, its sign apart, of a robot that works."""
    of_sensor: ClassVar[bool] = False
    """Whether it is an error of what is measured, which moves nothing: no file of a robot has to hold it."""
    expected_share: ClassVar[float | None] = None
    """Its prior standard deviation about zero, as a share of what its channel measures; None where its prior is a first
    fit."""
    usual: ClassVar[tuple[float, ...]] = ()
    """Prior standard deviations of its own coefficients, which any robot may have; empty where these go with what is
    measured."""
    remembers: ClassVar[bool] = False
    """Whether it depends on the motion before, too, as friction at rest does."""
    scales_measurement: ClassVar[bool] = False
    """Whether it acts on what is measured after everything else."""
    drift: ClassVar[float] = 0.0
    """Standard deviation of its coefficients from one motion to the next, as a share of each: the robot's own change,
    of which no scatter within one motion tells."""

    @classmethod
    def variants(cls) -> tuple[Effect, ...]:
        """The instances to choose from when its constants are unknown, in the order of its constant."""
        return (cls(),)

    @classmethod
    def is_one_number(cls) -> bool:
        """Whether its coefficient says all of it, if its other constants are as usual."""
        return len(cls.parameters) == (2 if cls.usual_constant else 1)

    @classmethod
    def trials(cls) -> tuple[Effect, ...]:
        """The few instances that an identification tries beside the default effects."""
        return (cls(),)

    @property
    def scanned(self) -> float:
        """What variants differ in, which must be above zero; 0 if there is nothing to choose."""
        return float(getattr(self, self.constant)) if self.constant else 0.0

    @property
    def positives(self) -> int:
        """How many of its coefficients, the first ones, cannot be negative."""
        return 0

    @property
    def own_positives(self) -> int:
        """How many of those of its own columns cannot, where they are identified along with the inertias."""
        return self.positives

    @property
    def parts(self) -> tuple[Effect, ...]:
        """The effects of one coefficient that it is made of, in the order of its coefficients."""
        return (self,)

    @property
    def own(self) -> tuple[ParameterForm, ...]:
        """The parameters that its own coefficients are; those of its other parts are said by these."""
        first = self.parts.index(self)
        return self.parameters[first : first + self.count]

    @property
    def nothing(self) -> float:
        """The value of its sizes that says that there is none."""
        return 1.0 if self.scales_measurement else 0.0

    def sizes(self, parameters: Mapping[str, Quantity]) -> dict[str, Quantity]:
        """Those of its ``parameters`` that say how large it is: no constants; all of a body."""
        count = sum(part.count for part in self.parts)
        constants = {form.name for form in self.parameters[count:]} if count else set[str]()
        return {name: quantity for name, quantity in parameters.items() if name not in constants}

    @classmethod
    def within_motion(cls, size: Quantity) -> float:
        """The standard deviation of one motion, of a size whose own includes the drift to others, unless it is less."""
        squared = size.std**2 - (cls.drift * size.value) ** 2
        return float(np.sqrt(squared)) if squared >= 0.0 else size.std

    def is_absurd(self, coefficients: FloatArray) -> bool:
        """Whether no robot that works has it with these ``coefficients (k,)``, signs apart."""
        return bool(np.any(np.abs(coefficients) > self.largest))

    def is_borne_out(self, beside: Mapping[Effect, float]) -> bool:  # noqa: ARG002
        """Whether the effects at its place, it among them, with their coefficients, together do what it stands for."""
        return True

    def linearised_at(self, coefficients: FloatArray) -> FloatArray:
        """The ``coefficients (k,)`` at which columns may be computed."""
        return coefficients

    # From coefficients to parameters and back.

    def transformed(self, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The first parameters ``(p,)`` and their derivatives by the ``coefficients (k,)``, ``(p, k)``."""
        return coefficients, np.eye(len(coefficients))

    def values(self, coefficients: FloatArray) -> dict[str, float]:
        """The first parameters by name, from the ``coefficients (k,)``."""
        found = self.transformed(coefficients)[0]
        return {form.name: float(value) for form, value in zip(self.parameters, found, strict=False)}

    def quantities(
        self,
        coefficients: FloatArray,
        covariance: FloatArray,
        *,
        sliding: bool = False,
        unsure: float = 0.0,
        usual_load: float = 0.0,
    ) -> dict[str, Quantity]:
        """Its parameters by name.

        Args:
            coefficients: as they were fitted ``(k,)``, with their ``covariance (k, k)``.
            sliding: whether its joint is prismatic.
            unsure: standard deviation of the logarithm of the scanned constant.
            usual_load: standard deviation of what the joint's gear transmits [N m or N].

        Where a coefficient is zero, its parameter may be infinite or not a number: a spring of no stiffness rests
        nowhere.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            values, jacobian = self.transformed(coefficients)
            stds = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian), 0.0))
        found = [(float(value), float(std)) for value, std in zip(values, stds, strict=True)]
        return quantities(self.parameters, [*found, *self.constants(found, unsure, usual_load)], sliding=sliding)

    def constants(self, found: Sequence[Found], unsure: float, usual_load: float) -> list[Found]:  # noqa: ARG002
        """Values and standard deviations of the parameters that are constants, from those ``found`` before."""
        constants = [(self.scanned, unsure * self.scanned)] if self.constant else []
        name = self.usual_constant
        if name and getattr(self, name) != getattr(type(self), name):
            constants.append((float(getattr(self, name)), 0.0))
        return constants

    @classmethod
    def from_values(cls, values: Values, usual_load: float = 0.0) -> Self:  # noqa: ARG003
        """The instance with the constants of these parameters."""
        given = {cls.constant: values[cls.constant]} if cls.constant else {}
        if values.get(cls.usual_constant):
            given[cls.usual_constant] = values[cls.usual_constant]
        return cls(**given)

    @classmethod
    def coefficients(cls, values: Values, usual_load: float = 0.0) -> dict[Effect, tuple[float, ...]]:
        """What parameters say of the coefficients, by the parts (:attr:`parts`) that these belong to."""
        own = cls.from_values(values, usual_load)
        return {own: tuple(values[form.name] for form in own.own)}

    @classmethod
    def refined(cls, known: Quantities, found: ByEffect) -> tuple[Quantities, ByEffect]:
        """Its parameters brought up to date by what was estimated at its place.

        Args:
            known: its parameters before.
            found: the parameters of the estimated effects, by the effects' names.

        Returns:
            its parameters, and what is left of ``found`` for other effects.
        """
        if cls.name not in found or cls.corrected_in_samples:
            return known, found
        own = {form.name: found[cls.name][form.name] for form in cls().own if form.name in found[cls.name]}
        return {**known, **own}, {name: other for name, other in found.items() if name != cls.name}

    @classmethod
    def together(cls, first: Quantities, second: Quantities) -> Quantities:
        """The parameters of one effect that does what two at one place do, the ``second`` found beside the first."""
        if not cls.adds_up:
            return second
        added = second.keys() & first.keys() - {cls.usual_constant}
        return {**first, **{name: first[name].plus(q) if name in added else q for name, q in second.items()}}

    # What it does to the world and to the sensors; the defaults do nothing.

    corrected_in_samples: ClassVar[bool] = False
    """Whether signals are freed of it where it is known, by the hooks below."""

    @classmethod
    def turned_gravity(cls, gravity: FloatArray, values: Values) -> FloatArray:  # noqa: ARG003
        """Gravity ``(3,)`` in the base frame, from that of a base that stands straight."""
        return gravity

    @classmethod
    def effort_scale(cls, values: Values) -> float:  # noqa: ARG003
        """Factor from true efforts to measured ones at its joint."""
        return 1.0

    @classmethod
    def effort_shift(cls, values: Values) -> float:  # noqa: ARG003
        """What measured efforts at its joint show beside the scaled true ones [N m or N]."""
        return 0.0

    @classmethod
    def effort_lag(cls, values: Values) -> float:  # noqa: ARG003
        """How long after the motion efforts are measured [s]."""
        return 0.0

    @classmethod
    def wrench_shift(cls, values: Values) -> dict[str, float]:  # noqa: ARG003
        """What its wrench sensor shows beside the true wrench, by axis [N, N m]."""
        return {}

    # What friction the motion and the load bring, beside what URDF and MJCF say.

    @classmethod
    def dry_friction(cls, coefficient: float, load: FloatArray) -> FloatArray:  # noqa: ARG003
        """Size ``(N,)`` of the friction whose sign is unknown about standstill, under the gear's ``load (N,)``."""
        return np.zeros(load.shape)

    @classmethod
    def friction_by_load(cls, values: Values) -> float:  # noqa: ARG003
        """Friction per effort that the gear transmits."""
        return 0.0

    @classmethod
    def holding_friction(cls, values: Values) -> float:  # noqa: ARG003
        """Friction that holds a joint at rest beside what the MJCF says [N m or N]."""
        return 0.0

    def unsaid_efforts(self, values: Values, motion: Motion, place: Place) -> FloatArray | float:  # noqa: ARG002
        """Efforts ``(..., J)`` of a moving robot that the MJCF does not say."""
        return 0.0

    @classmethod
    def hinge(cls, values: Values, carried: float) -> Hinge | None:  # noqa: ARG003
        """The hinge behind the joint that the MJCF needs for it; ``carried``: inertia behind the joint [kg m^2, kg]."""
        return None


class MotionEffect(Effect):
    """An effect of one coefficient that adds ``coefficient * efforts(motion)`` to the joints' efforts.

    It can be identified along with the inertias. Its column is computed before the filter and filtered as efforts are.
    """

    @property
    def positives(self) -> int:
        """1 if the coefficient lives on P(1) (it cannot change sign, the metric is dc^2/c^2), 0 if on a real line: a
        parameter that must be above zero does the former."""
        return int(self.parameters[0].above == 0.0)

    @abstractmethod
    def efforts(self, motion: Motion, place: Place) -> FloatArray:
        """Efforts ``(..., J)`` per unit of the coefficient, at each instant by itself."""

    def unsaid_efforts(self, values: Values, motion: Motion, place: Place) -> FloatArray | float:
        """All of it, unless the MJCF says it."""
        if any(form.mjcf for form in self.parameters):
            return 0.0
        return values[self.own[0].name] * self.efforts(motion, place)


class JointEffect(MotionEffect):
    """A function of one joint's motion, with one coefficient per joint."""

    @abstractmethod
    def column(self, motion: JointMotion) -> FloatArray:
        """Effort ``(...)`` at the joint per unit of the coefficient, at each instant by itself."""

    @classmethod
    def states(cls, effects: Sequence[Self], moved: FloatArray, before: FloatArray) -> FloatArray:  # noqa: ARG003
        """What each of n ``effects`` of this class remembers ``(N, n, J)`` after each of the steps by which joints have
        ``moved (N, J)``, from what it did ``before`` them ``(n, J)``."""
        return np.zeros((len(moved), *before.shape))

    def efforts(self, motion: Motion, place: Place) -> FloatArray:
        """Those of the one joint."""
        joint = joint_of(place)
        efforts = np.zeros(motion.position.shape)
        efforts[..., joint] = self.column(motion.of(joint))
        return efforts


class PairEffect(MotionEffect):
    """A function of two joints' motion, with one coefficient per pair."""

    place = "joints"

    @abstractmethod
    def columns(self, first: JointMotion, second: JointMotion) -> tuple[FloatArray, FloatArray]:
        """Efforts ``(...)`` at either joint per unit of the coefficient, at each instant by itself."""

    def efforts(self, motion: Motion, place: Place) -> FloatArray:
        """Those of the two joints."""
        first, second = joints_of(place)
        efforts = np.zeros(motion.position.shape)
        efforts[..., first], efforts[..., second] = self.columns(motion.of(first), motion.of(second))
        return efforts


class RobotEffect(MotionEffect):
    """A function of all joints' motion, with one coefficient for the robot."""

    place = "robot"


class SensorEffect(Effect):
    """An effect of a wrench sensor: adds ``columns(motion, axes) . coefficients`` to what the sensor shows.

    Its parameters are named after the axes, fx to tz, that they are coefficients of, one each.
    """

    place: ClassVar[PlaceKind] = "sensor"
    count = 6
    of_sensor = True

    @abstractmethod
    def columns(self, motion: Motion, axes: Sequence[str]) -> FloatArray:
        """Wrench ``(..., axes, coefficients)`` in the sensor's frame per unit of each axis's coefficient."""


class SituationEffect(Effect):
    """An effect that depends on what a model says of the motion: adds ``columns(situation, place) . coefficients`` to
    the channels, to first order in the coefficients."""

    @abstractmethod
    def columns(self, situation: Situation, place: Place) -> FloatArray:
        """Change of the channels per unit of each coefficient, ``(N, C, k)``."""


class LoadEffect(SituationEffect):
    """A function of the motion of one joint and of the effort that its gear transmits, with one coefficient per joint.

    It can be identified along with the inertias: its column is then that of what is known before, which is the URDF's
    rigid bodies alone unless there is a model.
    """

    @abstractmethod
    def column(self, load: FloatArray, sign: FloatArray) -> FloatArray:
        """Effort ``(...)`` at the joint per unit of the coefficient, from the ``load`` that the gear transmits and the
        direction of motion."""

    def columns(self, situation: Situation, place: Place) -> FloatArray:
        """Those of the one joint."""
        joint = joint_of(place)
        return situation.column_of(joint, self.column(situation.transmitted[:, joint], situation.sign[:, joint]))


IdentifiedEffect: TypeAlias = MotionEffect | SensorEffect | LoadEffect
"""What a measurement model can have: linear in coefficients, with columns that no estimate changes."""
