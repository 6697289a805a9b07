"""The shipped robots, and how the simulator reads a URDF compared with pinocchio."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.simulation.description import (
    LinkInertia,
    perturbed,
    pseudo_inertia,
    read_description,
    robot_description,
)
from geomid_ros.simulation.motion import exciting_motion
from geomid_ros.simulation.options import MOTIONS, SimulationOptions
from geomid_ros.types import frozen

ONE_JOINT = """<robot name="one"><link name="base"/>
<link name="arm"><inertial><origin xyz="0.1 0.2 0.3" rpy="0.4 -0.5 0.6"/><mass value="2"/>
<inertia ixx="0.03" ixy="0.002" ixz="-0.001" iyy="0.04" iyz="0.003" izz="0.05"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="10" velocity="2"/></joint></robot>"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<robot", "<robt", "well-formed"),
        ('<robot name="one">', '<!DOCTYPE x [<!ENTITY a "b">]><robot name="one">', "without a document type"),
        ("revolute", "floating", "'turn' is of type 'floating'"),
        ('effort="10"', "", "no attribute 'effort'"),
        ('upper="1"', 'upper="nan"', "has to hold 1 finite number"),
        ('<link name="base"/>', '<link name="base"/><link name="loose"/>', "2 trees"),
        ('<mass value="2"/>', "", "has no <mass>"),
    ],
)
def test_unusable_urdf_is_refused_with_the_reason(old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_description(ONE_JOINT.replace(old, new))


JOINTS = read_description(robot_description("arm7")).joints
TIMES = np.linspace(0.0, 9.0, 9001)


@pytest.mark.parametrize("kind", MOTIONS)
def test_motions_use_their_share_of_the_limits_and_derivatives_are_right(kind: str) -> None:
    """Between the corners that trapezoids of speed have."""
    reach, speed, step = 0.7, 0.6, TIMES[1] - TIMES[0]
    options = SimulationOptions(motion_period=3.0, motion_range=reach, motion_speed=speed, motion=kind)
    whole = exciting_motion(TIMES, JOINTS, options, np.random.default_rng(1))
    centre, half, top = np.array([(joint.centre, joint.half_range, joint.velocity) for joint in JOINTS]).T
    used_range = np.abs(whole.position - centre).max(0) / half / reach
    used_speed = np.abs(whole.velocity).max(0) / top / speed
    np.testing.assert_allclose(np.maximum(used_range, used_speed), 1.0, rtol=1e-9)
    slope, bend = (np.gradient(values, step, axis=0)[1:-1] for values in (whole.position, whole.velocity))
    inside = np.abs(whole.acceleration[2:] - whole.acceleration[:-2]) < 1.0
    assert inside.mean() > 0.95
    np.testing.assert_allclose(slope, whole.velocity[1:-1], atol=1e-2)
    off = np.abs(bend[inside] - whole.acceleration[1:-1][inside]) > 1e-2
    assert off.mean() < (0.01 if kind == "points" else 1e-9)


LINKS = read_description(robot_description("arm7")).inertias


def distance(one: LinkInertia, other: LinkInertia) -> float:
    """Geodesic distance by generalised eigenvalues, a route that the perturbation does not take."""
    values = np.linalg.eigvals(np.linalg.solve(pseudo_inertia(one), pseudo_inertia(other)))
    return float(np.linalg.norm(np.log(values.real)))


def test_size_is_the_deviation_in_each_of_ten_directions() -> None:
    rng = np.random.default_rng(0)
    squares = [distance(link, perturbed(link, 0.2, rng)) ** 2 for link in LINKS * 100]
    assert np.mean(squares) == pytest.approx(10 * 0.2**2, rel=0.05)


def test_perturbed_bodies_can_exist_and_nominal_ones_must() -> None:
    rng = np.random.default_rng(0)
    for link in LINKS * 20:
        body = perturbed(link, 1.0, rng)
        smallest, middle, largest = np.linalg.eigvalsh(body.inertia)
        assert min(body.mass, smallest, smallest + middle - largest) > 0.0
    body = LinkInertia("spoon", 1.0, frozen(np.zeros(3)), frozen(np.diag([1.0, 1.0, 3.0])))
    with pytest.raises(InputError, match="link 'spoon'"):
        perturbed(body, 0.2, np.random.default_rng(0))
