"""What goes wrong in practice: an estimate with an honest certainty or an error that says so, never anything else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import FloatArray

from .arms import Case, arm, solved

pytestmark = pytest.mark.filterwarnings("error")


def assert_sound(found: Estimate, silent: tuple[int, ...] = ()) -> None:
    """No NaN but for channels that were never measured, links that can exist, certainty that is a number."""
    measured = [index for index in range(len(found.channels)) if index not in silent]
    assert np.all(np.isfinite(found.parameters))
    assert np.all(np.isfinite(found.sigmas))
    assert np.all(found.sigmas > 0.0)
    assert np.all(np.isfinite(found.rms[measured]))
    assert np.all(np.isnan(found.rms[list(silent)]))
    for link in found.links:
        assert np.linalg.eigvalsh(pseudo_inertia.from_parameters(link.parameters))[0] > 0.0
        assert 0.0 <= link.from_data <= 1.0
        numbers = [link.std_mass, *link.std_com, *link.std_inertia.ravel(), link.min_eigenvalue_ratio]
        assert np.all(np.isfinite(numbers))
        assert np.all(np.array(numbers) >= 0.0)
    for effect in found.effects:
        assert np.isfinite(effect.value)
        assert np.isfinite(effect.std)
        assert effect.std >= 0.0


def measuring(change: Callable[[FloatArray], FloatArray]) -> Callable[[Case], Case]:
    return lambda case: case.with_efforts(change(case.samples.effort.copy()))


def only(instants: FloatArray | slice) -> Callable[[Case], Case]:
    return lambda case: replace(case, samples=case.samples.select(instants))


def put(instants: slice, value: float) -> Callable[[Case], Case]:
    def change(effort: FloatArray) -> FloatArray:
        effort[instants] = value
        return effort

    return measuring(change)


def nearly_motionless(case: Case) -> Case:
    """Nothing moves, but for a speed just above what counts as still."""
    rng, shape = np.random.default_rng(0), case.samples.position.shape
    held = np.broadcast_to(case.samples.position[:1], shape)
    speeds = 2e-3 + 1e-3 * rng.random(shape)
    samples = replace(case.samples, position=held, velocity=speeds, acceleration=1e-3 * rng.normal(size=shape))
    return replace(case, samples=samples)


TROUBLES = {
    "one sample": only(slice(0, 1)),
    "fewer rows than parameters": only(slice(0, 8)),
    "zero efforts": measuring(np.zeros_like),
    "constant efforts": measuring(lambda effort: np.full_like(effort, 3.0)),
    "reversed efforts": measuring(np.negative),
    "efforts of another robot": measuring(lambda effort: 1e3 * effort[::-1]),
    "outliers in one fold": put(slice(100, 110), 1e6),
    "absurd outliers": put(slice(50, 52), 1e12),
    "one sample, many times": only(np.zeros(300, dtype=np.int64)),
    "every sample twice": only(np.repeat(np.arange(300), 2)),
    "nearly motionless": nearly_motionless,
}


HARD = ("fewer rows than parameters", "absurd outliers")


@pytest.mark.parametrize(
    ("trouble", "objective"), [*((one, "residual") for one in TROUBLES), *((one, "geodesic") for one in HARD)]
)
def test_troubles_end_in_a_sound_estimate(trouble: str, objective: str) -> None:
    assert_sound(solved(TROUBLES[trouble](arm("arm3", 0, seconds=4)), objective=objective))


@pytest.mark.parametrize("silent", [(2,), (0, 1)])
def test_channels_that_are_never_measured(silent: tuple[int, ...]) -> None:
    case = arm("arm3", 0, seconds=4)
    effort = case.samples.effort.copy()
    effort[:, list(silent)] = np.nan
    found = solved(case.with_efforts(effort))
    assert_sound(found, silent)
    for effect in found.effects:
        if effect.joint in {f"joint{index + 1}" for index in silent}:
            assert effect.from_data == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("gamma", [1e-15, 1e12])
def test_extreme_weights_of_the_prior(gamma: float) -> None:
    assert_sound(solved(arm("arm3", 0, seconds=4), gamma=gamma))


@pytest.mark.parametrize("sigma", [1e-9, 1e9])
def test_configured_sigmas(sigma: float) -> None:
    found = solved(arm("arm3", 0, seconds=4), sigma={"joint2": sigma}, max_steps=30)
    assert_sound(found)
    assert found.converged or sigma == 1e-9, "of the last it would not in ten times as many steps"
    assert found.sigmas[1] == sigma


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"gamma": np.inf}, "gamma"),
        ({"sigma": {"joint1": 0.0}}, "sigma of 'joint1'"),
        ({"sigma": {"jiont1": 1.0}}, "Did you mean 'joint1'"),
        ({"objective": "residuals"}, "Did you mean 'residual'"),
        ({"solver": "newton"}, "trust_region"),
    ],
)
def test_settings_that_cannot_work_are_refused_by_name(settings: dict[str, object], named: str) -> None:
    with pytest.raises(InputError, match=named):
        solved(arm("arm3", 0, seconds=1), **settings)
