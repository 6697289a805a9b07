"""Which effects act where on a robot: the places, what these are called, and the effects' coefficients there."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import TypeAlias

from geomid_ros.errors import unknown_name
from geomid_ros.model.channels import BASE, ChannelLayout, WrenchSensor
from geomid_ros.model.effects import (
    AtJoint,
    AtJoints,
    AtSensor,
    Effect,
    IdentifiedEffect,
    OnLink,
    OnRobot,
    Place,
    Quantity,
    joints_of,
)
from geomid_ros.model.effects.parameters import quantities
from geomid_ros.model.effects.situation import pair_name
from geomid_ros.model.robot import Robot

Mechanism: TypeAlias = tuple[str, Place, int]
"""What there is once, in whatever shape: an effect by its name, where it is, and the index of the coefficient."""


@dataclass(frozen=True, kw_only=True)
class Coefficient:
    """One of an effect's coefficients at a place, the one of ``index``, which is the ``parameter`` of that name;
    ``optional``: whether it may be left out."""

    effect: IdentifiedEffect
    place: Place
    index: int
    place_name: str
    parameter: str
    unit: str
    optional: bool = False

    @property
    def positive(self) -> bool:
        """Whether it lives on P(1)."""
        return self.index < self.effect.own_positives

    @property
    def mechanism(self) -> Mechanism:
        """What it is, whatever constants its effect has: of coefficients that are the same, a model has one."""
        return self.effect.name, self.place, self.index

    def parameters(self, value: float, std: float) -> dict[str, Quantity]:
        """Its effect's parameters: the one that it is, and the constants."""
        own = {self.parameter: Quantity(value, std, self.unit)}
        constants = self.effect.constants([(value, std)], math.nan, 0.0)
        sliding = self.effect.parameters[0].units[0] != self.unit
        first = self.effect.parameters.index(self.effect.own[-1]) + 1
        return own | quantities(self.effect.parameters[first:], constants, sliding=sliding)


@dataclass(frozen=True, eq=False, kw_only=True)
class EffectPlaces:
    """The places on a ``robot``, and which effects are there.

    Attributes:
        robot, links: its identified links by name.
        sensors, layout: the wrench sensors that are predicted, and the channels.
        common: effects that act at every place of their kind.
        local: those that act only at the place by whose name they are given.
        candidates: those that may act at every usual place of their kind where none of the same name is known.
        behind_gear: names of the joints whose efforts are measured behind the gear, where a motor is not felt.
        commanded: whether efforts are those of commands, which may act late.
    """

    robot: Robot
    links: Sequence[str]
    sensors: Sequence[WrenchSensor]
    layout: ChannelLayout
    common: Sequence[IdentifiedEffect]
    local: Mapping[str, Sequence[IdentifiedEffect]]
    candidates: Sequence[IdentifiedEffect]
    behind_gear: Collection[str]
    commanded: bool

    def of(self, effect: Effect) -> list[Place]:
        """Where an effect may act."""
        match effect.place:
            case "joint":
                return [AtJoint(joint) for joint in self.layout.efforts]
            case "joints":
                return [AtJoints(*pair) for pair in self._chain] if self.layout.efforts else []
            case "robot":
                felt = self.layout.efforts or effect.turns_gravity
                return [OnRobot()] if felt and not self.robot.floating_base else []
            case "commands":
                return [OnRobot()] if self.commanded else []
            case "link":
                return [OnLink(place, self.mover(link)) for place, link in enumerate(self.links)]
            case "sensor":
                return [AtSensor(topic, tuple(channels)) for topic, channels in self.layout.wrenches.items()]
            case "base":
                return [AtSensor(BASE, tuple(self.layout.base[: effect.count]))] if self.layout.base else []
        return []

    def name(self, place: Place) -> str:
        """What files and tables call a place: a joint, two as ``FIRST+SECOND``, the joint that moves a link, the topic
        of a sensor; empty for the whole robot."""
        match place:
            case AtSensor(topic, _):
                return topic
            case AtJoints(first, second):
                return pair_name(self.robot.joint_names[first], self.robot.joint_names[second])
        return "".join(self.robot.joint_names[joint] for joint in joints_of(place))

    def link(self, place: Place) -> str:
        """The link of a place on one; empty for others."""
        return self.links[place.link] if isinstance(place, OnLink) else ""

    def named(self, effect: Effect, name: str) -> Place:
        """The place of an effect that is called ``name``. Raises InputError with the valid names."""
        places = {self.name(place): place for place in self.of(effect)}
        if name not in places:
            raise unknown_name(f"place of {effect.label}", name, places)
        return places[name]

    def is_usual(self, place: Place) -> bool:
        """Whether effects are looked for at a place though nobody said that one acts there: two joints share a motor
        by a gear between them, where their axes meet."""
        return not isinstance(place, AtJoints) or self.robot.axes_meet(place.first, place.second)

    def slides(self, place: Place) -> bool:
        """Whether the (first) joint of a place is prismatic."""
        joints = joints_of(place)
        return bool(joints) and self.robot.joints[joints[0]].unit == "N"

    def coefficients(self) -> tuple[Coefficient, ...]:
        """The effects' coefficients at all places, the positive ones first."""
        effects = dict.fromkeys([*self.common, *chain.from_iterable(self.local.values()), *self.candidates])
        found = [
            coefficient
            for effect in effects
            for place in self.of(effect)
            if self._acts(effect, place) and self._is_felt(effect, place)
            for coefficient in self._at(effect, place)
        ]
        names = [effect.name for effect in effects]
        places = list(dict.fromkeys(coefficient.place for coefficient in found))
        # What there is once stands together, whatever shapes it may have.
        return tuple(sorted(found, key=lambda c: (not c.positive, names.index(c.effect.name), places.index(c.place))))

    def _acts(self, effect: IdentifiedEffect, place: Place) -> bool:
        """Whether an effect is in the model at a place: one that is known there, or one that every place has unless it
        is known there with other constants."""
        local = self.local.get(self.name(place), ())
        everywhere = effect in self.common or (effect in self.candidates and self.is_usual(place))
        return effect in local or (everywhere and effect.name not in {other.name for other in local})

    def _is_felt(self, effect: IdentifiedEffect, place: Place) -> bool:
        """Whether the sensors are on that side of the gear on which an effect acts."""
        joints = {self.robot.joint_names[joint] for joint in joints_of(place)}
        return not (effect.before_gear and joints.intersection(self.behind_gear))

    def _at(self, effect: IdentifiedEffect, place: Place) -> Iterator[Coefficient]:
        name, sliding = self.name(place), self.slides(place)
        forms = effect.own
        if isinstance(place, AtSensor):
            by_axis = {form.name: form for form in forms}
            axes = next((sensor.axes for sensor in self.sensors if sensor.topic == place.topic), tuple(by_axis))
            forms = tuple(by_axis[axis] for axis in axes)
        for index, form in enumerate(forms):
            yield Coefficient(
                effect=effect,
                place=place,
                index=index,
                place_name=name,
                parameter=form.name,
                unit=form.units[sliding],
                optional=effect not in self.common and effect not in self.local.get(name, ()),
            )

    @property
    def _chain(self) -> list[tuple[int, int]]:
        """Pairs of joints of which the second moves on the first, nothing that moves between them."""
        movers = [(self.mover(joint.parent), joint.name) for joint in self.robot.tree.joints]
        names = self.robot.joint_names
        return [(above, names.index(name)) for above, name in movers if above is not None and name in names]

    def mover(self, link: str) -> int | None:
        """The joint that moves a link, itself or one that follows it."""
        places = {f.joint.name: f.master for f in self.robot.followers}
        places |= {name: place for place, name in enumerate(self.robot.joint_names)}
        above = (joint.name for joint in self.robot.tree.joints_above(link))
        return next((places[name] for name in above if name in places), None)
