"""The shipped robots, and how the simulator reads a URDF compared with pinocchio."""

from __future__ import annotations

from math import pi
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from geomid_ros.errors import InputError
from geomid_ros.simulation.description import read_description
from geomid_ros.simulation.robots import robot_description, robot_names
from geomid_ros.types import FloatArray

ROBOTS = robot_names()
ONE_JOINT = """<robot name="one"><link name="base"/>
<link name="arm"><inertial><origin xyz="0.1 0.2 0.3" rpy="0.4 -0.5 0.6"/><mass value="2"/>
<inertia ixx="0.03" ixy="0.002" ixz="-0.001" iyy="0.04" iyz="0.003" izz="0.05"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="10" velocity="2"/></joint></robot>"""


def floats(text: str) -> FloatArray:
    return np.array([float(word) for word in text.split()])


def solid(visual: ElementTree.Element) -> tuple[float, pin.SE3, FloatArray]:
    """Volume, placement and inertia per unit of mass of a drawn solid."""
    origin, geometry = visual.find("origin"), visual.find("geometry")
    assert origin is not None
    assert geometry is not None
    placement = pin.SE3(pin.rpy.rpyToMatrix(floats(origin.attrib["rpy"])), floats(origin.attrib["xyz"]))
    shape = geometry[0]
    if shape.tag == "box":
        a, b, c = floats(shape.attrib["size"])
        return a * b * c, placement, pin.Inertia.FromBox(1.0, a, b, c).inertia
    radius, length = float(shape.attrib["radius"]), float(shape.attrib["length"])
    return pi * radius**2 * length, placement, pin.Inertia.FromCylinder(1.0, radius, length).inertia


@pytest.mark.parametrize("robot", ROBOTS)
def test_inertias_are_those_of_the_drawn_solids(robot: str) -> None:
    root = ElementTree.fromstring(robot_description(robot))
    for body in read_description(robot_description(robot)).inertias:
        solids = [solid(visual) for visual in root.findall(f"link[@name='{body.name}']/visual")]
        density = body.mass / sum(volume for volume, _, _ in solids)
        total = pin.Inertia.Zero()
        for volume, placement, inertia in solids:
            total += placement.act(pin.Inertia(density * volume, np.zeros(3), density * volume * inertia))
        np.testing.assert_allclose(body.com, total.lever, rtol=0.0, atol=1e-5)
        np.testing.assert_allclose(body.inertia, total.inertia, rtol=0.0, atol=1e-4 * np.trace(total.inertia))


@pytest.mark.parametrize("robot", ROBOTS)
def test_pinocchio_reads_the_same(robot: str) -> None:
    text = robot_description(robot)
    model, description = pin.buildModelFromXML(text), read_description(text)
    assert model.nv == len(description.joints)
    for name, lower, upper in zip(model.names[1:], model.lowerPositionLimit, model.upperPositionLimit, strict=True):
        joint = next(joint for joint in description.joints if joint.name == name)
        assert (joint.lower, joint.upper) == (lower, upper)
    moving = sum(body.mass for body in description.inertias if body.name != description.root)
    assert moving == pytest.approx(sum(inertia.mass for inertia in model.inertias[1:]))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<robot", "<robt", "well-formed"),
        ('<robot name="one">', '<!DOCTYPE x [<!ENTITY a "b">]><robot name="one">', "without a document type"),
        ("revolute", "floating", "'turn' is of type 'floating'"),
        ("revolute", "fixed", "no moving joint"),
        ('effort="10"', "", "no attribute 'effort'"),
        ('effort="10"', 'effort="0"', "joint 'turn' needs limits"),
        ('upper="1"', 'upper="nan"', "not a finite number"),
        ('xyz="0.1 0.2 0.3"', 'xyz="0.1 0.2"', "three numbers"),
        ('<child link="arm"/>', "", "has no <child>"),
        ('<link name="base"/>', '<link name="base"/><link name="loose"/>', "2 trees"),
        ('<mass value="2"/>', "", "has no <mass>"),
    ],
)
def test_unusable_urdf_is_refused_with_the_reason(old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_description(ONE_JOINT.replace(old, new))
