"""What no robot can be is told of its URDF, whatever was measured."""

from __future__ import annotations

import re

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


@pytest.mark.parametrize(
    ("spoil", "said"), [(grams, "in grams"), (millimetres, "in mm"), (gram_square_millimetres, "in g mm^2")]
)
@pytest.mark.parametrize("limits", [True, False])
@pytest.mark.parametrize("name", ["arm3", "arm7"])
def test_units_of_a_urdf_are_named(name: str, spoil, said: str, limits: bool) -> None:  # type: ignore[no-untyped-def]
    right = Robot(shipped(name))
    motion = moving(np.random.default_rng(6), len(right.joints), 20.0)
    effort = feels(right, truth(np.random.default_rng(5), right), motion)
    urdf = spoil(shipped(name))
    assert urdf != shipped(name)
    without = urdf if limits else re.sub(r'effort="[^"]+"', 'effort="0"', urdf)
    cause = named(MeasurementModel(Robot(without), ()), samples(motion, effort))
    assert cause.kind == "description"
    assert said in cause.sentence


def test_a_limit_below_the_recorded_efforts_says_nothing_of_masses() -> None:
    right = Robot(shipped("arm3"))
    motion = moving(np.random.default_rng(6), len(right.joints), 20.0)
    effort = feels(right, truth(np.random.default_rng(5), right), motion)
    model = MeasurementModel(Robot(re.sub(r'effort="[^"]+"', 'effort="0.05"', shipped("arm3"))), ())
    assert findings(model, samples(motion, effort)) == ()


def test_limbs_that_do_not_move_say_nothing_of_the_lengths_of_those_that_do() -> None:
    """The arm of a humanoid whose legs and other arm are locked is much lighter than the robot is long."""
    right = Robot(shipped("arm3"))
    motion = moving(np.random.default_rng(6), len(right.joints), 20.0)
    effort = feels(right, truth(np.random.default_rng(5), right), motion)
    limbs = "".join(
        f'<link name="limb{k}"/><joint name="hip{k}" type="fixed"><parent link="{right.tree.root}"/>'
        f'<child link="limb{k}"/><origin xyz="0 {k} -1"/></joint>'
        for k in range(10)
    )
    model = MeasurementModel(Robot(shipped("arm3").replace("</robot>", f"{limbs}</robot>")), ())
    assert findings(model, samples(motion, effort)) == ()


def test_moments_that_are_too_small_are_no_masses_in_grams() -> None:
    """They are those of bodies denser than steel, as are moments that were raised to what a mass needs at least."""
    right = Robot(shipped("arm3"))
    motion = moving(np.random.default_rng(6), len(right.joints), 20.0)
    effort = feels(right, truth(np.random.default_rng(5), right), motion)
    small = re.sub(r'( i[xyz][xyz]=)"([^"]+)"', lambda found: f'{found[1]}"{0.1 * float(found[2])}"', shipped("arm3"))
    assert findings(MeasurementModel(Robot(small), ()), samples(motion, effort)) == ()


def test_a_joint_that_moves_no_mass_is_not_compared_with_its_effort() -> None:
    """Its unit, sign and name are unknown; if it is not explained, its link's mass is missing."""
    right = Robot(shipped("arm3"))
    motion = moving(np.random.default_rng(6), len(right.joints), 20.0)
    recorded = samples(motion, feels(right, truth(np.random.default_rng(5), right), motion))
    before, last = shipped("arm3").split('<link name="link3">')
    without = Robot(before + '<link name="link3">' + re.sub(r"<inertial>.*?</inertial>", "", last, flags=re.DOTALL))
    assert len(without.bodies) == len(right.bodies) - 1
    assert findings(MeasurementModel(without, ()), recorded) == ()
    (joint,) = set(without.joint_names) - set(EffortData.of_all(without, recorded).names)
    assert "has a mass in the URDF" in hint(EffortData.of_all(without, recorded), joint, 1.0)
