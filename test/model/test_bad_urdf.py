"""Descriptions that cannot be used: one InputError each, which names the source and the element."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.robot import Robot

SOURCE = "/robot_description"
MASS = '<mass value="2"/>'
INERTIA = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
LIMIT = '<limit effort="10" velocity="3" lower="-1" upper="1"/>'
AXIS = '<axis xyz="0 0 1"/>'
LAUGHS = '<!DOCTYPE robot [<!ENTITY a "ha">' + "".join(
    f'<!ENTITY {b} "{10 * f"&{a};"}">' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


def link(name: str, inside: str = MASS + INERTIA) -> str:
    return f'<link name="{name}"><inertial>{inside}</inertial></link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = AXIS + LIMIT) -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>'


def robot(*parts: str) -> str:
    return f'<robot name="r">{"".join(parts)}</robot>'


ARM = (link("base"), link("upper"), link("lower"), joint("shoulder", "base", "upper"), joint("elbow", "upper", "lower"))


def replaced(old: str, new: str, place: int = 2) -> str:
    """The arm with something else in one of its parts (2: the link ``lower``, 4: the joint ``elbow``)."""
    assert old in ARM[place]
    return robot(*ARM[:place], ARM[place].replace(old, new), *ARM[place + 1 :])


BAD = {
    "not XML": ("robot: arm", ["XML"]),
    "cut off": (robot(*ARM)[:-20], ["XML"]),
    "a template": (robot("<xacro:include filename='arm.xacro'/>"), ["xacro file"]),
    "half a character": (robot(*ARM, "\ud800"), ["XML"]),
    "billion laughs": (f"{LAUGHS}]>{robot('&i;', *ARM)}", ["XML", "it has a <!DOCTYPE"]),
    "a file as an entity": (
        f'<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>{robot("&x;")}',
        ["XML", "it has a <!DOCTYPE"],
    ),
    "nested deeply": (robot(*ARM, 70 * "<a>", 70 * "</a>"), ["64"]),
    "too large": (robot(*ARM, f"<!--{5_000_000 * 'x'}-->"), ["5 MB"]),
    "too many links": (robot(*(f'<link name="l{i}"/>' for i in range(1001))), ["1001 links"]),
    "too many joints": (
        robot(*(link(f"l{i}") for i in range(130)), *(joint(f"j{i}", f"l{i}", f"l{i + 1}") for i in range(129))),
        ["129 axes"],
    ),
    "wrong root": ("<sdf version='1.6'/>", ["<sdf>", "<robot>"]),
    "no links": (robot(), ["root"]),
    "robot without a name": (robot(*ARM).replace(' name="r"', ""), []),
    "joint without a name": (replaced(' name="elbow"', "", 4), ["<joint>"]),
    "two links of one name": (robot(*ARM, link("upper")), ["link", "'upper'"]),
    "two joints of one name": (robot(*ARM, link("x"), joint("elbow", "base", "x")), ["joint", "'elbow'"]),
    "two roots": (robot(*ARM, link("stray")), ["root", "base", "stray"]),
    "a missing child": (robot(*ARM, joint("wrist", "lower", "hand")), ["'wrist'", "'hand'"]),
    "no parent": (replaced('<parent link="upper"/>', "", 4), ["'elbow'", "parent"]),
    "a child of two": (robot(*ARM, joint("third", "base", "lower")), ["'lower'", "'elbow'", "'third'"]),
    "a cycle apart": (robot(*ARM, link("x"), link("y"), joint("a", "x", "y"), joint("b", "y", "x")), ["'x'", "loop"]),
    "an unknown type": (replaced("revolute", "ball", 4), ["'elbow'", "'ball'", "prismatic"]),
    "floating": (replaced("revolute", "floating", 4), ["'elbow'", "floating"]),
    "an axis without direction": (replaced("0 0 1", "0 0 0", 4), ["'elbow'", "axis"]),
    "a joint at infinity": (replaced(AXIS, '<origin xyz="inf 0 0"/>' + AXIS, 4), ["'elbow'", "origin", "inf"]),
    "no limits": (replaced(LIMIT, "", 4), ["'elbow'", "limit"]),
    "limits in words": (replaced('effort="10"', 'effort="much"', 4), ["'elbow'", "limit", "much"]),
    "inertia of NaN": (replaced('ixy="0"', 'ixy="nan"'), ["'lower'", "inertia", "nan"]),
    "no mass": (replaced(MASS, ""), ["'lower'", "mass"]),
    "centre of mass at NaN": (replaced(MASS, MASS + '<origin xyz="0 nan 0"/>'), ["'lower'", "origin", "nan"]),
    "negative mass": (replaced('value="2"', 'value="-2"'), ["'lower'"]),
    "a mass beyond the universe's": (replaced('value="2"', 'value="1e308"'), ["'lower'", "mass", "1e308"]),
    "no mass at all": (robot('<link name="a"/>', '<link name="b"/>', joint("j", "a", "b")), ["mass"]),
    "nothing moves": (robot(link("a"), link("b"), joint("j", "a", "b", "fixed")), ["moving"]),
}


# No bodies, but with a mass: what they are taken as.
REPAIRED = {
    "a plate thicker than it is": replaced('izz="1"', 'izz="2.1"'),
    "a point": replaced(INERTIA, INERTIA.replace('"1"', '"0"')),
    "a rod without a width": replaced('izz="1"', 'izz="0"'),
    "a product larger than its moments": replaced('ixy="0"', 'ixy="1.2"'),
}


@pytest.mark.parametrize("case", REPAIRED)
@pytest.mark.parametrize("floating", [False, True])
def test_a_link_that_no_body_can_be_is_repaired_and_told(case: str, floating: bool) -> None:
    """Mass and centre of mass stay, and the moments are those of a body no denser than steel."""
    arm = Robot(REPAIRED[case], floating_base=floating, source=SOURCE)
    parameters = arm.bodies[-1].parameters
    np.testing.assert_allclose(parameters[:4], [2.0, 0.0, 0.0, 0.0], atol=1e-12)
    assert pseudo_inertia.is_body(parameters)
    second = np.linalg.eigvalsh(pseudo_inertia.from_parameters(parameters)[:3, :3])
    radius = np.cbrt(2.0 / 7850.0 / (4.0 / 3.0 * np.pi))
    np.testing.assert_array_less((1.0 - 1e-9) * 2.0 * radius**2 / 5.0, second)
    (sentence,) = arm.inertia_repairs.values()
    assert list(arm.inertia_repairs) == ["lower"]
    for word in ("'lower'", "kg m^2", "mm"):
        assert word in sentence


@pytest.mark.parametrize("case", BAD)
def test_a_bad_description_is_refused(case: str) -> None:
    text, named = BAD[case]
    with pytest.raises(InputError) as caught:
        Robot(text, source=SOURCE)
    for word in (SOURCE, *named):
        assert word in str(caught.value)
    assert len(str(caught.value)) < 1000


def test_an_impossible_base_does_not_matter_while_it_stands() -> None:
    text = robot(link("base", MASS + INERTIA.replace('izz="1"', 'izz="3"')), *ARM[1:])
    assert Robot(text).body_names == ("upper", "lower")
    assert not Robot(text).inertia_repairs
    assert list(Robot(text, floating_base=True).inertia_repairs) == ["base"]


def test_an_impossible_part_is_named_with_what_it_is_merged_with() -> None:
    bad = link("tool", MASS + INERTIA.replace('izz="1"', 'izz="9"'))
    (sentence,) = Robot(robot(*ARM, bad, joint("flange", "lower", "tool", "fixed"))).inertia_repairs.values()
    assert "'lower' (with lower, tool)" in sentence


def test_meshes_are_not_opened() -> None:
    mesh = '<visual><geometry><mesh filename="package://nowhere/arm.stl"/></geometry></visual>'
    assert Robot(replaced("</inertial>", "</inertial>" + mesh)).body_names == ("upper", "lower")


@pytest.mark.parametrize("name", ["universe", "root_joint"])
@pytest.mark.parametrize("floating", [False, True])
def test_pinocchios_own_names_may_be_used(name: str, floating: bool) -> None:
    text = robot(*ARM[:-1], joint(name, "upper", "lower"))
    arm = Robot(text, floating_base=floating)
    assert arm.joint_names == ("shoulder", name)
    assert Robot(text, floating_base=floating, locked_joints=[name]).joint_names == ("shoulder",)
