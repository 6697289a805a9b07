"""Whether a result can be used, and which channels it predicts worse than the URDF."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from estimation.arms import Case, arm
from model.robots import urdf

from geomid_ros.checks.causes import Cause, RecordingFault
from geomid_ros.checks.verdict import Verdict, poorly_predicted, verdict, worse_channels
from geomid_ros.estimation.estimate import Estimate, WeighedEstimate
from geomid_ros.estimation.identifier import Identifier
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.moving_base import Contact
from geomid_ros.model.robot import Robot
from geomid_ros.types import FloatArray

FINDING = RecordingFault(cause=Cause(kind="sign", sentence="all is reversed"), sure=False)


@cache
def solved() -> tuple[Case, Estimate]:
    case = arm("arm3", 3)
    identifier = Identifier(case.model)
    identifier.add(case.samples)
    return case, identifier.solve()


def judged(estimate: Estimate, *findings: RecordingFault) -> Verdict:
    return verdict(estimate, findings, solved()[0].model)


def test_the_exit_status() -> None:
    _, estimate = solved()
    ended = replace(estimate, converged=False, reason="too many steps")
    assert judged(estimate) == Verdict(word="usable")
    assert judged(estimate).status == 0
    assert judged(ended).status == 3
    assert judged(estimate, FINDING).status == judged(ended, FINDING).status == 4
    assert judged(estimate, FINDING).reasons == (FINDING.sentence,)


def weighing(estimate: Estimate, factor: float) -> Estimate:
    """With links that weigh so many times as much."""
    links = [replace(k, parameters=factor * k.parameters) for k in estimate.links]
    return replace(estimate, links=tuple(links))


@pytest.mark.parametrize(("factor", "status"), [(1.0, 0), (1.5, 0), (0.6, 0), (3.0, 4), (0.3, 4), (40.0, 4)])
def test_masses_beyond_reason_are_doubted(factor: float, status: int) -> None:
    """Twice the URDF's in all, or half of it."""
    _, estimate = solved()
    result = judged(weighing(estimate, factor))
    assert result.status == status
    assert any("total link mass" in reason for reason in result.reasons) == (status == 4)


@pytest.mark.parametrize(("contacts", "status"), [((), 0), (("FL_foot", "RR_foot"), 4)])
def test_legs_do_not_carry_what_no_such_robot_weighs(contacts: tuple[str, ...], status: int) -> None:
    """Only a sensor that carries a robot has weighed it."""
    _, estimate = solved()
    robot = Robot(urdf("go2.urdf"), floating_base=True)
    plate = [] if contacts else [WrenchSensor("/plate", "odom", "external")]
    model = MeasurementModel(robot, [], plate, contacts=[Contact(foot) for foot in contacts])
    factor = 3.0 * np.sum(model.nominal_inertias[::10]) / sum(link.mass for link in estimate.links)
    assert verdict(weighing(estimate, factor), (), model).status == status


def test_what_else_is_said_of_a_result() -> None:
    """What was weighed may weigh anything; what no link can be is doubted; missing efforts are told."""
    case, estimate = solved()
    scale = WeighedEstimate(name="total", given=15.0, given_std=0.1, mass=15.0, std=0.1)
    assert judged(replace(weighing(estimate, 3.0), known=(scale,))).status == 0
    result = verdict(estimate, (), case.model, doubts=["link 'link2' is lead"])
    assert (result.status, result.reasons) == (4, ("link 'link2' is lead",))
    (warning,) = verdict(estimate, (), case.model, unmeasured=["joint2"]).warnings
    assert "'joint2'" in warning


def with_rotor(parameters: FloatArray) -> FloatArray:
    """With a rotor inertia at joint 2 that is far too large."""
    case, _ = solved()
    wrong = parameters.copy()
    place = next(
        10 * len(case.model.identified) + k
        for k, c in enumerate(case.model.coefficients)
        if (c.effect.name, c.place_name) == ("rotor_inertia", "joint2")
    )
    wrong[place] += 200.0
    return wrong


def test_a_channel_that_is_worse_than_by_the_urdf_is_named_wherever_it_is_measured() -> None:
    """A leg is in the air for a quarter of the time."""
    case, estimate = solved()
    held_out = case.fresh(9).samples
    effort = held_out.effort.copy()
    effort[len(held_out) // 4 :, 1] = np.nan
    never = replace(held_out, effort=np.full_like(effort, np.nan))
    wrong = estimate.predictor._replace(parameters=with_rotor(estimate.parameters))
    for recorded in (held_out, replace(held_out, effort=effort)):
        assert worse_channels(case.model, [recorded], estimate.predictor) == []
        assert worse_channels(case.model, [recorded], wrong) == ["joint2"]
    assert worse_channels(case.model, [never], wrong) == []


def test_what_goes_on_otherwise_is_told() -> None:
    """Twice as bad is another motion; ten times is named, with the channel alone."""
    _, estimate = solved()
    assert poorly_predicted(estimate, 2.0 * estimate.rms) == []
    assert poorly_predicted(estimate, np.full(len(estimate.rms), np.nan)) == []
    (sentence,) = poorly_predicted(estimate, np.where(np.arange(3) == 1, 10.0, 1.0) * estimate.rms)
    assert f"'{estimate.channels[1]}' (10 times)" in sentence
    assert not any(f"'{estimate.channels[c]}'" in sentence for c in (0, 2))
    assert "--hold-out 0" in sentence
