"""The identified URDF: the inertials of the identified bodies are replaced, friction and payloads are added, and every
other byte is what it was."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import LinkEstimate
from geomid_ros.files.disk import write_text
from geomid_ros.files.models.urdf import read_urdf, with_effects, with_inertials
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.robot import Robot

from .effects import PAYLOAD, effect
from .estimates import link_estimate
from .recordings import BAGS

WRITTEN = 1e-8  # relative: nine digits are written

INERTIAL = """<inertial >
      <origin xyz="0.1 0 0" rpy="0.1 0.2 0.3"/> <!-- of the CAD -->
      <mass value='1.5'/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>
    </inertial
    >"""
# @NAME@ stands where the inertial of link NAME is, or comes to be.
ARM = """<link name="arm" note="1 > 0 and 'quoted'">
    <!-- <inertial><mass value="3"/></inertial> -->
    <visual><geometry><box size="1 1 1"/></geometry></visual>@arm@<!-- behind --><collision name="an inertial> ?"/>
  </link>"""
TEMPLATE = """<?xml version="1.0"?>
<!-- <link name="arm"><inertial><mass value="9"/></inertial></link> -->
<robot name="odd" xmlns:xacro="http://www.ros.org/wiki/xacro">
\t<link   name = 'base'  ><!-- <inertial> --></link>
  ARM
  <gazebo reference="arm"><link name="arm"><inertial><mass value="8"/></inertial></link><![CDATA[<inertial>]]></gazebo>
  <link name='größe'
        type="\N{SNOWMAN}">@größe@</link>
  <link name="cover">
    @cover@<visual><geometry><sphere radius="1"/></geometry></visual></link>
  <link name="frame"/>
  <joint name="j1" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower='-1' upper="1" effort="9" velocity="9"/></joint>
  <joint name="j2" type="prismatic"><parent link="arm"/><child link="größe"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" effort="9" velocity="9"/></joint>
  <joint name="f1" type="fixed"><origin xyz="0 0 1"/><parent link="arm"/><child link="cover"/></joint>
  <joint name="f2" type="fixed"><parent link="arm"/><child link="frame"/></joint>
</robot>
<!-- the end -->
""".replace("ARM", ARM)
MARK = re.compile(r"@(\w+)@")


def with_identified_inertias(urdf: str, links: Sequence[LinkEstimate]) -> str:
    """A URDF with what was identified: the links that are counted in with others have no mass of their own."""
    merged = [name for link in links for name in link.merged]
    return with_inertials(urdf, {link.name: link.parameters for link in links}, merged)


def filled(template: str) -> str:
    return MARK.sub(lambda _: INERTIAL, template)


def inserted(template: str, text: str) -> dict[str, str]:
    """What stands in ``text`` at the marks of ``template``; fails if anything else differs."""
    literal, names = MARK.split(template)[::2], MARK.findall(template)
    match = re.fullmatch("(.*?)".join(map(re.escape, literal)), text, flags=re.DOTALL)
    assert match is not None, text
    return dict(zip(names, match.groups(), strict=True))


def numbers(element: ElementTree.Element | None, *keys: str) -> list[float]:
    assert element is not None
    return [float(part) for key in keys for part in element.attrib[key].split()]


def assert_is(inertial: str, link: LinkEstimate) -> None:
    """The text is an <inertial> with the numbers of the link."""
    element = ElementTree.fromstring(inertial)
    assert element.tag == "inertial"
    assert numbers(element.find("origin"), "rpy") == [0.0, 0.0, 0.0]
    assert numbers(element.find("origin"), "xyz") == pytest.approx(link.com, rel=WRITTEN)
    assert numbers(element.find("mass"), "value") == pytest.approx([link.mass], rel=WRITTEN)
    entries = numbers(element.find("inertia"), "ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    assert entries == pytest.approx(link.inertia[np.triu_indices(3)], rel=WRITTEN)


def assert_robot_has(urdf: str, links: Sequence[LinkEstimate]) -> None:
    """Pinocchio reads the URDF and finds the identified bodies."""
    bodies = {body.name: body for body in Robot(urdf).bodies}
    for link in links:
        assert bodies[link.name].merged == ()
        np.testing.assert_allclose(bodies[link.name].parameters, link.parameters, rtol=0.0, atol=WRITTEN * link.mass)


LINKS = (link_estimate("arm", ("cover",), 1), link_estimate("größe", (), 2))
VARIANTS = {
    "as it is": TEMPLATE,
    "lines of Windows": TEMPLATE.replace("\n", "\r\n"),
    "byte order mark": "\ufeff" + TEMPLATE,
    "another encoding declared": TEMPLATE.replace('"1.0"?', '"1.0" encoding="ISO-8859-1"?'),
    "no declaration": TEMPLATE.split("\n", 1)[1],
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_other_byte_is_kept(variant: str, tmp_path: Path) -> None:
    template = VARIANTS[variant]
    (tmp_path / "in.urdf").write_bytes(filled(template).encode())
    written = tmp_path / "out.urdf"
    write_text(written, with_identified_inertias(read_urdf(tmp_path / "in.urdf"), LINKS))
    result = written.read_bytes().decode()
    inertials = inserted(template, result)
    assert_is(inertials["arm"], LINKS[0])
    assert_is(inertials["größe"], LINKS[1])
    assert inertials["cover"] == ""
    assert_robot_has(result, LINKS)


@pytest.mark.parametrize(
    ("tag", "inside"),
    [
        ('<link name="arm"/>', ""),
        ("<link name='arm' />", ""),
        ('<link name="arm" note="a>b/>c"  />', ""),
        ("<link name=\"arm\" note='>'>", ""),
        ("<link name=\"arm\" note='>'>", "<!-- none > --><visual><geometry><sphere radius='1'/></geometry></visual>"),
    ],
)
def test_a_link_without_inertial_gets_one_when_what_is_fixed_to_it_has_mass(tag: str, inside: str) -> None:
    given = tag if tag.endswith("/>") else f"{tag}{inside}</link>"
    opened = tag.removesuffix("/>").rstrip(" >") + ">"
    result = with_identified_inertias(filled(TEMPLATE.replace(ARM, given)), LINKS)
    inertials = inserted(TEMPLATE.replace(ARM, f"{opened}@arm@{inside}</link>"), result)
    assert_is(inertials["arm"].strip(), LINKS[0])
    assert inertials["cover"] == ""
    assert_robot_has(result, LINKS)


@pytest.mark.parametrize("name", ["arm3", "arm7"])
def test_shipped_robots(name: str) -> None:
    text = read_urdf(BAGS / f"{name}.urdf")
    bodies = Robot(text).bodies
    links = [link_estimate(body.name, body.merged, seed) for seed, body in enumerate(bodies)]
    result = with_identified_inertias(text, links)
    assert_robot_has(result, links)
    removed = sum(len(body.merged) for body in bodies)
    assert removed > 0
    assert result.count("<inertial>") == text.count("<inertial>") - removed
    kept, had = (re.sub(r"<inertial>.*?</inertial>", "", part, flags=re.DOTALL) for part in (result, text))
    assert kept == had


def test_bodies_close_to_impossible_stay_possible() -> None:
    """A rod as thin as a hair: digits that are not written must not make it impossible."""
    axis = np.array([0.3, -0.5, 0.8])
    inertia = 1e-2 * (np.eye(3) - np.outer(axis, axis) / (axis @ axis)) + 1e-9 * np.eye(3)
    parameters = pseudo_inertia.assemble(np.array(2.0), np.array([0.1, 0.2, 0.3]), inertia)
    assert np.linalg.eigvalsh(pseudo_inertia.from_parameters(parameters))[0] > 0.0
    thin = replace(link_estimate("arm", ("cover",)), parameters=parameters)
    Robot(with_identified_inertias(filled(TEMPLATE), [thin, LINKS[1]]))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (Path.exists, "the robot description cannot be read .*No such file"),
        (Path.mkdir, "not a regular file; expected a robot description"),
        (lambda path: path.write_bytes(b"<robot name='\xff\xfe'/>"), "the robot description cannot be read .*utf-8"),
    ],
)
def test_a_file_that_cannot_be_read_is_named(make: Callable[[Path], object], message: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    make(path)
    with pytest.raises(InputError, match=f"robot.urdf: {message}"):
        read_urdf(path)


ARM3 = read_urdf(BAGS / "arm3.urdf")
VISCOUS = effect("viscous_friction", "joint2", coefficient=0.123456789)
DRY = effect("coulomb_friction", "joint2", level=1.5)


def friction(urdf: str, joint: str) -> tuple[float, float]:
    """Damping and dry friction as pinocchio reads them."""
    model = pin.buildModelFromXML(urdf)
    place = model.joints[model.getJointId(joint)].idx_v
    return float(model.damping[place]), float(model.friction[place])


def with_dynamics(text: str) -> str:
    """The arm with this element in joint2."""
    return re.sub(r'(<joint name="joint2"[^>]*>)', rf"\1 {text}", ARM3)


@pytest.mark.parametrize(
    "dynamics",
    [
        "",
        "<dynamics/>",
        '<dynamics damping="9" friction="8"/>',
        "<dynamics  friction = '8'\n damping='9' ></dynamics>",
        '<dynamics note="damping=1 > friction" damping="0"/>',
    ],
)
def test_friction_is_read_again(dynamics: str) -> None:
    before = with_dynamics(dynamics)
    after = with_effects(before, [VISCOUS, DRY])
    assert friction(after, "joint2") == (0.123456789, 1.5)
    assert friction(after, "joint1") == friction(ARM3, "joint1")
    element = re.compile(r'\s*<dynamics(?:[^>"\']|"[^"]*"|\'[^\']*\')*>(?:</dynamics>)?')
    assert element.sub("", after) == element.sub("", before)


def test_what_no_effect_says_stays() -> None:
    before = with_dynamics('<dynamics damping="9" friction="8" stiction="7"/>')
    after = with_effects(before, [DRY])
    assert after == before.replace('friction="8"', 'friction="1.5"')


def test_levels_of_dry_friction_add_up_and_what_a_urdf_cannot_say_changes_nothing() -> None:
    others = [effect("spring", "joint2", stiffness=1.0, equilibrium=0.0), effect("effort_delay", delay=0.01)]
    stribeck = effect("stribeck_friction", "joint2", level=2.0, excess=1.0, speed=0.1)
    assert with_effects(ARM3, others) == ARM3
    assert friction(with_effects(ARM3, [DRY, stribeck]), "joint2")[1] == 3.5


def test_a_payload_is_a_link_of_its_own() -> None:
    after = with_effects(ARM3, [effect("payload", "tool", **PAYLOAD)])
    before = Robot(ARM3).bodies[-1].parameters
    loaded = Robot(after)
    assert loaded.bodies[-1].merged[-1] == "tool_payload"
    inertia = np.array([[PAYLOAD["i" + "".join(sorted(row + column))] for column in "xyz"] for row in "xyz"])
    body = pin.Inertia(PAYLOAD["mass"], np.array([PAYLOAD[f"com_{axis}"] for axis in "xyz"]), inertia)
    frames = pin.buildModelFromXML(ARM3)
    head = frames.frames[frames.getFrameId(loaded.bodies[-1].name)].placement
    tool = frames.frames[frames.getFrameId("tool")].placement
    expected = head.actInv(tool).act(body).toDynamicParameters()
    np.testing.assert_allclose(loaded.bodies[-1].parameters - before, expected, atol=1e-8)
    links = re.compile(r"  <link name=\"tool_payload\">.*?</joint>\n", re.DOTALL)
    assert links.sub("", after) == ARM3
    twice = Robot(with_effects(after, [effect("payload", "tool", **PAYLOAD)]))
    assert twice.bodies[-1].parameters[0] == pytest.approx(before[0] + 2 * PAYLOAD["mass"]), "it has another name"
