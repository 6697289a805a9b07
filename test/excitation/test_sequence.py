"""Record, identify, design from what is known then, until nothing worth it is left: on simulated arms."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.estimation.estimator import EstimatorSettings, estimate
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.excitation.belief import ROWS_PER_SECOND, Belief, aim_weight, belief_from_estimate
from geomid_ros.excitation.feasibility import Feasibility
from geomid_ros.excitation.motion import ExcitingMotion
from geomid_ros.excitation.search import Search, expected_error, random_motion
from geomid_ros.model.samples import samples_of
from geomid_ros.types import FloatArray

from .arm import small_task

TASK = small_task()
WORTH = 0.3
MOST = 8


def designed(knowledge: Belief, random: np.random.Generator) -> tuple[ExcitingMotion, float]:
    """A motion from what is known, and by what share it lowers the expected error."""
    before = TASK.feasibility
    feasibility = Feasibility(knowledge, before.limits, before.start, before.collision)
    weight = aim_weight("prediction", knowledge, [random_motion(before, TASK.form, random) for _ in range(4)])
    motion = Search(feasibility, TASK.form, expected_error(feasibility, weight, TASK.form)).run(random)
    after = knowledge.updated(knowledge.information(motion))
    left = np.sum(weight * after.posterior.covariance) / np.sum(weight * knowledge.posterior.covariance)
    return motion, 1.0 - float(np.sqrt(left))


def error(parameters: FloatArray, true: FloatArray, motion: ExcitingMotion) -> float:
    times = np.linspace(0.0, motion.form.period, 200)
    rows = TASK.belief.model.rows(samples_of(motion.at(times)[:3])).coefficients
    return float(np.sqrt(np.mean((rows @ (parameters - true) / TASK.belief.sigmas) ** 2)))


def test_a_sequence_learns_and_comes_to_an_end() -> None:
    random = np.random.default_rng(1)
    prior = TASK.belief
    spreads = 0.5 * prior.posterior.prior_stds
    spreads[prior.posterior.manifold.inertial] = 0.2
    tangent = spreads * random.standard_normal(len(spreads))
    true = np.array(prior.posterior.manifold.exp(prior.posterior.point, tangent).parameters)
    other = random_motion(TASK.feasibility, TASK.form, np.random.default_rng(99))
    summary, knowledge = RowSummary(prior.model.channels), prior
    errors = [error(prior.posterior.parameters, true, other)]
    count = round(ROWS_PER_SECOND * TASK.form.period)
    times = (np.arange(count) + 0.5) * TASK.form.period / count
    for _ in range(MOST):
        motion, gain = designed(knowledge, random)
        if gain < WORTH:
            break
        rows = prior.model.rows(samples_of(motion.at(times)[:3])).coefficients
        measured = rows @ true + prior.sigmas * random.standard_normal(rows.shape[:2])
        summary.add(rows, measured)
        sigmas = dict(zip(TASK.feasibility.names, prior.sigmas.tolist(), strict=True))
        found = estimate(prior.model, summary, EstimatorSettings(sigma=sigmas))
        knowledge = belief_from_estimate(prior.model, found.posterior, prior.sigmas.tolist(), "estimate")
        errors.append(error(found.parameters, true, other))
    else:
        pytest.fail(f"{MOST} motions, and still worth more than {WORTH:.0%}")
    assert len(errors) > 2
    assert errors[-1] < 0.05 * errors[0]
    assert errors[-1] < 1.05 * errors[1]
