"""Which numbers of a body are identified: the rule, and what it says of planted robots."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from files.estimates import estimate_of, link_estimate
from files.recordings import BAGS

from estimation.arms import arm, motion, samples, summary
from geomid_ros.estimation.estimate import (
    QUANTITIES,
    Estimate,
    LinksInformation,
    identified,
    interval_of_positive,
    quantities_and_moments,
    sizes,
)
from geomid_ros.estimation.estimator import EstimatorSettings, estimate
from geomid_ros.estimation.starting_point import DEFAULT_PRIOR_STD
from geomid_ros.estimation.suggested_motions import FAST, POSES, TILTED, suggested_motions
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.effects import identifiable
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.weighed_masses import WeighedMass

BODY = link_estimate("link").parameters
ANY = np.full(13, np.inf)


def test_an_interval_that_ends_within_a_fifth() -> None:
    """The interval that is shown, along the geodesic, decides."""
    for share, known in ((0.09, True), (0.096, False)):
        deviation = share * BODY[0]
        assert identified(BODY, np.append(deviation, np.zeros(12)), ANY)[0] == known
        assert (interval_of_positive(float(BODY[0]), deviation)[1] < 1.2 * BODY[0]) == known


def test_a_narrow_prior_identifies_nothing() -> None:
    deviations = 0.01 * sizes(BODY)
    assert np.all(identified(BODY, deviations, ANY))
    assert np.all(identified(BODY, deviations, 1.001 * deviations))
    assert not np.any(identified(BODY, deviations, 0.999 * deviations))


def test_what_may_be_zero_is_compared_with_the_body() -> None:
    """A ball at the link's origin: its centre and its products of inertia are zero."""
    ball = pseudo_inertia.assemble(np.array(2.0), np.zeros(3), 0.02 * np.eye(3))
    assert np.allclose(quantities_and_moments(ball), [2.0, 0, 0, 0, 0.02, 0, 0.02, 0, 0, 0.02, 0, 0, 0])
    radius = np.sqrt(1.5 * 0.02 / 2.0)  # half of the trace over the mass, squared
    assert np.allclose(sizes(ball), [2.0, *3 * [radius], *6 * [0.02], *3 * [2.0 * radius]])


@pytest.mark.parametrize(("kilogram", "metre"), [(1000.0, 1.0), (1.0, 1000.0)])
def test_units_do_not_matter(kilogram: float, metre: float) -> None:
    """Deviations about the bound, in grams or millimetres."""
    factors = kilogram * np.array([1.0, *3 * [1.0 / kilogram], *7 * [1.0], 1.0, 1.0])
    factors *= metre ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2, 1, 1, 1])
    in_units = pseudo_inertia.parameters_of(factors[:10] * pseudo_inertia.quantities_of(BODY))
    deviations = np.random.default_rng(0).uniform(0.05, 0.15, 13) * sizes(BODY)
    known = identified(BODY, deviations, ANY)
    assert 0 < np.count_nonzero(known) < 13
    assert np.array_equal(identified(in_units, factors * deviations, ANY), known)


@cache
def solved(factor: float, known: tuple[WeighedMass, ...] = (), first: int = 2) -> Estimate:
    """The small arm with links from the ``first`` on, the last one alone, that are so many times as heavy as in its
    URDF."""
    case = arm("arm3", 0)
    parameters = case.model.nominal_parameters.copy()
    parameters[10 * first : 30] *= factor
    rows = case.model.rows(case.samples)
    noise = 1e-3 * np.random.default_rng(1).normal(size=rows.targets.shape)
    seen = summary(case.model, rows.coefficients, rows.coefficients @ parameters + noise)
    return estimate(case.model, seen, EstimatorSettings(known=known))


def test_a_link_that_left_its_prior_is_not_identified_however_sure_it_is() -> None:
    usual, changed = (solved(factor).links[-1] for factor in (1.0, 5.0))
    assert not usual.outlier
    assert "mass" not in usual.cannot_tell
    assert set(usual.moments)
    assert changed.outlier
    assert changed.std_mass < 0.09 * changed.mass
    assert "mass" not in changed.cannot_tell, "the data say so"
    assert changed.identified == ()
    assert changed.moments == ()
    assert changed.std_prior[0] / changed.mass == pytest.approx(DEFAULT_PRIOR_STD), "the data are compared with that"
    assert usual.identified == tuple(name for name in QUANTITIES if name not in usual.cannot_tell)


def test_links_that_left_their_priors_are_in_one_warning() -> None:
    (warning,) = (text for text in solved(30.0, first=1).warnings if "from the URDF" in text)
    for number in (2, 3):
        assert re.search(rf"'link{number}' from \S+ to \S+ kg \(\S+ default prior std\)", warning)
    assert not solved(1.0).warnings


HOIST = """<robot name="hoist"><link name="frame"/><link name="hook"><inertial><mass value="60"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="lift" type="prismatic"><parent link="frame"/><child link="hook"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1000" velocity="1"/></joint></robot>"""


def test_a_counterweight_may_be_a_link_that_is_too_light_and_is_not_kept_silent() -> None:
    """No motion tells them apart: 48 kg beside a counterweight of 33 kg, whose weight is an offset of the effort, feel
    as 15 kg beside a heavier rotor do."""
    model = MeasurementModel(Robot(HOIST), [identifiable()[name] for name in ("rotor_inertia", "effort_offset")])
    moving = motion(np.random.default_rng(0), 1, 20.0)
    true = np.concatenate([48.0 / 60.0 * model.nominal_inertias, [33.0 + 20.0, -33.0 * 9.81]])
    rows = model.rows(samples(moving, np.zeros((len(moving), 1))))
    noise = np.random.default_rng(1).normal(size=rows.targets.shape)
    found = estimate(model, summary(model, rows.coefficients, rows.coefficients @ true + noise), EstimatorSettings())
    (hook,), effects = found.links, {effect.name: effect for effect in found.effects}
    assert abs(hook.mass - 48.0) < 4.0 * hook.std_mass
    assert abs(effects["rotor_inertia"].value - 53.0) < 4.0 * effects["rotor_inertia"].std
    assert abs(effects["effort_offset"].value + 33.0 * 9.81) < 4.0 * effects["effort_offset"].std
    assert any("'hook' from 60 to" in text for text in found.warnings)


def test_what_is_identified_is_right_where_the_urdf_is_three_times_as_wrong_as_usual() -> None:
    """The data say it, not the prior: no number of a planted arm is off by more than a fifth."""
    count = 0
    for seed in range(6):
        case = arm("arm3", seed, size=0.6)
        rows = case.model.rows(case.samples)
        found = estimate(case.model, summary(case.model, rows.coefficients, rows.targets), EstimatorSettings())
        for link, true in zip(found.links, case.true.links, strict=True):
            known = np.array([name in link.identified for name in QUANTITIES])
            errors = np.abs(quantities_and_moments(link.parameters) - quantities_and_moments(true)) / sizes(true)
            assert np.all(errors[:10][known] < 0.2), (seed, link.name)
            count += np.count_nonzero(known)
    assert count > 5


def test_a_scale_identifies_a_mass() -> None:
    """The second link's, which the joints of this arm do not feel apart from the first one's."""
    assert "mass" in solved(1.0).links[0].cannot_tell
    name = solved(1.0).links[0].name
    weighed = WeighedMass((name,), 2.0, 0.01)
    assert "mass" not in solved(1.0, (weighed,)).links[0].cannot_tell


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


def test_every_quantity_is_told_by_one_motion_or_by_none() -> None:
    bare = suggested_motions(*problem())
    for motions in bare.values():
        assert sorted(name for names in motions.values() for name in names) == sorted(QUANTITIES)
        assert set(motions) <= {POSES, FAST, TILTED, ""}
    assert POSES not in bare["link1"], "gravity has no torque about an upright axis"
    assert "mass" in bare["link1"][""]
    fast = {name for motions in bare.values() for name in motions.get(FAST, [])}
    assert any(name.startswith("I") for name in fast), "fast motion tells moments of inertia"


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
