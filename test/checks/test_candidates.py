"""Probabilities of causes are those of hypotheses of equal odds, and nothing wrong is one of them."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.checks.candidates import PROBABLE, probabilities
from geomid_ros.checks.instants import FEWEST


def test_they_are_all_there_is() -> None:
    shares = probabilities([0.1, 0.7, -0.2, 0.69], 40)
    assert np.sum(shares) == pytest.approx(1.0)
    assert np.all(np.diff(shares[np.argsort([0.1, 0.7, -0.2, 0.69])]) > 0.0)


@pytest.mark.parametrize("count", [1, 20, 300])
def test_without_evidence_nothing_is_as_probable_as_all_causes(count: int) -> None:
    shares = probabilities(np.zeros(count).tolist(), count)
    assert shares[-1] == pytest.approx(0.5)


def test_the_more_causes_are_tried_the_more_one_has_to_explain() -> None:
    """By Bayes' rule: n causes of equal odds, each of which is one in 2 n at first."""
    for count in (10, 1000):
        odds = PROBABLE / (1.0 - PROBABLE)
        gain = np.log(odds * count) / FEWEST
        assert probabilities([gain], count)[0] == pytest.approx(PROBABLE)


def test_evidence_of_any_size_is_a_number() -> None:
    assert probabilities([1e6, -1e6, 0.0], 10).tolist() == [1.0, 0.0, 0.0, 0.0]
