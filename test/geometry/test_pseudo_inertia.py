"""The map (3) between parameters and pseudo-inertias, against point masses, quadrature, textbooks and pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.types import FloatArray

from . import bodies

ROUNDING = 1e-12
theorem = settings(max_examples=40, deadline=None, derandomize=True, database=None)
ten = arrays(np.float64, 10, elements=st.floats(-1e3, 1e3))


def test_pseudo_inertia_is_the_sum_over_point_masses() -> None:
    cloud = bodies.cloud(np.random.default_rng(1))
    pseudo = pseudo_inertia.from_parameters(bodies.parameters_of_cloud(*cloud))
    expected = bodies.pseudo_inertia_of_cloud(*cloud)
    np.testing.assert_allclose(pseudo, expected, rtol=0, atol=ROUNDING * np.max(np.abs(expected)))


@theorem
@given(ten, ten)
def test_a_row_is_the_trace_with_its_coefficient_matrix(row: FloatArray, parameters: FloatArray) -> None:
    """(18) and (20) are the same constraint, for impossible bodies as well."""
    matrix = np.tensordot(row, spd.to_matrix(pseudo_inertia.COEFFICIENTS_TO_COORDINATES), 1)
    np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=0)
    trace = np.trace(matrix @ pseudo_inertia.from_parameters(parameters))
    assert trace == pytest.approx(row @ parameters, rel=0, abs=1e7 * ROUNDING)


def test_a_positive_definite_matrix_has_a_non_negative_density() -> None:
    """Four equal point masses realise it: the columns of a square root, turned until their last entries agree."""
    pseudo = bodies.spd(np.random.default_rng(1))
    root = np.linalg.cholesky(pseudo)
    target = np.full(4, 0.5 * np.linalg.norm(root[3]))
    mirror = root[3] - target
    turned = root - 2.0 * np.outer(root @ mirror, mirror) / (mirror @ mirror)
    masses, positions = turned[3] ** 2, (turned[:3] / turned[3]).T
    np.testing.assert_allclose(
        pseudo_inertia.to_parameters(pseudo), bodies.parameters_of_cloud(masses, positions), rtol=0, atol=1e-10
    )


def test_change_of_frame_moves_the_point_masses() -> None:
    """(10) to (13)."""
    rng = np.random.default_rng(1)
    masses, positions = bodies.cloud(rng)
    rotation, translation = bodies.rotation(rng), rng.normal(size=3)
    factor = pseudo_inertia.change_of_frame(rotation, translation)
    moved = bodies.pseudo_inertia_of_cloud(masses, positions @ rotation.T + translation)
    image = factor @ bodies.pseudo_inertia_of_cloud(masses, positions) @ factor.T
    np.testing.assert_allclose(image, moved, rtol=0, atol=ROUNDING * np.max(np.abs(moved)))


def test_mass_centre_and_central_inertia_agree_with_pinocchio() -> None:
    for parameters in bodies.links(np.random.default_rng(1), 3):
        inertia = pinocchio.Inertia.FromDynamicParameters(parameters)
        size = np.max(np.abs(parameters[4:]))
        np.testing.assert_allclose(pseudo_inertia.centre_of_mass(parameters), inertia.lever, rtol=1e-10)
        central = pseudo_inertia.central_inertia(parameters)
        np.testing.assert_allclose(central, inertia.inertia, rtol=0, atol=ROUNDING * size)
        again = pseudo_inertia.assemble(np.array(inertia.mass), inertia.lever, inertia.inertia)
        np.testing.assert_allclose(again, parameters, rtol=1e-10, atol=ROUNDING * size)


def test_equivalent_ellipsoid_reproduces_the_inertia_of_any_body() -> None:
    parameters = bodies.links(np.random.default_rng(1), 4)
    semi_axes, axes = pseudo_inertia.equivalent_ellipsoid(parameters)
    second_moment = (axes * semi_axes[:, None, :] ** 2) @ np.swapaxes(axes, -1, -2) / 5.0
    inertia = np.trace(second_moment, axis1=-2, axis2=-1)[:, None, None] * np.eye(3) - second_moment
    central = pseudo_inertia.central_inertia(parameters)
    for k in range(4):
        size = np.max(np.abs(parameters[k, 4:]))
        np.testing.assert_allclose(parameters[k, 0] * inertia[k], central[k], rtol=0, atol=ROUNDING * size)


def test_quantities_are_those_of_a_cloud_and_give_its_parameters_again() -> None:
    rng = np.random.default_rng(1)
    masses, places = bodies.cloud(rng)
    parameters, centre = bodies.parameters_of_cloud(masses, places), masses @ places / masses.sum()
    central = bodies.parameters_of_cloud(masses, places - centre)[4:]
    found = pseudo_inertia.quantities_of(parameters)
    np.testing.assert_allclose(found[:4], [masses.sum(), *centre], rtol=1e-9)
    np.testing.assert_allclose(found[4:], central, rtol=1e-7, atol=1e-9 * np.abs(central).max())
    again = pseudo_inertia.parameters_of(np.array([found, found]))
    np.testing.assert_allclose(again, [parameters, parameters], rtol=1e-9, atol=1e-12 * np.abs(parameters).max())
