"""What is written, read by the software it is for, or by its documented conventions, against sums over points."""

from __future__ import annotations

import ast
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import Inertia, Vector3

from geomid_ros.errors import InputError
from geomid_ros.exports import formats
from geomid_ros.exports.descriptions import DescriptionFiles, DescriptionFormat
from geomid_ros.exports.formats import Export
from geomid_ros.exports.model import read_model
from geomid_ros.exports.payload import attached, each_link
from geomid_ros.geometry import pseudo_inertia

from .points import Chain, Link, Points, points

FRAME = Link("flange", "base", None, "continuous", (0.3, -0.1, 0.5), (0.7, 0.4, -0.9))
TOOL = Link("tool", "flange", points(21), "fixed", (0.01, -0.04, 0.09), (1.3, -0.6, 0.2))
ROBOT = Chain((Link("base"), FRAME, TOOL))
EXACT = {"rtol": 2e-8, "atol": 1e-10}


@pytest.fixture
def payload(tmp_path: Path) -> Export:
    return attached(read_model(ROBOT.write(tmp_path)), "flange")


TRUTH = ROBOT.seen("tool", "flange")


def pasted(export: Export, inertial: Callable[[Export], str]) -> str:
    return DescriptionFormat((), inertial, lambda _: DescriptionFiles("", [])).payload(export)


def line(text: str, start: str) -> str:
    (found,) = (line for line in text.splitlines() if line.startswith(start))
    return found


def requests(text: str) -> list[dict[str, Any]]:
    """Of all service calls, as the ros2 command reads them."""
    lines = [line for line in text.splitlines() if line.startswith("ros2 service call")]
    return [yaml.safe_load(re.fullmatch(r"[^']*'([^']*)'", line).group(1)) for line in lines]  # type: ignore[union-attr]


def leaves(value: Any) -> list[Any]:
    if isinstance(value, dict):
        return [leaf for own in value.values() for leaf in leaves(own)]
    return [leaf for own in value for leaf in leaves(own)] if isinstance(value, list) else [value]


def test_urscript(payload: Export) -> None:
    """Arguments in the order of the Script Manual."""
    text = formats.ur_commands(payload)
    called = line(text, "set_target_payload(")
    mass, com, inertia = ast.literal_eval(called.removeprefix("set_target_payload"))
    assert mass == pytest.approx(TRUTH.mass, rel=1e-8)
    np.testing.assert_allclose(com, TRUTH.com, **EXACT)
    np.testing.assert_allclose(inertia, TRUTH.six, **EXACT)
    old = ast.literal_eval(line(text, "set_payload(").removeprefix("set_payload"))
    assert old == (mass, com)
    shell = re.compile(r"#|ros2 |set_(target_)?payload\(|$")
    assert all(shell.match(own) for own in text.splitlines())


def test_calls_of_the_ur_driver(payload: Export) -> None:
    """The three generations of ur_msgs/srv/SetPayload; the third has a geometry_msgs/Inertia."""
    with_inertia, without, message = requests(formats.ur_commands(payload))
    fields = ["mass", "center_of_gravity", "ixx", "iyy", "izz", "ixy", "ixz", "iyz"]
    assert list(with_inertia) == fields
    assert list(without) == fields[:2]
    np.testing.assert_allclose([with_inertia[key] for key in fields[2:]], TRUTH.six, **EXACT)
    np.testing.assert_allclose([without["center_of_gravity"][axis] for axis in "xyz"], TRUTH.com, **EXACT)
    inertia = message["payload"]
    inertia["com"] = Vector3(**inertia["com"])
    checked = Inertia(**inertia)  # of the right fields and types, or this fails
    assert checked.m == with_inertia["mass"]
    np.testing.assert_allclose([checked.ixx, checked.iyy, checked.izz, checked.ixy], TRUTH.six[:4], **EXACT)
    assert all(type(leaf) is float for own in (with_inertia, without) for leaf in leaves(own))


def test_libfranka_and_its_service(payload: Export) -> None:
    text = formats.franka_commands(payload)
    call = re.fullmatch(r"robot\.setLoad\((.*), \{\{(.*)\}\}, \{\{(.*)\}\}\);", line(text, "robot.setLoad"))
    assert call
    mass, com, inertia = (np.array([float(part) for part in group.split(",")]) for group in call.groups())
    assert mass == pytest.approx(TRUTH.mass, rel=1e-8)
    np.testing.assert_allclose(com, TRUTH.com, **EXACT)
    np.testing.assert_allclose(inertia.reshape(3, 3, order="F"), TRUTH.inertia, **EXACT)
    (request,) = requests(text)
    assert list(request) == ["mass", "center_of_mass", "load_inertia"]
    assert request["mass"] == mass
    assert request["center_of_mass"] == com.tolist()
    assert request["load_inertia"] == inertia.tolist()


SDF = '<sdf version="1.10"><model name="m"><link name="flange">{}</link></model></sdf>'


def test_the_sdf_block_by_the_specification(payload: Export) -> None:
    """Products of inertia are the sums of -m x y, in the axes of a pose that does not turn."""
    inertial = ET.fromstring(SDF.format(pasted(payload, formats.sdf_inertial))).find("model/link/inertial")
    assert inertial is not None
    assert [own.tag for own in inertial] == ["pose", "mass", "inertia"]
    values = {own.tag: [float(part) for part in (own.text or "").split()] for own in inertial.iter()}
    np.testing.assert_allclose(values["pose"], [*TRUTH.com, 0.0, 0.0, 0.0], **EXACT)
    assert values["mass"] == pytest.approx([TRUTH.mass], rel=1e-8)
    x, y, z = (TRUTH.positions - TRUTH.com).T
    for key, integrand in {"ixx": y**2 + z**2, "izz": x**2 + y**2, "ixy": -x * y, "ixz": -x * z, "iyz": -y * z}.items():
        np.testing.assert_allclose(values[key], TRUTH.masses @ integrand, **EXACT)


def test_every_link_in_its_own_frame(tmp_path: Path) -> None:
    """And names with hyphens side by side, which no comment of XML may have."""
    bodies: list[Points] = [points(31), points(32)]
    chain = Chain((Link("a---b", "", bodies[0]), Link("c", "a---b", bodies[1], "continuous", (1, 2, 3), (1, 2, 3))))
    exports = each_link(read_model(chain.write(tmp_path)))
    for element, write in {"mass": formats.sdf_inertial, "inertial": formats.mjcf_inertial}.items():
        root = ET.fromstring(f"<all>{''.join(pasted(own, write) for own in exports)}</all>")
        masses = [float(own.get("mass") or own.text or "nan") for own in root.iter(element)]
        assert masses == pytest.approx([body.mass for body in bodies], rel=1e-8)
    links = ET.fromstring(f"<all>{''.join(pasted(own, formats.urdf_inertial) for own in exports)}</all>").findall(
        "inertial/origin"
    )
    for origin, body in zip(links, bodies, strict=True):
        np.testing.assert_allclose([float(own) for own in (origin.get("xyz") or "").split()], body.com, **EXACT)


def test_a_name_cannot_leave_its_comment(tmp_path: Path) -> None:
    """What is pasted into a shell or a controller is ours, whatever the links are called."""
    chain = Chain((Link("base&#10;reboot", "", points(41)), Link("tool0", "base&#10;reboot", points(42))))
    (tmp_path / "r.urdf").write_text(chain.urdf())
    model = read_model(tmp_path / "r.urdf")
    named = attached(model, "base\nreboot")
    for text in (formats.ur_commands(named), formats.franka_commands(named), pasted(named, formats.urdf_inertial)):
        assert "base reboot" in text
        assert "base\nreboot" not in text


def test_what_cannot_exist_or_a_robot_does_not_take_is_refused(payload: Export, tmp_path: Path) -> None:
    urdf = tmp_path / "flat.urdf"
    inertial = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="3"/></inertial>'
    urdf.write_text(f'<robot name="r"><link name="sheet">{inertial}</link></robot>')
    with pytest.raises(InputError, match="link 'sheet': its mass is 1 kg, but its principal moments"):
        each_link(read_model(urdf))
    quantities = payload.inertial.quantities.copy()
    quantities[[4, 6, 9]] = 134.0
    heavy = Export("ship", "tool0", replace(payload.inertial, parameters=pseudo_inertia.parameters_of(quantities)))
    with pytest.raises(InputError, match="ship: its inertia is beyond the 133 kg m"):
        formats.ur_commands(heavy)
