"""Real recordings, where they are at hand: sound ones are not doubted, what is wrong with others is named."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import pytest

from benchmarks.measured_data import DATA
from geomid_ros.checks.causes import RecordingFault
from geomid_ros.errors import InputError
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, read_bags
from geomid_ros.session.session import Session

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured recordings are not at {DATA}")

UR10 = ("ur10_unisa_rosbag2/ur10.urdf", "ur10_unisa_rosbag2/ur10_exciting_trajectory")
AIRBOT = "airbot_play/airbot_play.urdf"
ROKAE = ("rokae_ar5_tilted/AR5-5_07R-W4C4A2.urdf", "rokae_ar5_tilted/real")
LWR4 = "kuka_lwr4_hw/kuka_lwr4.urdf"
SOUND = {
    "ur10": (*UR10, {}),
    "airbot": (AIRBOT, "airbot_play/chirp", {}),
    "airbot trapez": (AIRBOT, "airbot_play/trapez", {}),
    "rokae": (*ROKAE, {"gravity": [9.88, -0.165, -0.141]}),
    # The last joint's efforts are as if those of others: each of many causes leaves another joint worse explained.
    "lwr4 1": (LWR4, "kuka_lwr4_hw/measurements_1", {}),
    "kr300 A": ("kuka_kr300/kr300.urdf", "kuka_kr300/FF_A", {}),
    "med7": ("kuka_med7/med7.urdf", "kuka_med7/measurements", {}),
    "tx40": ("staubli_tx40/tx40.urdf", "staubli_tx40/tx40", {}),
}


@cache
def found(urdf: str, bag: str, settings: tuple[tuple[str, Any], ...]) -> tuple[RecordingFault, ...]:
    configuration = Configuration({key: list(v) if isinstance(v, tuple) else v for key, v in settings})
    session = Session(read_urdf(DATA / urdf), configuration, urdf)
    read_bags(session, Bags(fitted=[DATA / bag]), lambda _: None)
    return session.review.findings


def findings(urdf: str, bag: str, settings: Mapping[str, Any]) -> tuple[RecordingFault, ...]:
    frozen = tuple((key, tuple(v) if isinstance(v, list) else v) for key, v in settings.items())
    return found(urdf, bag, frozen)


@pytest.mark.parametrize("name", SOUND)
def test_a_sound_recording_is_not_doubted(name: str) -> None:
    assert findings(*SOUND[name]) == ()


def test_a_recording_with_the_signs_of_its_driver() -> None:
    (finding,) = findings("kuka_med7/med7.urdf", "kuka_med7/raw_sign", {})
    assert finding.sure
    assert finding.cause.settings == {"effort_gain": -1.0}


def test_a_robot_on_its_side_of_which_nobody_says_so() -> None:
    (finding,) = findings(*ROKAE, {})
    assert finding.sure
    assert finding.cause.settings["gravity"] == pytest.approx([9.81, -0.17, -0.17], abs=0.1)


@pytest.mark.parametrize(
    "configured",
    [(0.0, 6.94, -6.94), (9.19, -3.44, 0.0)],
)
def test_gravity_is_fitted_together_with_links_that_are_far_from_the_urdf(configured: tuple[float, ...]) -> None:
    (finding,) = findings("kuka_kr300/kr300.urdf", "kuka_kr300/FF_B", {"gravity": configured})
    assert finding.sure
    directions = [cause.settings.get("gravity") for cause in (finding.cause, *finding.rivals)]
    assert any(direction == pytest.approx([0.0, 0.0, -9.81], abs=2.0) for direction in directions)


def test_an_effort_too_small_for_any_plausible_link_is_in_another_unit() -> None:
    """By the URDF this joint of the wrist would hardly feel anything, either."""
    urdf, bag, settings = SOUND["tx40"]
    (finding,) = findings(urdf, bag, settings | {"joint.joint_4.effort_gain": 0.01})
    assert finding.sure
    assert (finding.cause.kind, finding.cause.places) == ("gain", ("joint_4",))


@pytest.mark.parametrize("name", ["ur10", "rokae"])
def test_a_gain_of_the_wrong_sign(name: str) -> None:
    urdf, bag, settings = SOUND[name]
    (finding,) = findings(urdf, bag, settings | {"effort_gain": -1.0})
    assert finding.sure
    assert finding.cause.settings == {"effort_gain": 1.0}


def test_a_wrist_that_fits_nothing_hides_no_sign_of_another_joint() -> None:
    urdf, bag, settings = SOUND["lwr4 1"]
    (finding,) = findings(urdf, bag, settings | {"joint.lwr_0_joint.effort_gain": -1.0})
    assert finding.sure
    assert (finding.cause.kind, finding.cause.places) == ("sign", ("lwr_0_joint",))


def test_joints_of_another_name_are_refused() -> None:
    with pytest.raises(InputError, match="panda_joint1"):
        findings("panda_unisa_rosbag2/panda_nohand.urdf", "panda_unisa_rosbag2/panda_exciting_trajectory", {})


def amperes(joints: int, seed: int) -> dict[str, float]:
    """Factors of the joints of an arm whose motors' currents are sent."""
    gains = np.random.default_rng(seed).uniform(8.0, 15.0, joints)
    return {f"joint.joint{joint + 1}.effort_gain": float(1.0 / gain) for joint, gain in enumerate(gains)}


@pytest.mark.parametrize(
    ("urdf", "bag", "settings"),
    [
        ("kuka_kr300/kr300.urdf", "kuka_kr300/FF_B", {"effort_gain": 0.07}),  # hardly any joint follows its links
        (*SOUND["tx40"][:2], {"effort_gain": 0.1}),  # a motor turns two joints
        (AIRBOT, "airbot_play/chirp", amperes(6, 1)),  # doubled stamps explain more, but not such light links
    ],
)
def test_another_unit_is_named_whatever_else_gains_by_it(urdf: str, bag: str, settings: Mapping[str, Any]) -> None:
    kinds = [cause.kind for finding in findings(urdf, bag, settings) for cause in (finding.cause, *finding.rivals)]
    assert kinds[:1] == ["gain"]
