"""The affine-invariant geometry (5) to (9), Proposition 1 and the line element (15)."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.types import FloatArray

from . import bodies

ROUNDING = 1e-10  # relative; the matrices' condition numbers reach 1e4
theorem = settings(max_examples=40, deadline=None, derandomize=True, database=None)
generators = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def general_linear(rng: np.random.Generator) -> FloatArray:
    """A random element of GL(4), of either orientation, that scales its directions differently."""
    return rng.normal(size=(4, 4)) @ np.diag(10.0 ** rng.uniform(-1.0, 1.0, size=4))


def test_the_exponential_is_scipys() -> None:
    rng = np.random.default_rng(1)
    tangent = bodies.symmetric(rng)
    np.testing.assert_allclose(spd.sym_exp(tangent), scipy.linalg.expm(tangent), rtol=0, atol=ROUNDING)


@theorem
@given(generators)
def test_gl4_keeps_distances(rng: np.random.Generator) -> None:
    (base, other), g = bodies.spd(rng, 2), general_linear(rng)
    moved = spd.distance(spd.congruence(g, base), spd.congruence(g, other))
    assert moved == pytest.approx(float(spd.distance(base, other)), rel=1e-7)


def test_distance_between_bodies_has_no_frame_and_no_units() -> None:
    """Proposition 1, on point masses that are moved and measured anew (length units may differ by axis, (10))."""
    rng = np.random.default_rng(1)
    clouds = [bodies.cloud(rng), bodies.cloud(rng)]
    turn, shift, mass_unit = bodies.rotation(rng), rng.normal(size=3), 10.0 ** rng.uniform(-2.0, 2.0)
    units = 10.0 ** rng.uniform(-2.0, 2.0) * rng.uniform(0.5, 2.0, size=3)
    moved = [(mass_unit * masses, (positions @ turn.T + shift) * units) for masses, positions in clouds]
    here, there = (
        spd.distance(*(pseudo_inertia.from_parameters(bodies.parameters_of_cloud(*cloud)) for cloud in pair))
        for pair in (clouds, moved)
    )
    assert there == pytest.approx(here, rel=1e-6)


def test_it_agrees_with_pyriemann() -> None:
    distance = pytest.importorskip("pyriemann.utils.distance")
    a, b = bodies.spd(np.random.default_rng(1), 2)
    assert spd.distance(a, b) == pytest.approx(distance.distance_riemann(a, b), rel=ROUNDING)


def half_squared_along(base: FloatArray, other: FloatArray, direction: FloatArray, t: float) -> float:
    """d^2/2 to ``other`` at time t of the geodesic from ``base`` whose whitened velocity is ``direction (10,)``."""
    root = scipy.linalg.sqrtm(base)
    moved = spd.congruence(root, spd.sym_exp(t * spd.to_matrix(direction)))
    return 0.5 * float(spd.distance(moved, other)) ** 2


@pytest.mark.parametrize("spread", [0.1, 1.0, 2.0])
def test_hessian_of_the_half_squared_distance_by_finite_differences(spread: float) -> None:
    rng = np.random.default_rng(1)
    base, other = bodies.spd(rng), bodies.spd(rng, spread=spread)
    inverse = np.linalg.inv(scipy.linalg.sqrtm(base))
    hessian = spd.half_squared_distance_hessian(*np.linalg.eigh(scipy.linalg.logm(spd.congruence(inverse, other))))
    np.testing.assert_allclose(hessian, hessian.T, rtol=0, atol=ROUNDING)
    h = 1e-3
    for v in rng.normal(size=(4, 10)) / np.sqrt(10.0):
        before, here, after = (half_squared_along(base, other, v, t) for t in (-h, 0.0, h))
        assert v @ hessian @ v == pytest.approx((before - 2.0 * here + after) / h**2, rel=1e-5)


def test_line_element_in_mass_centre_and_covariance() -> None:
    """(15), times the two by which the metric here differs from the printed one."""
    rng = np.random.default_rng(1)
    mass, centre, covariance = rng.uniform(0.1, 50.0), rng.normal(size=3), bodies.spd(rng)[:3, :3]
    d_mass, d_centre, d_covariance = rng.normal(), rng.normal(size=3), bodies.symmetric(rng)[:3, :3]

    unit = np.block([[covariance + np.outer(centre, centre), centre[:, None]], [centre[None], np.ones((1, 1))]])
    d_second = d_covariance + np.outer(d_centre, centre) + np.outer(centre, d_centre)
    d_unit = np.block([[d_second, d_centre[:, None]], [d_centre[None], np.zeros((1, 1))]])
    tangent = d_mass * unit + mass * d_unit

    relative = np.linalg.solve(covariance, d_covariance)
    printed = 2.0 * (d_mass / mass) ** 2 + d_mass / mass * np.trace(relative)
    printed += d_centre @ np.linalg.solve(covariance, d_centre) + 0.5 * np.trace(relative @ relative)
    assert bodies.inner(mass * unit, tangent, tangent) == pytest.approx(2.0 * printed, rel=1e-8)


def test_positive_definite_is_what_has_no_other_eigenvalues() -> None:
    rng = np.random.default_rng(1)
    matrices = np.concatenate([bodies.spd(rng, 5), bodies.symmetric(rng, 50) + 1.5 * np.eye(4)])
    expected = np.linalg.eigvalsh(matrices)[:, 0] > 0.0
    assert 0 < np.count_nonzero(expected) < len(matrices)
    np.testing.assert_array_equal(spd.is_positive_definite(matrices), expected)
