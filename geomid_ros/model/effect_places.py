"""Where on a robot effects may act, and what these places are called."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from geomid_ros.errors import unknown_name
from geomid_ros.model.channels import BASE, ChannelLayout
from geomid_ros.model.effects import AtJoint, AtJoints, AtSensor, Effect, OnLink, OnRobot, Place, joints_of
from geomid_ros.model.effects.places import pair_name
from geomid_ros.model.robot import Robot


@dataclass(frozen=True)
class EffectPlaces:
    """The places on a ``robot``: on ``links`` that are identified, at sensors of ``topics`` that are predicted;
    ``commanded``: whether efforts are those of commands."""

    robot: Robot
    links: Sequence[str]
    topics: Sequence[str]
    layout: ChannelLayout
    commanded: bool = False

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
                return [OnLink(place, self._mover(link)) for place, link in enumerate(self.links)]
            case "sensor":
                return [AtSensor(topic, tuple(self.layout.wrenches[topic])) for topic in self.topics]
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

    @property
    def _chain(self) -> list[tuple[int, int]]:
        """Pairs of joints of which the second moves on the first, nothing that moves between them."""
        movers = [(self._mover(joint.parent), joint.name) for joint in self.robot.tree.joints]
        names = self.robot.joint_names
        return [(above, names.index(name)) for above, name in movers if above is not None and name in names]

    def _mover(self, link: str) -> int | None:
        """The joint that moves a link."""
        above = (joint.name for joint in self.robot.tree.joints_above(link))
        return next((self.robot.joint_names.index(name) for name in above if name in self.robot.joint_names), None)
