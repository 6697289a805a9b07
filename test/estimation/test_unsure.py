"""Which optional effects are taken back after a fit, as they may as well be nothing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geomid_ros.estimation.estimate import STDS_OF_95
from geomid_ros.estimation.estimator import _least_significant
from geomid_ros.model.effects.effect import FRICTION_DRIFT

from .arms import Truth, arm, efforts, solved


def found(*sizes: float, optional: bool = True) -> Any:
    """The model, estimate and columns of effects that are so many of their deviations."""
    coefficients = [SimpleNamespace(mechanism=("effect", place), optional=optional) for place in range(len(sizes))]
    effects = [SimpleNamespace(value=-size, std=1.0) for size in sizes]
    model = SimpleNamespace(dimension=10 + len(sizes), coefficients=coefficients)
    return model, SimpleNamespace(effects=effects), np.arange(model.dimension)


@pytest.mark.parametrize(("sizes", "gone"), [((0.9, 0.5, 0.7), [11]), ((1.98, 5.0), [10]), ((2.02, 3.0), [])])
def test_the_least_one_goes_alone(sizes: tuple[float, ...], gone: list[int]) -> None:
    """Two that share what they explain are both unsure beside each other, and one of them is not by itself."""
    assert _least_significant(*found(*sizes)).tolist() == gone


def test_friction_that_noise_hides_is_not_known_to_be_nothing() -> None:
    """The deviation of a logarithm would be a share of next to nothing. None is smaller than that of the least squares
    of the friction's column alone."""
    for seed in range(4):
        case = arm("arm3", seed, seconds=5.0, noise=0.0)
        small = Truth(case.true.links, {**case.true.effects, "viscous_friction": np.full(3, 0.02)})
        clean = efforts(case.model.robot, small, case.samples)
        noise = np.random.default_rng(100 + seed).normal(size=clean.shape)
        least = 1.0 / np.linalg.norm(case.samples.velocity, axis=0)
        for effect in solved(case.with_efforts(clean + noise)).effects:
            if effect.name == "viscous_friction":
                assert effect.std > 0.8 * least[case.model.robot.joint_names.index(effect.joint)]


def test_friction_that_drifts_between_two_recordings_is_within_what_both_say() -> None:
    """Each recording is of other friction, by the drift that robots have; nothing else of the robot changes."""
    apart = []
    for seed in range(8):
        drift, told = np.random.default_rng(seed), []
        case = arm("arm3", seed, seconds=5.0, noise=0.0)
        for _ in range(2):
            own = {
                name: c * drift.normal(1.0, FRICTION_DRIFT, 3) if "friction" in name else c
                for name, c in case.true.effects.items()
            }
            clean = efforts(case.model.robot, Truth(case.true.links, own), case.samples)
            told.append(solved(case.with_efforts(clean + drift.normal(0.0, 0.01, clean.shape))).effects)
        for first, second in zip(*told, strict=True):
            if "friction" in first.name:
                apart.append(abs(first.value - second.value) / np.hypot(first.std, second.std))
    assert 0.88 < np.mean(np.array(apart) < STDS_OF_95) < 0.99


def test_what_does_not_drift_is_as_sure_as_its_recording() -> None:
    case = arm("arm3", 0, seconds=10.0, noise=0.001)
    for effect in solved(case).effects:
        if "friction" in effect.name:
            assert FRICTION_DRIFT * effect.value <= effect.std < 1.1 * FRICTION_DRIFT * effect.value
        else:
            assert effect.std < 0.01 * max(abs(effect.value), 1.0)
