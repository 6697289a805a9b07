"""Effects in a URDF: friction of joints and payloads; every other character is what it was."""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin
import pytest

from geomid_ros.files.models.urdf import read_urdf, with_effects
from geomid_ros.model.robot import Robot

from .effects import PAYLOAD, effect
from .recordings import BAGS

ARM = read_urdf(BAGS / "arm3.urdf")
VISCOUS = effect("viscous_friction", "joint2", coefficient=0.123456789)
DRY = effect("coulomb_friction", "joint2", level=1.5)


def friction(urdf: str, joint: str) -> tuple[float, float]:
    """Damping and dry friction as pinocchio reads them."""
    model = pin.buildModelFromXML(urdf)
    place = model.joints[model.getJointId(joint)].idx_v
    return float(model.damping[place]), float(model.friction[place])


def with_dynamics(text: str) -> str:
    """The arm with this element in joint2."""
    return re.sub(r'(<joint name="joint2"[^>]*>)', rf"\1 {text}", ARM)


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
    assert friction(after, "joint1") == friction(ARM, "joint1")
    element = re.compile(r'\s*<dynamics(?:[^>"\']|"[^"]*"|\'[^\']*\')*>(?:</dynamics>)?')
    assert element.sub("", after) == element.sub("", before)


def test_what_no_effect_says_stays() -> None:
    before = with_dynamics('<dynamics damping="9" friction="8" stiction="7"/>')
    after = with_effects(before, [DRY])
    assert after == before.replace('friction="8"', 'friction="1.5"')


def test_levels_of_dry_friction_add_up() -> None:
    stribeck = effect("stribeck_friction", "joint2", level=2.0, excess=1.0, speed=0.1)
    assert friction(with_effects(ARM, [DRY, stribeck]), "joint2")[1] == 3.5


def test_effects_that_a_urdf_cannot_say_change_nothing() -> None:
    others = [effect("spring", "joint2", stiffness=1.0, equilibrium=0.0), effect("effort_delay", delay=0.01)]
    assert with_effects(ARM, others) == ARM


def test_a_payload_is_a_link_of_its_own() -> None:
    after = with_effects(ARM, [effect("payload", "tool", **PAYLOAD)])
    before = Robot(ARM).bodies[-1].parameters
    loaded = Robot(after)
    assert loaded.bodies[-1].merged[-1] == "tool_payload"
    inertia = np.array([[PAYLOAD["i" + "".join(sorted(row + column))] for column in "xyz"] for row in "xyz"])
    body = pin.Inertia(PAYLOAD["mass"], np.array([PAYLOAD[f"com_{axis}"] for axis in "xyz"]), inertia)
    frames = pin.buildModelFromXML(ARM)
    head = frames.frames[frames.getFrameId(loaded.bodies[-1].name)].placement
    tool = frames.frames[frames.getFrameId("tool")].placement
    expected = head.actInv(tool).act(body).toDynamicParameters()
    np.testing.assert_allclose(loaded.bodies[-1].parameters - before, expected, atol=1e-8)
    links = re.compile(r"  <link name=\"tool_payload\">.*?</joint>\n", re.DOTALL)
    assert links.sub("", after) == ARM


def test_a_second_payload_has_another_name() -> None:
    once = with_effects(ARM, [effect("payload", "tool", **PAYLOAD)])
    twice = with_effects(once, [effect("payload", "tool", **PAYLOAD)])
    mass = Robot(ARM).bodies[-1].parameters[0]
    assert Robot(twice).bodies[-1].parameters[0] == pytest.approx(mass + 2 * PAYLOAD["mass"])
