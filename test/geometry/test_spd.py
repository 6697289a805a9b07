"""The affine-invariant geometry (5) to (9), Proposition 1 and the line element (15)."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from geomid_ros.geometry import pseudo_inertia, spd

from . import bodies

ROUNDING = 1e-10  # relative; the matrices' condition numbers reach 1e4


def test_the_exponential_is_scipys() -> None:
    rng = np.random.default_rng(1)
    tangent = bodies.symmetric(rng)
    np.testing.assert_allclose(spd.sym_exp(tangent), scipy.linalg.expm(tangent), rtol=0, atol=ROUNDING)


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


def test_a_body_thinner_than_double_precision_has_a_finite_distance() -> None:
    """Beyond sixteen digits an eigenvalue is rounding, of any sign; the others still count."""
    rng = np.random.default_rng(1)
    turns = np.array([np.linalg.qr(rng.normal(size=(4, 4)))[0] for _ in range(50)])
    thin = spd.composed(np.tile([1e-12, 1.0, 1e3, 1e7], (50, 1)), turns)
    distances = spd.distance(np.tile(np.eye(4), (50, 1, 1)), thin)
    assert np.all(distances >= np.linalg.norm(np.log([1e3, 1e7])))
    assert np.all(distances <= np.linalg.norm(np.log([1e-10, 1e3, 1e7])))


def test_positive_definite_is_what_has_no_other_eigenvalues() -> None:
    rng = np.random.default_rng(1)
    matrices = np.concatenate([bodies.spd(rng, 5), bodies.symmetric(rng, 50) + 1.5 * np.eye(4)])
    expected = np.linalg.eigvalsh(matrices)[:, 0] > 0.0
    assert 0 < np.count_nonzero(expected) < len(matrices)
    np.testing.assert_array_equal(spd.is_positive_definite(matrices), expected)
