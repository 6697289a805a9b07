"""Robot descriptions, as the node and the commands take them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from random import Random
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from benchmarks.fuzz.mutations import NUMBERS, changed_text
from benchmarks.fuzz.target import require
from geomid_ros.commands.live import shared_file
from geomid_ros.files.models.urdf import with_effects, with_inertials
from geomid_ros.model.effects import KnownEffect, Quantity
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session

_SMALL = """<?xml version="1.0"?>
<robot name="small">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="base"><visual><geometry><mesh filename="package://nowhere/base.stl"/></geometry></visual></link>
  <link name="upper">
    <inertial>
      <origin xyz="0.1 0 0.2" rpy="0.1 0 0"/>
      <mass value="2.5"/>
      <inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0" izz="0.02"/>
    </inertial>
    <collision><geometry><box size="0.1 0.1 0.5"/></geometry></collision>
  </link>
  <link name="lower">
    <inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
  </link>
  <link name="tool">
    <inertial><mass value="0.3"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
  </link>
  <joint name="shoulder" type="revolute">
    <origin xyz="0 0 0.3" rpy="0 1.57 0"/>
    <parent link="base"/>
    <child link="upper"/>
    <axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="100" velocity="2"/>
    <dynamics damping="0.1" friction="0.2"/>
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="upper"/><child link="lower"/><axis xyz="0 1 0"/><mimic joint="shoulder" multiplier="2"/>
  </joint>
  <joint name="wrist" type="%s"><parent link="lower"/><child link="tool"/><axis xyz="1 0 0"/>
    <limit effort="1" velocity="1"/></joint>
  <transmission name="t"><type>x</type><joint name="shoulder"/></transmission>
  <gazebo reference="upper"><mu1>0.2</mu1></gazebo>
</robot>
"""
_READ = ("fixed", "revolute", "continuous", "prismatic")
_TYPES = (*_READ, "planar", "floating", "x")
_SNIPPETS = (
    '<!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;">]>',
    '<!DOCTYPE robot SYSTEM "file:///etc/passwd">',
    "&a;",
    "&#0;",
    "&#x10ffff;",
    "&amp;",
    "<![CDATA[<link name='c'/>]]>",
    "<!-- <link/> -->",
    "<?xml version='1.1'?>",
    "<?php x?>",
    "<link name='more'/>",
    "<link/>",
    "<joint name='j' type='fixed'/>",
    "<robot>",
    "</robot>",
    "<inertial/>",
    "<inertial><mass value='1'/></inertial>",
    "<mimic joint='wrist'/>",
    "<a>" * 100,
    "<a>" * 70 + "</a>" * 70,
    "\x00",
    "\ufeff",
    "ä",
    "<x xmlns:y='z'/>",
    "xmlns='u'",
    "<xacro:include filename='/etc/passwd'/>",
    "<axis xyz='0 0 0'/>",
    "<limit lower='1' upper='-1' effort='-1' velocity='0'/>",
    "".join(f"<link name='l{n}'/>" for n in range(1200)),
)
_VALUES = (
    {},
    {"floating_base": True, "wrenches": ["w"], "wrench.w.frame": "world", "wrench.w.role": "external"},
    {"wrenches": ["w"], "wrench.w.frame": "tool"},
    {"locked_joints": ["shoulder", "joint2"]},
)
_WORDS = (
    "",
    "base",
    "upper",
    "lower",
    "tool",
    "shoulder",
    "elbow",
    "universe",
    "root_joint",
    "a b",
    "ä",
    "x" * 5000,
    "%s",
    "../x",
)


class UrdfTarget:
    """Descriptions with something changed become a model; what is written back must say the same."""

    def __init__(self, folder: Path) -> None:
        del folder
        arms = [shared_file(f"bags/{arm}.urdf").read_text(encoding="utf-8") for arm in ("arm3", "arm7")]
        self._whole = [*(_SMALL % kind for kind in _READ), arms[0], arms[0], arms[1]]
        self._configurations = [
            Configuration({"effects": ["viscous_friction"], "gap.memory": 0.0, **values}) for values in _VALUES
        ]
        for text in self._whole:
            self._use(text, self._configurations[0])

    def attempt(self, random: Random) -> None:
        """Change a description, and begin to identify its robot."""
        text = random.choice(self._whole)
        by_tree = random.random() < 0.7
        changed = _changed_tree(text, random) if by_tree else changed_text(text, random, _SNIPPETS)
        self._use(changed, random.choice(self._configurations))

    def _use(self, text: str, configuration: Configuration) -> None:
        session = Session(text, configuration, "fuzz.urdf")
        parameters = session.model.nominal_parameters
        require(np.all(np.isfinite(parameters)), "parameters that are no numbers")
        bodies = session.robot.bodies
        inertias = {body.name: body.parameters for body in bodies if body.name in session.model.body_names}
        written = with_inertials(
            text,
            inertias,
            [name for body in bodies if body.name in inertias for name in body.merged],
        )
        again = Session(written, configuration, "written.urdf")
        require(again.model.body_names == session.model.body_names, "other bodies when written back")
        scale = np.maximum(1.0, np.abs(parameters))
        np.testing.assert_allclose(again.model.nominal_parameters / scale, parameters / scale, atol=1e-5)
        friction = Quantity(0.5, 0.1, "N m s/rad")
        effects = [
            KnownEffect("viscous_friction", joint, "", {"coefficient": friction}) for joint in session.robot.joint_names
        ]
        Session(with_effects(written, effects), configuration, "effects.urdf")


def _changed_tree(text: str, random: Random) -> str:
    robot = ElementTree.fromstring(text)  # noqa: S314 of our own
    for _ in range(random.choice((1, 1, 2, 4))):
        elements = list(robot.iter())
        random.choice(_TREE_CHANGES)(random.choice(elements), elements, random)
    return ElementTree.tostring(robot, encoding="unicode")


def _set_attribute(element: Element, elements: list[Element], random: Random) -> None:
    keys = list(element.keys()) or list(random.choice(elements).keys()) or ["name"]
    values = [value for other in elements for value in other.attrib.values()]
    element.set(random.choice(keys), random.choice(random.choice((NUMBERS, _WORDS, values, _TYPES))))


def _drop_attribute(element: Element, _: list[Element], random: Random) -> None:
    if element.attrib:
        del element.attrib[random.choice(list(element.keys()))]


def _drop_child(element: Element, _: list[Element], random: Random) -> None:
    if len(element):
        del element[random.randrange(len(element))]


def _copy_child(element: Element, elements: list[Element], random: Random) -> None:
    other = random.choice(elements)
    if element not in other.iter():  # else it would be within itself
        element.insert(random.randrange(len(element) + 1), other)


def _rename(element: Element, elements: list[Element], random: Random) -> None:
    element.tag = random.choice([other.tag for other in elements] + ["x", "link", "joint", "inertial"])


def _bury(element: Element, _: list[Element], random: Random) -> None:
    for _ in range(random.choice((3, 62, 70, 200))):
        deeper = Element("x")
        deeper.extend(list(element))
        for child in list(element):
            element.remove(child)
        element.append(deeper)
        element = deeper


_TREE_CHANGES: tuple[Callable[[Element, list[Element], Random], None], ...] = (
    _set_attribute, _set_attribute, _set_attribute, _drop_attribute, _drop_child, _copy_child, _rename, _bury,
)  # fmt: skip
