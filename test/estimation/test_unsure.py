"""Which optional effects are taken back after a fit, as they may as well be nothing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geomid_ros.estimation.estimator import _unsure


def found(*sizes: float, optional: bool = True) -> Any:
    """The model, estimate and columns of effects that are so many of their deviations."""
    coefficients = [SimpleNamespace(mechanism=("effect", place), optional=optional) for place in range(len(sizes))]
    effects = [SimpleNamespace(value=-size, std=1.0) for size in sizes]
    model = SimpleNamespace(dimension=10 + len(sizes), coefficients=coefficients)
    return model, SimpleNamespace(effects=effects), np.arange(model.dimension)


@pytest.mark.parametrize(("sizes", "gone"), [((0.9, 0.5, 0.7), [11]), ((1.8, 5.0), [10]), ((2.5, 3.0), [])])
def test_the_least_one_goes_alone(sizes: tuple[float, ...], gone: list[int]) -> None:
    """Two that share what they explain are both unsure beside each other, and one of them is not by itself."""
    assert _unsure(*found(*sizes)).tolist() == gone


def test_what_is_always_there_stays() -> None:
    assert _unsure(*found(0.1, 0.2, optional=False)).tolist() == []
