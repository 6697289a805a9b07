"""The prior's weight by cross-validation: sensible on fresh motions, and honest about what it tried."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.estimation.estimator import EstimatorSettings
from geomid_ros.estimation.gamma import CANDIDATES, PAPER, choose_gamma, held_out_losses
from geomid_ros.estimation.identifier import BufferSettings, Identifier
from geomid_ros.estimation.starting_point import channel_sizes, first_sigmas, prior_parameters, scales_of_reals
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.model.weighed_masses import weighed_rows

from .arms import Case, arm

SEEDS = tuple(range(3))
# An error that noise of 0.05 N m leaves in a fit to 2000 instants, several times over.
NOISE = 0.05


def identified(case: Case, gamma: float | None, **buffer: float) -> np.ndarray:
    identifier = Identifier(case.model, EstimatorSettings(gamma=gamma), BufferSettings(**buffer))
    identifier.add(case.samples)
    return identifier.solve()


def with_stribeck(case: Case, size: float) -> Case:
    """An effect that no candidate of the model has, in the fitted motion."""
    v = case.samples.velocity
    return case.with_efforts(case.samples.effort - size * np.tanh(v / 0.02) * np.exp(-np.abs(v) / 0.3))


@pytest.mark.parametrize("model_error", [0.0, 1.0])
@pytest.mark.parametrize(("name", "seconds"), [("arm3", 8), ("arm7", 10)])
def test_the_choice_is_no_worse_on_fresh_motions_than_fixed_ones(name: str, seconds: float, model_error: float) -> None:
    """Averaged over robots; the noise of the measurement is what an error is small against."""
    errors = {gamma: [] for gamma in (None, 1e-2, 1e-6)}
    for seed in SEEDS:
        case = with_stribeck(arm(name, seed, seconds), model_error)
        fresh = case.fresh(seed)
        for gamma, found in errors.items():
            found.append(np.sqrt(np.mean(fresh.error(identified(case, gamma).parameters) ** 2)))
    mean = {gamma: float(np.mean(found)) for gamma, found in errors.items()}
    assert mean[None] <= 1.1 * min(mean[1e-2], mean[1e-6]) + 0.2 * NOISE


def losses(case: Case, folds: int = 4) -> dict[float, float]:
    summary = RowSummary(case.model.channels, folds)
    rows = case.model.rows(case.samples)
    for coefficients, targets in zip(rows.coefficients, rows.targets, strict=True):
        summary.add(coefficients, targets)
    sizes = channel_sizes(summary, case.model.dimension)
    manifold = case.model.manifold(scales_of_reals(case.model, sizes))
    prior = manifold.point(prior_parameters(case.model, summary, None))
    arguments = manifold, summary, first_sigmas(summary, case.model.dimension), prior, weighed_rows(case.model, ())
    found = held_out_losses(*arguments)
    assert found.get(choose_gamma(*arguments), np.inf) == min(found.values(), default=np.inf)
    return found


@pytest.mark.parametrize("seed", SEEDS)
def test_every_candidate_is_tried_because_losses_rise_and_fall(seed: int) -> None:
    """Found by breaking it: a search that stopped after four rises took gamma 0.1 where 1e-6 is five times better."""
    assert set(losses(arm("arm3", seed, 4.0))) == set(CANDIDATES)


def test_one_fold_of_time_leaves_the_papers_choice() -> None:
    case = arm("arm3", 0, 5.0)
    assert losses(case, folds=1) == {}
    assert identified(case, None, folds=1).gamma == PAPER
    assert identified(arm("arm3", 0, 0.9), None).gamma == PAPER  # 90 instants fill one block


def test_a_configured_weight_is_used_as_it_is() -> None:
    assert identified(arm("arm3", 0, 5.0), 3e-3).gamma == 3e-3


def test_a_channel_measured_in_one_fold_alone_does_not_stop_the_choice() -> None:
    case = arm("arm3", 1, 12.0)
    measured = case.samples.effort.copy()
    measured[100:, 2] = np.nan
    found = identified(case.with_efforts(measured), None)
    assert found.gamma in CANDIDATES
    assert found.converged
