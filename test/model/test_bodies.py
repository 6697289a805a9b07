"""What a URDF's links and joints become: bodies with their parameters, and joints."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.types import FloatArray

from .robots import Reference, random_samples, urdf, with_values
from .test_joint_rows import assert_equal

ROUNDING = 1e-12
ROBOTS = pytest.mark.parametrize(
    ("name", "floating"),
    [
        ("ur5_robot.urdf", False),
        ("panda.urdf", False),
        ("kinova.urdf", False),
        ("a1.urdf", True),
        ("talos_reduced.urdf", True),
        ("human.urdf", True),
    ],
)


def masses(text: str) -> dict[str, float]:
    """Mass by link, read straight from the XML; links without one are left out."""
    elements = {link.get("name"): link.find("inertial/mass") for link in ElementTree.fromstring(text).findall("link")}
    found = {name: float(mass.get("value")) for name, mass in elements.items() if mass is not None}
    return {name: mass for name, mass in found.items() if mass > 0.0}


def lumped(robot: Robot, text: str, parameters: FloatArray) -> dict[int, FloatArray]:
    """Parameters ``(10,)`` of all bodies that a joint moves, in the joint's frame, by pinocchio's joint."""
    reference = Reference(text, floating_base=robot.floating_base)
    sums: dict[int, pin.Inertia] = {}
    for body, own in zip(robot.bodies, parameters, strict=True):
        frame = reference.frame(body.name)
        inertia = frame.placement.act(pin.Inertia.FromDynamicParameters(own))
        sums[frame.parentJoint] = sums.get(frame.parentJoint, pin.Inertia.Zero()) + inertia
    return {joint: inertia.toDynamicParameters() for joint, inertia in sums.items()}


@ROBOTS
def test_merged_bodies_are_what_pinocchio_lumps(name: str, floating: bool) -> None:
    robot = Robot(urdf(name), floating_base=floating)
    model = Reference(urdf(name), floating_base=floating).model
    sums = lumped(robot, urdf(name), np.array([body.parameters for body in robot.bodies]))
    for joint in range(1, model.njoints):
        expected = model.inertias[joint]
        if expected.mass == 0.0:
            assert joint not in sums
            continue
        values = expected.toDynamicParameters()
        np.testing.assert_allclose(sums[joint], values, rtol=0, atol=ROUNDING * np.max(np.abs(values)))


def test_massless_links_are_no_unknowns() -> None:
    """The human's spherical joints are made of links without a mass: half of all its links."""
    text = urdf("human.urdf")
    robot = Robot(text, floating_base=True)
    assert (len(robot.tree.links), len(masses(text)), len(robot.bodies)) == (37, 18, 18)
    assert set(robot.body_names) == set(masses(text))
    assert len(robot.joints) == 36
    assert robot.massless_links == (), "nothing is between joints at one place"


def test_a_link_that_carries_a_joint_elsewhere_is_missed_without_a_mass() -> None:
    """The URDF has no shapes: that the arm is long says that it is no frame."""
    root = ElementTree.fromstring(urdf("ur5_robot.urdf"))
    for link in root.findall("link"):
        for child in list(link):
            if child.tag != "inertial" or link.get("name") == "upper_arm_link":
                link.remove(child)
    assert Robot(ElementTree.tostring(root, encoding="unicode")).massless_links == ("upper_arm_link",)


CUTS = pytest.mark.parametrize(
    ("name", "cut", "whole"),
    [
        ("panda.urdf", "panda_hand", "panda_link7"),
        ("talos_reduced.urdf", "wrist_left_ft_link", "arm_left_7_link"),
        ("a1.urdf", "FL_foot", "FL_calf"),
    ],
)


@CUTS
def test_a_cut_divides_a_body(name: str, cut: str, whole: str) -> None:
    """Both parts together are the body that was; all others are as they were."""
    before = Robot(urdf(name), floating_base=name == "a1.urdf")
    after = Robot(urdf(name), floating_base=name == "a1.urdf", cuts=[cut])
    assert set(after.body_names) == {*before.body_names, cut}
    old, new = ({body.name: body for body in robot.bodies} for robot in (before, after))
    divided = [new[whole], new[cut]]
    links = [link for body in divided for link in (body.name, *body.merged)]
    assert set(links) == {cut, whole, *old[whole].merged}
    joint = Reference(urdf(name), floating_base=name == "a1.urdf").frame(whole).parentJoint
    sums = [lumped(r, urdf(name), np.array([body.parameters for body in r.bodies]))[joint] for r in (before, after)]
    np.testing.assert_allclose(sums[1], sums[0], rtol=0, atol=ROUNDING * np.max(np.abs(sums[0])))
    for body in before.bodies:
        if body.name != whole:
            np.testing.assert_array_equal(new[body.name].parameters, body.parameters)
    assert (after.carrier(whole), after.carrier(cut)) == (whole, cut)


@pytest.mark.parametrize(("factor", "kept"), [(1.5, True), (0.005, False)])
def test_a_body_is_written_as_links_that_add_up_to_it(factor: float, kept: bool) -> None:
    """Links behind locked joints keep the URDF's inertials if the rest is possible; else all have their shares."""
    robot = Robot(urdf("panda.urdf"), locked_joints=["panda_finger_joint1", "panda_joint5"])
    for body in (body for body in robot.bodies if body.locked):
        own = pseudo_inertia.from_parameters(body.parameters)
        stretch = np.diag([1.0, 1.2, 0.9, 1.0]) if not kept else np.eye(4)
        whole = pseudo_inertia.to_parameters(factor * stretch @ own @ stretch)
        links = robot.as_links({body.name: whole})
        assert (links.keys() == {body.name}) == kept
        links = {link: robot.tree.inertials[link] for link in body.locked} | links
        assert all(map(pseudo_inertia.is_body, links.values()))
        parts = [pseudo_inertia.moved(own, robot.fixed_placement(link, body.name)) for link, own in links.items()]
        np.testing.assert_allclose(sum(parts), whole, rtol=0, atol=ROUNDING * np.max(np.abs(whole)))


def test_locked_joints_stand_at_zero() -> None:
    """The same efforts as the whole robot with these joints at rest at zero; their links are merged."""
    locked = ["panda_joint5", "panda_finger_joint1", "panda_finger_joint1"]
    robot, whole = Robot(urdf("panda.urdf"), locked_joints=locked), Robot(urdf("panda.urdf"))
    assert robot.joint_names == tuple(name for name in whole.joint_names if name not in locked)
    merged = {body.name: set(body.merged) for body in robot.bodies}
    assert merged["panda_link4"] == {"panda_link5"}
    assert merged["panda_link7"] == {"panda_hand", "panda_leftfinger"}

    samples = random_samples(whole, seed=1)
    moving = np.array([name in robot.joint_names for name in whole.joint_names])
    still = {kind: getattr(samples, kind) * moving for kind in ("position", "velocity", "acceleration")}
    efforts = Reference(urdf("panda.urdf")).inverse_dynamics(with_values(samples, **still), whole.joint_names)[1]
    arrays = (*still, "effort")
    reduced = with_values(samples, **{kind: getattr(samples, kind)[:, moving] for kind in arrays})
    model = MeasurementModel(robot, [])
    assert_equal(model.predict(reduced, model.nominal_inertias)[1], efforts[:, moving])


def test_a_locked_joint_may_be_of_many_axes() -> None:
    """A base that could slide over the floor but does not."""
    text = urdf("ur5_robot.urdf")
    assert text.count('<joint name="world_joint" type="fixed">') == 1
    text = text.replace('<joint name="world_joint" type="fixed">', '<joint name="world_joint" type="planar">')
    robot = Robot(text, locked_joints=["world_joint"])
    assert robot.body_names == Robot(urdf("ur5_robot.urdf")).body_names


def test_joints() -> None:
    kinova, panda = Robot(urdf("kinova.urdf")), Robot(urdf("panda.urdf"))
    assert [joint.continuous for joint in kinova.joints] == [True, False, False, True, False, True]
    assert [joint.unit for joint in panda.joints] == ["N m"] * 7 + ["N"] * 2
    assert [joint.q for joint in kinova.joints] == [0, 2, 3, 4, 6, 7]
    assert [joint.v for joint in kinova.joints] == list(range(6))


@ROBOTS
def test_joints_of_one_chain_carry_each_other(name: str, floating: bool) -> None:
    """As the URDF's tree has it."""
    robot = Robot(urdf(name), floating_base=floating)
    children = {joint.name: joint.child for joint in robot.tree.joints}
    own = [(children[joint], robot.tree.subtree(children[joint])) for joint in robot.joint_names]
    for place, (child, carried) in enumerate(own):
        related = {other for other, (link, beyond) in enumerate(own) if link in carried or child in beyond}
        assert robot.chain(place) == sorted(related - {place})
