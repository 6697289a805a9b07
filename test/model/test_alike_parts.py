"""Parts that are alike: which links of a URDF are, and by which mirror."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.model.alike_parts import AlikeParts, alike_parts, alike_sentences
from geomid_ros.model.robot import Robot

from .robots import urdf

LINK = """<link name="{name}"><inertial><origin xyz="0 0.1 0"/><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = '<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{name}"/></joint>'
LEGS = ("FL", "FR", "RL", "RR")


def chain(*parents: str) -> str:
    """Three links that are the same."""
    pairs = list(zip(("first", "second", "third"), parents, strict=True))
    parts = [LINK.format(name=name) + JOINT.format(name=name, parent=parent) for name, parent in pairs]
    return f'<robot name="three"><link name="base"/>{"".join(parts)}</robot>'


def groups(text: str, links: list[str] | None = None) -> tuple[AlikeParts, ...]:
    robot = Robot(text)
    names = robot.body_names if links is None else links
    return alike_parts(robot, [robot.body_names.index(name) for name in names])


def test_the_legs_of_a_quadruped_are_alike() -> None:
    found = groups(urdf("go2.urdf"))
    assert [group.names for group in found] == [
        tuple(f"{leg}_{part}" for leg in LEGS) for part in ("hip", "thigh", "calf")
    ]
    (sentence,) = alike_sentences(found)
    assert "FL_hip, FR_hip, RL_hip, RR_hip (motors of one type); FL_thigh" in sentence


@pytest.mark.parametrize("name", ["go2.urdf", "talos_reduced.urdf"])
def test_the_mirror_takes_tangent_coordinates_to_those_of_the_first(name: str) -> None:
    """A change of the first link, mirrored in space, has the coordinates with the signs that are said."""
    robot = Robot(urdf(name))
    manifold = ParameterManifold(1, 0, np.zeros(0))
    change = 0.3 * np.random.default_rng(1).normal(size=10)
    for group in alike_parts(robot, range(len(robot.bodies))):
        bodies = [manifold.point(robot.bodies[member].parameters) for member in group.members]
        for body, signs in zip(bodies, group.signs, strict=True):
            mirrors = np.diag([*(signs[[6, 8, 9]]), 1.0])  # of x, y and z with the mass
            changed = mirrors @ manifold.exp(bodies[0], change).pseudo_inertias[0] @ mirrors
            there = manifold.point(pseudo_inertia.to_parameters(changed))
            np.testing.assert_allclose(signs * manifold.log(body, there), change, atol=1e-6)


def test_links_of_one_chain_are_not() -> None:
    """Though their inertials are the same, and each carries the next; those that hang side by side are."""
    assert groups(chain("base", "first", "second")) == ()
    (every,) = groups(chain("base", "base", "base"))
    assert every.names == ("first", "second", "third")


@pytest.mark.parametrize(
    ("was", "now", "other"),
    [
        ('value="0.678"', 'value="0.9"', "FL_hip"),
        ('effort="45.43"', 'effort="40"', "FL_calf"),
        ('xyz="0 0 -0.213"', 'xyz="0 0 -0.25"', "FL_thigh"),
    ],
    ids=["heavier", "another motor", "longer"],
)
def test_one_that_differs_is_another_part(was: str, now: str, other: str) -> None:
    text = urdf("go2.urdf")
    assert was in text
    named = {name for group in groups(text.replace(was, now, 1)) for name in group.names}
    assert named == {f"{leg}_{part}" for leg in LEGS for part in ("hip", "thigh", "calf")} - {other}


def test_only_links_that_are_identified_count() -> None:
    (only,) = groups(urdf("go2.urdf"), ["FL_hip", "RR_calf", "FR_calf"])
    assert only.names == ("RR_calf", "FR_calf")
    assert only.members == (1, 2)
    assert groups(urdf("go2.urdf"), ["FL_hip", "FL_calf", "FR_thigh"]) == ()
    assert list(alike_sentences(())) == []
