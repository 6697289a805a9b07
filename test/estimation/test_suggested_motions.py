"""Which motion tells what: by mechanics, not by the numbers of a solve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from files.estimates import estimate_of, link_estimate
from files.recordings import BAGS

from geomid_ros.estimation.estimate import Estimate, LinksInformation
from geomid_ros.estimation.suggested_motions import FAST, POSES, TILTED, suggested_motions
from geomid_ros.estimation.uncertain_inertia import QUANTITIES
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.robot import Robot

NOISE = 1e-4  # [N m, N]: whatever acts at all is seen


def problem(*sensors: WrenchSensor) -> tuple[MeasurementModel, Estimate]:
    """The small arm, upright on a table, of which nothing is known but the prior."""
    robot = Robot((BAGS / "arm3.urdf").read_text(), cuts=[sensor.frame for sensor in sensors])
    model = MeasurementModel(robot, [], sensors)
    links = [replace(link_estimate(name), cannot_tell=QUANTITIES) for name in model.body_names]
    size = 10 * len(links)
    nothing = LinksInformation(np.zeros((size, size)), np.zeros(size))
    sigmas = np.full(len(model.channels), NOISE)
    made = replace(estimate_of(*links), sigmas=sigmas, information=nothing, parameters=model.nominal_parameters)
    return model, made


@pytest.fixture(scope="module")
def bare() -> dict[str, dict[str, list[str]]]:
    return suggested_motions(*problem())


def test_every_quantity_is_told_by_one_motion_or_by_none(bare: dict[str, dict[str, list[str]]]) -> None:
    for motions in bare.values():
        assert sorted(name for names in motions.values() for name in names) == sorted(QUANTITIES)
        assert set(motions) <= {POSES, FAST, TILTED, ""}


def test_a_link_on_an_upright_axis_weighs_what_no_torque_feels(bare: dict[str, dict[str, list[str]]]) -> None:
    first = bare["link1"]
    assert POSES not in first, "gravity has no torque about an upright axis"
    assert "mass" in first[""]


def test_fast_motion_tells_moments_of_inertia(bare: dict[str, dict[str, list[str]]]) -> None:
    fast = {name for motions in bare.values() for name in motions.get(FAST, [])}
    assert any(name.startswith("I") for name in fast)


def test_a_wrist_sensor_weighs_what_is_beyond_it_in_any_pose() -> None:
    found = suggested_motions(*problem(WrenchSensor("/wrench", "wrist_ft", "mounted")))
    assert {"mass", "com x", "com y", "com z"} <= set(found["wrist_ft"][POSES])


def test_what_is_told_needs_no_motion() -> None:
    model, estimate = problem()
    told = replace(estimate, links=tuple(replace(link, cannot_tell=()) for link in estimate.links))
    assert suggested_motions(model, told) == {link.name: {} for link in estimate.links}


def test_noise_hides_everything() -> None:
    model, estimate = problem()
    loud = replace(estimate, sigmas=np.full(len(model.channels), 1e6))
    assert all(set(motions) == {""} for motions in suggested_motions(model, loud).values())
