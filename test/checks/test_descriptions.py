"""What no robot can be is told of its URDF, whatever was measured."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from estimation.arms import efforts as feels
from estimation.arms import motion as moving
from estimation.arms import samples, shipped, truth

from checks.test_efforts import findings, named
from geomid_ros.checks.effort_data import EffortData
from geomid_ros.checks.unexplained import hint
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples


def grams(urdf: str) -> str:
    return re.sub(r'<mass value="([^"]+)"', lambda found: f'<mass value="{1000.0 * float(found[1])}"', urdf)


def millimetres(urdf: str) -> str:
    def scaled(found: re.Match[str]) -> str:
        return found[1] + " ".join(str(1000.0 * float(entry)) for entry in found[2].split())

    return re.sub(r'(<inertial>\s*<origin[^>]*xyz=")([^"]+)', scaled, urdf)


def gram_square_millimetres(urdf: str) -> str:
    def scaled(found: re.Match[str]) -> str:
        return f'{found[1]}"{1e9 * float(found[2])}"'

    return re.sub(r'( i[xyz][xyz]=)"([^"]+)"', scaled, urdf)


@cache
def recorded(name: str) -> Samples:
    """What a robot sends whose URDF is right."""
    right = Robot(shipped(name))
    motion = moving(np.random.default_rng(6), len(right.joints), 20.0)
    return samples(motion, feels(right, truth(np.random.default_rng(5), right), motion))


@pytest.mark.parametrize(
    ("name", "spoil", "said", "limits"),
    [
        ("arm3", grams, "in grams", False),
        ("arm7", grams, "in grams", True),
        ("arm3", millimetres, "in mm", True),
        ("arm7", gram_square_millimetres, "in g mm^2", False),
    ],
)
def test_units_of_a_urdf_are_named(name: str, spoil: Callable[[str], str], said: str, limits: bool) -> None:
    urdf = spoil(shipped(name))
    assert urdf != shipped(name)
    without = urdf if limits else re.sub(r'effort="[^"]+"', 'effort="0"', urdf)
    cause = named(MeasurementModel(Robot(without), ()), recorded(name))
    assert cause.kind == "description"
    assert said in cause.sentence


LIMBS = "".join(
    f'<link name="limb{k}"/><joint name="hip{k}" type="fixed"><parent link="{Robot(shipped("arm3")).tree.root}"/>'
    f'<child link="limb{k}"/><origin xyz="0 {k} -1"/></joint>'
    for k in range(10)
)
SOUND = {
    "a limit below the recorded efforts says nothing of masses": lambda urdf: re.sub(
        r'effort="[^"]+"', 'effort="0.05"', urdf
    ),
    "limbs that do not move, of a humanoid, say nothing of the lengths of those that do": lambda urdf: urdf.replace(
        "</robot>", f"{LIMBS}</robot>"
    ),
    "moments that are too small, as of bodies denser than steel, are no masses in grams": lambda urdf: re.sub(
        r'( i[xyz][xyz]=)"([^"]+)"', lambda found: f'{found[1]}"{0.1 * float(found[2])}"', urdf
    ),
}


@pytest.mark.parametrize("case", SOUND)
def test_what_a_robot_can_be_is_not_doubted(case: str) -> None:
    assert findings(MeasurementModel(Robot(SOUND[case](shipped("arm3"))), ()), recorded("arm3")) == ()


def test_a_joint_that_moves_no_mass_is_not_compared_with_its_effort() -> None:
    """Its unit, sign and name are unknown; if it is not explained, its link's mass is missing."""
    before, last = shipped("arm3").split('<link name="link3">')
    without = Robot(before + '<link name="link3">' + re.sub(r"<inertial>.*?</inertial>", "", last, flags=re.DOTALL))
    assert findings(MeasurementModel(without, ()), recorded("arm3")) == ()
    (joint,) = set(without.joint_names) - set(EffortData.of_all(without, recorded("arm3")).names)
    assert "has a mass in the URDF" in hint(EffortData.of_all(without, recorded("arm3")), joint, 1.0)
