"""What the estimate says of its own certainty: linear algebra it must reproduce, and how often it is right."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np
import pytest
from geometry import bodies
from scipy.signal import lfilter

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import QUANTITIES, EstimatorSettings, estimate
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.estimation.uncertainty import (
    LEAST_PRIOR_SPREAD,
    physical_sensitivity,
    physical_values,
    uncertainty,
)
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import FloatArray

from .arms import Case, arm, motion, samples, truth
from .arms import parameters as parameters_of
from .problems import ALL, LINKS

RUNS = 40
NOISE = 0.05


# --- the linear algebra ---------------------------------------------------------------------------------------------


def information(rng: np.random.Generator, size: int, rank: int) -> FloatArray:
    rows = rng.normal(size=(rank, size)) * 10.0 ** rng.uniform(0, 2, size=(rank, 1))
    return rows.T @ rows


def halves(rng: np.random.Generator, total: FloatArray, inflation: float, folds: int = 4) -> list[FloatArray]:
    """Gradients of folds that share the information equally, with noise that is correlated so much."""
    values, vectors = np.linalg.eigh(total)
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    return [root @ rng.normal(size=len(total)) * np.sqrt(inflation / folds) for _ in range(folds)]


def test_without_a_prior_the_covariance_is_the_inverse_information() -> None:
    rng = np.random.default_rng(0)
    fisher = information(rng, 6, 20)
    found = uncertainty(fisher, 1e-9, [], np.zeros(6))
    np.testing.assert_allclose(found.covariance, np.linalg.inv(fisher), rtol=1e-6)
    np.testing.assert_allclose(found.resolution, np.eye(6), rtol=0, atol=1e-9)


def test_without_data_the_prior_spread_is_all_there_is() -> None:
    found = uncertainty(np.zeros((6, 6)), 2.0, [], np.zeros(6))
    np.testing.assert_allclose(found.covariance, LEAST_PRIOR_SPREAD**2 * np.eye(6), rtol=1e-12)
    np.testing.assert_array_equal(found.resolution, np.zeros((6, 6)))


def test_directions_no_row_touches_have_the_priors_spread_and_resolution_counts_the_others() -> None:
    rng = np.random.default_rng(1)
    found = uncertainty(information(rng, 8, 3), 1e-6, [], np.zeros(8))
    assert np.trace(found.resolution) == pytest.approx(3.0, abs=1e-4)
    values = np.linalg.eigvalsh(found.covariance)
    np.testing.assert_allclose(values[3:], LEAST_PRIOR_SPREAD**2, rtol=1e-6)


def test_the_spread_is_what_told_directions_have_moved() -> None:
    fisher = np.diag([1e6, 1e6, 1e6, 0.0])
    found = uncertainty(fisher, 1.0, [], np.array([0.3, -0.4, 0.0, 0.0]))
    assert found.prior_spread == pytest.approx(0.5 / np.sqrt(3.0), rel=1e-4)
    assert found.covariance[3, 3] == pytest.approx(found.prior_spread**2, rel=1e-4)


@pytest.mark.parametrize("correlation", [1.0, 4.0, 25.0])
def test_scattering_folds_inflate_the_covariance(correlation: float) -> None:
    rng = np.random.default_rng(2)
    fisher = information(rng, 30, 60)
    base = np.trace(uncertainty(fisher, 1e-6, [], np.zeros(30)).covariance)
    ratios = [
        np.trace(uncertainty(fisher, 1e-6, halves(rng, fisher, correlation), np.zeros(30)).covariance) / base
        for _ in range(50)
    ]
    assert np.mean(ratios) == pytest.approx(correlation, rel=0.15)


@pytest.mark.parametrize("manifold", [ALL, LINKS], ids=["all", "links"])
def test_sensitivities_are_the_derivatives_of_mass_centre_and_central_inertia(manifold: object) -> None:
    """By finite differences of another kind: of a cloud's own sums, moved by congruence."""
    rng = np.random.default_rng(3)
    point = bodies.point(rng, manifold)
    found = physical_sensitivity(manifold, point)
    for _ in range(5):
        tangent, step = rng.normal(size=manifold.dimension), 1e-6
        ahead, behind = (physical_values(manifold.exp(point, sign * step * tangent)) for sign in (1.0, -1.0))
        for link in range(manifold.links):
            expected = (ahead - behind)[link] / (2.0 * step)
            along = found[link] @ tangent[manifold.link(link)]
            np.testing.assert_allclose(along, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_physical_values_are_those_of_a_cloud() -> None:
    rng = np.random.default_rng(4)
    clouds = [bodies.cloud(rng) for _ in range(2)]
    point = LINKS.point(np.concatenate([bodies.parameters_of_cloud(*cloud) for cloud in clouds]))
    for found, (masses, places) in zip(physical_values(point), clouds, strict=True):
        centre = masses @ places / masses.sum()
        central = bodies.parameters_of_cloud(masses, places - centre)[4:]
        np.testing.assert_allclose(found[:4], [masses.sum(), *centre], rtol=1e-9)
        np.testing.assert_allclose(found[4:], central, rtol=1e-7, atol=1e-9 * np.abs(central).max())


# --- what it says of an arm -----------------------------------------------------------------------------------------


def solved(case: Case, coefficients: FloatArray, targets: FloatArray, gamma: float | None = None) -> Estimate:
    summary = RowSummary(case.model.channels)
    for row, target in zip(coefficients, targets, strict=True):
        summary.add(row, target)
    return estimate(case.model, summary, EstimatorSettings(gamma=gamma))


def test_a_link_that_the_motion_does_not_excite_says_so() -> None:
    """The first link turns about a vertical axis: only its inertia about that axis can be felt, with the rotor's."""
    case = arm("arm3", 0)
    rows = case.model.rows(case.samples)
    first, *_, last = solved(case, rows.coefficients, rows.targets).links
    assert first.from_data < 0.05
    assert set(first.cannot_tell) == set(QUANTITIES)
    assert first.mass == pytest.approx(case.model.nominal_inertias[0], rel=0.01)
    assert last.from_data > 0.3
    assert "mass" not in last.cannot_tell


def test_a_joint_at_rest_tells_nothing_of_its_friction() -> None:
    case = arm("arm3", 0)
    still = {}
    for name in ("velocity", "acceleration", "position"):
        still[name] = getattr(case.samples, name).copy()
        still[name][:, 2] = 0.0
    moving = samples(type(motion(np.random.default_rng(0), 1, 1.0))(**still), case.samples.effort)
    rows = case.model.rows(moving)
    found = solved(case, rows.coefficients, rows.targets)
    for effect in found.effects:
        if effect.joint == "joint3" and effect.name in ("viscous_friction", "coulomb_friction", "rotor_inertia"):
            assert effect.from_data < 1e-3
            assert effect.std > 0.05 * effect.value


def test_more_data_shrink_the_deviations_of_what_they_tell() -> None:
    """``from_data`` does not grow with them: the prior's weight is a share of theirs."""
    deviations = []
    for seconds in (4, 16, 64):
        case = arm("arm3", 1, seconds=seconds)
        rows = case.model.rows(case.samples)
        found = solved(case, rows.coefficients, rows.targets)
        deviations.append([effect.std for effect in found.effects if effect.name == "coulomb_friction"])
    assert np.all(np.diff(deviations, axis=0) < 0.0)


# --- how often it is right ------------------------------------------------------------------------------------------


def runs(name: str, correlation: float, size: float = 0.2) -> Iterator[tuple[Case, FloatArray, Estimate]]:
    """Independent robots of one kind, one motion, noise low-passed by ``x' = correlation x + white``.

    The prior's weight is the one that the first run chooses.
    """
    case = arm(name, 7, seconds=10)
    coefficients = case.model.rows(case.samples).coefficients
    rng, gamma = np.random.default_rng(7), None
    for _ in range(RUNS):
        planted = parameters_of(case.model, truth(rng, case.model.robot, size))
        white = rng.normal(size=(len(coefficients) + 500, len(case.model.channels)))
        noise = lfilter([1.0], [1.0, -correlation], white, axis=0)[500:] * np.sqrt(1.0 - correlation**2)
        targets = coefficients @ planted + NOISE * noise
        found = solved(case, coefficients, targets, gamma)
        gamma = found.gamma
        yield case, planted, found


def coverage(name: str, correlation: float) -> dict[str, float]:
    """How often the truth lies within 1.96 standard deviations: effects by name, links' quantities told or not."""
    inside: dict[str, list[bool]] = defaultdict(list)
    for case, planted, found in runs(name, correlation):
        first = len(case.model.nominal_inertias)
        for effect, true in zip(found.effects, planted[first:], strict=True):
            if effect.from_data > 0.9:
                inside[effect.name].append(abs(effect.value - true) < 1.96 * effect.std)
        for link, true in zip(found.links, planted[:first].reshape(-1, 10), strict=True):
            central = pseudo_inertia.central_inertia(true)[pseudo_inertia.INERTIA_ENTRIES]
            expected = [true[0], *(true[1:4] / true[0]), *central]
            values = [link.mass, *link.com, *link.inertia[pseudo_inertia.INERTIA_ENTRIES]]
            stds = [link.std_mass, *link.std_com, *link.std_inertia[pseudo_inertia.INERTIA_ENTRIES]]
            for quantity, value, std, target in zip(QUANTITIES, values, stds, expected, strict=True):
                told = "untold" if quantity in link.cannot_tell else "told"
                inside[told].append(abs(value - target) < 1.96 * std)
    return {kind: float(np.mean(hits)) for kind, hits in inside.items()}


# Least coverage of intervals that claim 95 %, by kind, as it stands. Rotor inertia is the weak spot: it starts from a
# fit in which it stands in for wrong link inertias, farther off than the one prior spread that all directions share.
WHITE = {
    "viscous_friction": 0.85,
    "coulomb_friction": 0.85,
    "effort_offset": 0.88,
    "rotor_inertia": 0.70,
    "told": 0.85,
    "untold": 0.88,
}
# One factor inflates the noise of all directions; low-passed noise is worse for a constant than for the others.
LOW_PASSED = WHITE | {"effort_offset": 0.75}


@pytest.mark.parametrize(
    ("correlation", "least"), [(0.0, WHITE), (0.95, LOW_PASSED)], ids=["white noise", "low-passed noise"]
)
def test_intervals_of_95_percent_hold_the_truth_about_that_often(correlation: float, least: dict[str, float]) -> None:
    found = coverage("arm3", correlation)
    assert set(found) == set(least)
    for kind, share in found.items():
        assert share >= least[kind], found
