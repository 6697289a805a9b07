"""The shipped robots, and how the simulator reads a URDF compared with pinocchio."""

from __future__ import annotations

from dataclasses import replace
from math import pi
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from geomid_ros.errors import InputError
from geomid_ros.simulation.description import LinkInertia, read_description
from geomid_ros.simulation.inertias import perturbed, pseudo_inertia
from geomid_ros.simulation.motion import SetPoints, exciting_motion
from geomid_ros.simulation.options import MOTIONS, SimulationOptions
from geomid_ros.simulation.robots import robot_description, robot_names
from geomid_ros.types import FloatArray, frozen

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


JOINTS = read_description(robot_description("arm7")).joints
OPTIONS = SimulationOptions(motion_period=3.0)
TIMES = np.linspace(0.0, 9.0, 9001)


def motion(options: SimulationOptions = OPTIONS) -> SetPoints:
    return exciting_motion(TIMES, JOINTS, options, np.random.default_rng(1))


@pytest.mark.parametrize("kind", MOTIONS)
def test_derivatives(kind: str) -> None:
    """Between the corners that trapezoids of speed have."""
    whole, step = motion(replace(OPTIONS, motion=kind)), TIMES[1] - TIMES[0]
    slope, bend = (np.gradient(values, step, axis=0)[1:-1] for values in (whole.position, whole.velocity))
    inside = np.abs(whole.acceleration[2:] - whole.acceleration[:-2]) < 1.0
    assert inside.mean() > 0.95
    np.testing.assert_allclose(slope, whole.velocity[1:-1], atol=1e-2)
    off = np.abs(bend[inside] - whole.acceleration[1:-1][inside]) > 1e-2
    assert off.mean() < (0.01 if kind == "points" else 1e-9)


@pytest.mark.parametrize("kind", MOTIONS)
@pytest.mark.parametrize(("reach", "speed"), [(0.7, 0.6), (0.1, 1.0), (1.0, 0.1)])
def test_uses_its_share_of_the_limits(reach: float, speed: float, kind: str) -> None:
    whole = motion(replace(OPTIONS, motion_range=reach, motion_speed=speed, motion=kind))
    centre, half, top = np.array([(joint.centre, joint.half_range, joint.velocity) for joint in JOINTS]).T
    used_range = np.abs(whole.position - centre).max(0) / half / reach
    used_speed = np.abs(whole.velocity).max(0) / top / speed
    np.testing.assert_allclose(np.maximum(used_range, used_speed), 1.0, rtol=1e-9)


LINKS = read_description(robot_description("arm7")).inertias


def distance(one: LinkInertia, other: LinkInertia) -> float:
    """Geodesic distance by generalised eigenvalues, a route that the perturbation does not take."""
    values = np.linalg.eigvals(np.linalg.solve(pseudo_inertia(one), pseudo_inertia(other)))
    return float(np.linalg.norm(np.log(values.real)))


@pytest.mark.parametrize("size", [0.01, 0.2, 1.0])
def test_perturbed_bodies_can_exist(size: float) -> None:
    rng = np.random.default_rng(0)
    for link in LINKS * 20:
        body = perturbed(link, size, rng)
        smallest, middle, largest = np.linalg.eigvalsh(body.inertia)
        assert body.mass > 0.0
        assert smallest > 0.0
        assert largest < smallest + middle
        assert np.linalg.eigvalsh(pseudo_inertia(body))[0] > 0.0


def test_size_is_the_deviation_in_each_of_ten_directions() -> None:
    rng = np.random.default_rng(0)
    squares = [distance(link, perturbed(link, 0.2, rng)) ** 2 for link in LINKS * 100]
    assert np.mean(squares) == pytest.approx(10 * 0.2**2, rel=0.05)


def test_impossible_nominal_body_is_refused_by_name() -> None:
    body = LinkInertia("spoon", 1.0, frozen(np.zeros(3)), frozen(np.diag([1.0, 1.0, 3.0])))
    with pytest.raises(InputError, match="link 'spoon'"):
        perturbed(body, 0.2, np.random.default_rng(0))
