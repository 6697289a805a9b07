"""Places where effects act on a robot, their names, and the coefficients of the effects there."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import TypeAlias

from geomid_ros.errors import check_name
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
"""A coefficient regardless of its effect's constants, as (effect name, place, coefficient index)."""


@dataclass(frozen=True, kw_only=True)
class Coefficient:
    """Coefficient number ``index`` of an effect at a place. It is the effect's ``parameter`` of that name;
    ``optional``: True if the model may do without it."""

    effect: IdentifiedEffect
    place: Place
    index: int
    place_name: str
    parameter: str
    unit: str
    optional: bool = False

    @property
    def positive(self) -> bool:
        """True if it is on P(1), not on a real line."""
        return self.index < self.effect.column_positives

    @property
    def mechanism(self) -> Mechanism:
        """Its mechanism: an estimate has at most one coefficient of each, whatever the constants of its effect."""
        return self.effect.name, self.place, self.index

    def parameters(self, value: float, std: float) -> dict[str, Quantity]:
        """Return the parameters that follow from its ``value``: its own, and its effect's constants."""
        parameter = {self.parameter: Quantity(value, std, self.unit)}
        constants = self.effect.constants([(value, std)], math.nan, 0.0)
        sliding = self.effect.parameters[0].slides_by(self.unit)
        first = self.effect.parameters.index(self.effect.column_parameters[-1]) + 1
        return parameter | quantities(self.effect.parameters[first:], constants, sliding=sliding)


@dataclass(frozen=True, eq=False, kw_only=True)
class EffectPlaces:
    """Places on a ``robot`` where effects act.

    Attributes:
        robot, links: the robot, and the names of its identified links.
        sensors, layout: predicted wrench sensors, and the channel layout.
        commanded: True if efforts are computed from commands, which may act late.
    """

    robot: Robot
    links: Sequence[str]
    sensors: Sequence[WrenchSensor]
    layout: ChannelLayout
    commanded: bool

    def of(self, effect: Effect) -> list[Place]:
        """Return the places where an effect may act."""
        match effect.place:
            case "joint":
                return [AtJoint(joint) for joint in self.layout.efforts]
            case "joints":
                return [AtJoints(*pair) for pair in self._chain] if self.layout.efforts else []
            case "robot":
                has_efforts = self.layout.efforts or effect.turns_gravity
                return [OnRobot()] if has_efforts and not self.robot.floating_base else []
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
        """Return the name of a place in files and tables: a joint, two joints as ``FIRST+SECOND``, the joint that moves
        a link, or a sensor's topic; empty for the whole robot."""
        match place:
            case AtSensor(topic, _):
                return topic
            case AtJoints(first, second):
                return pair_name(self.robot.joint_names[first], self.robot.joint_names[second])
        return "".join(self.robot.joint_names[joint] for joint in joints_of(place))

    def link(self, place: Place) -> str:
        """Return the link of a place on a link; empty for other places."""
        return self.links[place.link] if isinstance(place, OnLink) else ""

    def named(self, effect: Effect, name: str) -> Place:
        """Return the place ``name`` of an effect. Raises InputError with the valid names."""
        places = {self.name(place): place for place in self.of(effect)}
        check_name(f"place of {effect.label}", name, places)
        return places[name]

    def is_default(self, place: Place) -> bool:
        """True if candidate effects are tried at a place by default. Two joints must have intersecting axes, because
        only then does a gear between them make them share a motor."""
        return not isinstance(place, AtJoints) or self.robot.axes_meet(place.first, place.second)

    def slides(self, place: Place) -> bool:
        """True if the (first) joint of a place is prismatic."""
        joints = joints_of(place)
        return bool(joints) and self.robot.joints[joints[0]].unit == "N"

    def coefficients(
        self,
        common: Sequence[IdentifiedEffect],
        local: Mapping[str, Sequence[IdentifiedEffect]],
        candidates: Sequence[IdentifiedEffect],
        link_side_joints: Collection[str],
    ) -> tuple[Coefficient, ...]:
        """Return the effects' coefficients at all places, positive ones first; the arguments are those of
        :class:`~geomid_ros.model.measurement_model.MeasurementModel`."""
        effects = dict.fromkeys([*common, *chain.from_iterable(local.values()), *candidates])
        pairs = [(effect, place) for effect in effects for place in self.of(effect)]
        entries: list[Coefficient] = []
        for effect, place in pairs:
            own = local.get(self.name(place), ())
            everywhere = effect in common or (effect in candidates and self.is_default(place))
            acts = effect in own or (everywhere and effect.name not in {other.name for other in own})
            # A sensor on the link side of a gear does not show what acts before it.
            joints = {self.robot.joint_names[joint] for joint in joints_of(place)}
            if acts and not (effect.before_gear and joints.intersection(link_side_joints)):
                entries += self.coefficients_at(effect, place, optional=effect not in (*common, *own))
        names = [effect.name for effect in effects]
        places = list(dict.fromkeys(coefficient.place for coefficient in entries))
        # Coefficients of one mechanism are adjacent, whatever the constants of their effects.
        return tuple(sorted(entries, key=lambda c: (not c.positive, names.index(c.effect.name), places.index(c.place))))

    def coefficients_at(
        self, effect: IdentifiedEffect, place: Place, *, optional: bool = False
    ) -> Iterator[Coefficient]:
        """Yield the coefficients of an effect at a place."""
        forms = effect.column_parameters
        if isinstance(place, AtSensor):
            by_axis = {form.name: form for form in forms}
            axes = next((sensor.axes for sensor in self.sensors if sensor.topic == place.topic), tuple(by_axis))
            forms = tuple(by_axis[axis] for axis in axes)
        for index, form in enumerate(forms):
            yield Coefficient(
                effect=effect,
                place=place,
                index=index,
                place_name=self.name(place),
                parameter=form.name,
                unit=form.units[self.slides(place)],
                optional=optional,
            )

    @property
    def _chain(self) -> list[tuple[int, int]]:
        """Pairs of consecutive moving joints, the proximal one first."""
        movers = [(self.mover(joint.parent), joint.name) for joint in self.robot.tree.joints]
        names = self.robot.joint_names
        return [(above, names.index(name)) for above, name in movers if above is not None and name in names]

    def mover(self, link: str) -> int | None:
        """Return the joint that moves a link, itself or through a mimic joint; None if none does."""
        places = {f.joint.name: f.master for f in self.robot.mimic_joints}
        places |= {name: place for place, name in enumerate(self.robot.joint_names)}
        above = (joint.name for joint in self.robot.tree.joints_above(link))
        return next((places[name] for name in above if name in places), None)
