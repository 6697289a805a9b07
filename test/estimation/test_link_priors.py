"""Parts that are alike: a common error is told by any of them, and one that is unlike the others is let go."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, partial
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from model.robots import urdf

from geomid_ros.estimation import fit
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import EstimatorSettings
from geomid_ros.estimation.fit import Fit
from geomid_ros.estimation.identifier import Identifier
from geomid_ros.estimation.link_priors import AlikePrior, fit_with_coupled_prior
from geomid_ros.estimation.objective import ResidualObjective
from geomid_ros.estimation.problem import Problem
from geomid_ros.estimation.tolerances import SETTLED
from geomid_ros.files.models.readers import ELEMENTS
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.alike_parts import AlikeParts, alike_parts
from geomid_ros.model.effects import identifiable
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.weighed_masses import weighed_rows
from geomid_ros.types import FloatArray

from .arms import Truth, efforts, motion, samples

THIGHS = ("FL_thigh", "FR_thigh", "RL_thigh", "RR_thigh")
LEGS = ("FL", "FR", "RL", "RR")
HEAVIER = 1.4


@cache
def quadruped() -> MeasurementModel:
    """A Go2 that hangs from its trunk."""
    return MeasurementModel(Robot(urdf("go2.urdf")), [])


@cache
def parts() -> tuple[AlikeParts, ...]:
    return alike_parts(quadruped().robot, quadruped().identified)


def nominal() -> FloatArray:
    return np.array([body.parameters for body in quadruped().robot.bodies])


def identifier(heavy: tuple[str, ...], legs: tuple[str, ...], alike: bool) -> Identifier:
    """That was told the efforts of some ``legs`` of a robot with ``heavy`` links."""
    model, rng = quadruped(), np.random.default_rng(5)
    robot, links = model.robot, nominal()
    for name in heavy:
        links[robot.body_names.index(name)] *= HEAVIER
    moving = motion(rng, len(robot.joints), 10.0, rate=50.0)
    measured = efforts(robot, Truth(links, {}), moving)
    measured += 0.05 * rng.normal(size=measured.shape)
    measured[:, [name[:2] not in legs for name in robot.joint_names]] = np.nan
    result = Identifier(model, EstimatorSettings(alike=parts() if alike else ()))
    result.add(samples(moving, measured, rate=50.0))
    return result


@cache
def solved(heavy: tuple[str, ...], legs: tuple[str, ...], alike: bool) -> Estimate:
    """Its estimate."""
    return identifier(heavy, legs, alike).solve()


def alike_prior(links: FloatArray | None = None) -> AlikePrior:
    """Of a problem whose rows do not matter, with ``links (bodies, 10)`` that are not those of the URDF."""
    model, summary = quadruped(), identifier((), ("FL",), False).snapshot()
    known, sigmas = weighed_rows(model, ()), np.full(len(model.channels), np.nan)
    given = None if links is None else np.append(links, np.full(len(model.coefficients), np.nan))
    return AlikePrior.of(parts(), Problem(model, summary, given, known, sigmas, None, 1.0))


def masses(found: Estimate) -> dict[str, float]:
    """Relative to the URDF's."""
    by_name = dict(zip(quadruped().robot.body_names, nominal()[:, 0], strict=True))
    return {link.name: link.mass / by_name[link.name] for link in found.links}


@pytest.mark.usefixtures("either")
def test_parts_may_be_thin() -> None:
    """A hundred-thousandth in a direction askew to the frame, as some URDFs have them: what rounding leaves of the rows
    that hold them together is still a prior."""
    second = 1e-3 * np.array([[0.5, 0.0, 0.5], [0.0, 0.6, 0.0], [0.5, 0.0, 0.5]]) + 1e-13 * np.eye(3)
    central = np.trace(second) * np.eye(3) - second
    links = nominal()
    for name in THIGHS:
        body = links[quadruped().body_names.index(name)]
        body[:] = pseudo_inertia.assemble(body[0], pseudo_inertia.centre_of_mass(body), central)
    own = alike_prior(links)
    root, manifold, prior = own.root(own.trusted), own.problem.manifold, own.problem.prior_point
    products = own.problem_at(prior, own.trusted).known_products
    objective = ResidualObjective(manifold, 0.0 * products, prior, np.ones(manifold.dimension), 1.0, products)
    expected = root.T @ root
    found = objective.evaluate(prior).information[own.columns[:, None], own.columns]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-2 * np.max(expected))


def test_the_covariance_is_that_of_a_common_error_and_of_small_ones() -> None:
    """``s^2 (1 1^T + I / 25)`` in mirrored coordinates: of four parts, to a hundredth."""
    prior = alike_prior()
    root = prior.root(prior.trusted)
    covariance = np.linalg.inv(np.diag(np.repeat(prior.problem.default_stds, 10) ** -2.0) + root.T @ root)
    for group in parts():
        places = [10 * member + 4 for member in group.members]
        signs = group.signs[:, 4]
        found = covariance[np.ix_(places, places)] * np.outer(signs, signs)
        np.testing.assert_allclose(found, 0.04 * (np.ones((4, 4)) + np.eye(4) / 25.0), rtol=0.02)


def test_a_link_of_less_weight_is_held_less() -> None:
    """The rows of ``W - W 1 1^T W / 1^T W 1`` with the precisions W: the common error is integrated out."""
    prior = alike_prior()
    root = prior.root(prior.trusted | {"FR_thigh": 0.3})
    places = [10 * member + 4 for member in parts()[1].members]
    precisions = 25.0 / 0.2**2 * np.array([1.0, 0.3, 1.0, 1.0])
    expected = np.diag(precisions) - np.outer(precisions, precisions) / np.sum(precisions)
    signs = parts()[1].signs[:, 4]
    found = (root.T @ root)[np.ix_(places, places)] * np.outer(signs, signs)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_one_leg_tells_of_the_others() -> None:
    together, alone = (masses(solved(THIGHS, ("FL",), alike)) for alike in (True, False))
    for name in THIGHS[1:]:
        assert alone[name] == pytest.approx(1.0, abs=1e-6)
        assert together[name] == pytest.approx(together[THIGHS[0]], rel=0.03)
    assert together[THIGHS[0]] > 1.2


def test_a_leg_that_was_repaired_is_let_go_and_told() -> None:
    found = solved(THIGHS[1:2], LEGS, True)
    told = [warning for warning in found.warnings if "identical parts" in warning]
    assert len(told) == 1
    assert told[0].startswith("link 'FR_thigh' differs from FL_thigh, RL_thigh, RR_thigh")
    free = solved(THIGHS[1:2], LEGS, False)
    for name in THIGHS:
        assert masses(found)[name] == pytest.approx(masses(free)[name], abs=0.1)


@pytest.mark.parametrize(("std", "told"), [(0.2, "differ from each other"), (0.04, "")])
def test_parts_that_all_differ_are_held_as_little_as_they_are_alike(
    std: float, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their weights are those of the deviations of all together; that of each alone stays near the default."""
    prior = alike_prior()
    off = np.random.default_rng(0).normal(scale=std, size=len(prior.columns))
    monkeypatch.setattr(AlikePrior, "tangent", lambda *_: off)
    monkeypatch.setattr(AlikePrior, "_covariance_root", lambda *_: np.zeros((len(off), 0)))
    weights = prior.weights(cast(Fit, SimpleNamespace(search_point=None)), prior.trusted)
    expected = 4.0 / 3.0 * (0.04 / std) ** 2  # three of the four deviations are independent
    assert np.median([*weights.values()]) == pytest.approx(min(expected, 1.0), rel=0.25)
    warnings = [*prior.release_warnings(weights)]
    assert len(warnings) == bool(told)
    assert all(told in warning for warning in warnings)


def test_a_fit_ends_where_its_prior_is_linearised() -> None:
    """So the rows' residuals there are those of the geodesic prior, and its blocks' weights are those of their
    distances."""
    model, told = quadruped(), identifier(THIGHS[1:2], LEGS, True)
    known, sigmas = weighed_rows(model, ()), np.full(len(model.channels), np.nan)
    prior = AlikePrior.of(parts(), Problem(model, told.snapshot(), None, known, sigmas, None, 1.0))
    found, weights = fit_with_coupled_prior(prior, partial(fit.fit, tolerance=1e-10, max_steps=300))
    rows, point = found.problem.known, found.point
    residuals = rows.rows @ point.parameters - rows.targets
    np.testing.assert_allclose(residuals, prior.root(weights) @ prior.tangent(point), atol=1e-6)
    assert prior.weights(found, weights) == pytest.approx(weights, rel=SETTLED)


def test_parts_that_are_alike_are_not_told_as_unlike() -> None:
    found = solved(THIGHS, LEGS, True)
    assert not [warning for warning in found.warnings if "identical parts" in warning]
    every = np.array([masses(found)[name] for name in THIGHS])
    assert np.ptp(every) < 0.05


def test_what_a_file_lacks_makes_no_part_unlike_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which parts are unlike is decided beside all effects; a file, which lacks the rotors, takes it from there."""
    robot, rng = quadruped().robot, np.random.default_rng(5)
    model = MeasurementModel(robot, [identifiable()["rotor_inertia"]])
    moving = motion(rng, len(robot.joints), 10.0, rate=50.0)
    measured = efforts(robot, Truth(nominal(), {"rotor_inertia": np.full(len(robot.joints), 0.05)}), moving)
    measured += 0.05 * rng.normal(size=measured.shape)
    told = Identifier(model, EstimatorSettings(alike=parts(), files={"urdf": ELEMENTS["urdf"]}))
    told.add(samples(moving, measured, rate=50.0))
    decide, among = AlikePrior.weights, set[int]()

    def decided(prior: AlikePrior, found: Fit, before: Mapping[str, float]) -> dict[str, float]:
        among.add(prior.problem.model.dimension)
        return decide(prior, found, before)

    monkeypatch.setattr(AlikePrior, "weights", decided)
    assert "urdf" in told.solve().within
    assert among == {model.dimension}


def test_a_fit_that_does_not_settle_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    settled = solved(THIGHS[1:2], LEGS, True)
    monkeypatch.setattr(fit, "ROUNDS", 1)
    unsettled = identifier(THIGHS[1:2], LEGS, True).solve()
    told = [any("ran out of steps" in warning for warning in found.warnings) for found in (settled, unsettled)]
    assert told == [False, True]
