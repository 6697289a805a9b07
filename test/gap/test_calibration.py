"""Stated standard deviations are those of the errors, over many robots."""

import numpy as np
import pytest
from scipy.stats import chi2

from . import pendulum
from .pendulum import Effort

SEEDS = 7  # 35 errors: of less than 31, chance makes one half too wide
FALSE_ALARMS = 1e-4
PLANTED: dict[str, tuple[Effort, dict[str, float]]] = {
    "viscous_friction": (lambda _q, v: 0.4 * v, {"coefficient": 0.4}),
    "coulomb_friction": (lambda _q, v: 0.3 * np.sign(v), {"level": 0.3}),
    "spring": (lambda q, _v: 2.0 * (q - 0.3), {"stiffness": 2.0, "equilibrium": 0.3}),
    "effort_offset": (lambda q, _v: -0.5 + 0.0 * q, {"offset": -0.5}),
}


@pytest.fixture(scope="module")
def errors() -> np.ndarray:
    """Of every parameter of every effect in every run, in its standard deviations."""
    found = []
    for effect, (extra, parameters) in PLANTED.items():
        for seed in range(SEEDS):
            (finding,) = pendulum.gap(extra, seed).findings
            assert (finding.effect, finding.joint) == (effect, "hinge")
            assert finding.probability > 0.5
            stated = [finding.parameters[name] for name in parameters]
            found += [(q.value - true) / q.std for q, true in zip(stated, parameters.values(), strict=True)]
    return np.array(found)


def test_planted_sizes_are_off_by_no_more_than_is_stated(errors: np.ndarray) -> None:
    """And not by less than two fifths of it: what is written is fitted on the rows alone, and stated with a deviation
    that allows for a remainder, which is not there."""
    most = chi2.ppf(1.0 - FALSE_ALARMS, len(errors)) / len(errors)
    assert most < 1.5**2
    assert 0.4**2 < np.mean(errors**2) < most


def test_planted_sizes_are_off_to_both_sides(errors: np.ndarray) -> None:
    assert abs(np.mean(errors)) < 4.0 / np.sqrt(len(errors))
