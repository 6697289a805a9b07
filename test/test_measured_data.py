"""Real recordings, where they are at hand: what was promised of the held-out errors."""

import numpy as np
import pytest

from benchmarks.measured_data import CASES, DATA, Comparison, compare

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured recordings are not at {DATA}")

AIRBOT_LIMITS = [0.115, 0.26, 0.25, 0.033, 0.036, 0.016]  # N m
LWR4_LEAST_SQUARES_TOTAL = 2.42  # N m, of the reference computation that came with the recordings


@pytest.fixture(scope="module", params=CASES)
def named(request: pytest.FixtureRequest) -> tuple[str, Comparison]:
    return request.param, compare(CASES[request.param])


def test_every_link_is_possible_and_some_least_squares_links_are_not(named: tuple[str, Comparison]) -> None:
    _, found = named
    assert found.possible["geomid"] == len(found.estimate.links)
    assert min(link.min_eigenvalue_ratio for link in found.estimate.links) > 0.01
    assert found.possible["least squares"] < len(found.estimate.links)


def test_held_out_errors(named: tuple[str, Comparison]) -> None:
    name, found = named
    geomid, squares = found.errors["geomid"], found.errors["least squares"]
    if name == "UR10":
        assert np.all(geomid <= 1.05 * squares)
        assert np.sum(geomid) < np.sum(squares)
    elif name == "AIRBOT":
        assert np.all(geomid <= AIRBOT_LIMITS)
    elif name == "LWR4+":
        assert np.sum(geomid) < LWR4_LEAST_SQUARES_TOTAL
        assert np.all(geomid < found.errors["effects alone"])
    else:
        assert name == "human"
        assert np.all(geomid < found.errors["URDF"])
