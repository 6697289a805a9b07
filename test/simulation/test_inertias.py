"""Perturbed bodies can exist, and differ by as much as asked."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.simulation.description import LinkInertia, read_description
from geomid_ros.simulation.inertias import perturbed, pseudo_inertia
from geomid_ros.simulation.robots import robot_description
from geomid_ros.types import frozen

LINKS = read_description(robot_description("arm7")).inertias


def distance(one: LinkInertia, other: LinkInertia) -> float:
    """Geodesic distance by generalised eigenvalues, a route that the perturbation does not take."""
    values = np.linalg.eigvals(np.linalg.solve(pseudo_inertia(one), pseudo_inertia(other)))
    return float(np.linalg.norm(np.log(values.real)))


@pytest.mark.parametrize("size", [0.01, 0.2, 1.0])
def test_perturbed_bodies_can_exist(size: float) -> None:
    rng = np.random.default_rng(0)
    for link in LINKS * 20:
        body = perturbed(link, size, rng)
        smallest, middle, largest = np.linalg.eigvalsh(body.inertia)
        assert body.mass > 0.0
        assert smallest > 0.0
        assert largest < smallest + middle
        assert np.linalg.eigvalsh(pseudo_inertia(body))[0] > 0.0


def test_size_is_the_deviation_in_each_of_ten_directions() -> None:
    rng = np.random.default_rng(0)
    squares = [distance(link, perturbed(link, 0.2, rng)) ** 2 for link in LINKS * 100]
    assert np.mean(squares) == pytest.approx(10 * 0.2**2, rel=0.05)


def test_impossible_nominal_body_is_refused_by_name() -> None:
    body = LinkInertia("spoon", 1.0, frozen(np.zeros(3)), frozen(np.diag([1.0, 1.0, 3.0])))
    with pytest.raises(InputError, match="link 'spoon'"):
        perturbed(body, 0.2, np.random.default_rng(0))
