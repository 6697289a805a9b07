"""What motions tell: information adds up, and what is foretold comes out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.excitation.belief import ROWS_PER_SECOND, aim_weight, belief_from_estimate, expected_learning
from geomid_ros.excitation.feasibility import Feasibility
from geomid_ros.excitation.motion import ExcitingMotion, MotionForm
from geomid_ros.excitation.search import random_feasible, random_motion
from geomid_ros.model.samples import samples_of
from geomid_ros.session.excitation import design
from geomid_ros.session.options import MotionOptions

from .arm import small_task

TASK = small_task()
KNOWLEDGE = TASK.belief


def motion(seed: int = 0):
    return random_feasible(TASK.feasibility, TASK.form, np.random.default_rng(seed))


def test_more_is_known_afterwards() -> None:
    after = KNOWLEDGE.updated(KNOWLEDGE.information(motion()))
    gained = np.linalg.eigvalsh(KNOWLEDGE.posterior.covariance - after.posterior.covariance)
    assert np.all(gained > -1e-9)
    assert np.max(gained) > 0.01
    again = belief_from_estimate(after.model, after.posterior, after.sigmas.tolist(), "here")
    assert np.allclose(again.precision, KNOWLEDGE.precision + KNOWLEDGE.information(motion()), rtol=1e-5, atol=1e-3)


def test_an_estimate_of_another_robot_is_refused() -> None:
    other = replace(KNOWLEDGE.posterior, links=("x", *KNOWLEDGE.posterior.links[1:]))
    with pytest.raises(InputError, match=r"estimate.json: an estimate with other links"):
        belief_from_estimate(KNOWLEDGE.model, other, [1.0] * 3, "estimate.json")


def test_foretold_deviations_are_those_of_many_linear_estimates() -> None:
    """Truths drawn from the prior, efforts with noise, and the posterior's mean by least squares in tangent
    coordinates: its errors are as large as was foretold."""
    own, random = motion(), np.random.default_rng(8)
    count = round(ROWS_PER_SECOND * own.form.period)
    times = (np.arange(count) + 0.5) * own.form.period / count
    rows = KNOWLEDGE.rows(own.at(times)[:3])
    whitened = (rows / KNOWLEDGE.sigmas[:, None]).reshape(-1, rows.shape[2])
    spreads = np.sqrt(np.diag(KNOWLEDGE.posterior.covariance))
    truths = spreads * random.standard_normal((400, len(spreads)))
    measured = truths @ whitened.T + random.standard_normal((400, len(whitened)))
    stacked = np.concatenate([whitened, np.diag(1.0 / spreads)])
    targets = np.concatenate([measured.T, np.zeros((len(spreads), 400))])
    errors = np.linalg.lstsq(stacked, targets, rcond=None)[0].T - truths
    after = KNOWLEDGE.updated(KNOWLEDGE.information(own))
    foretold = np.sqrt(np.diag(after.posterior.covariance))
    assert np.allclose(np.sqrt(np.mean(errors**2, axis=0)) / foretold, 1.0, atol=0.15)


@pytest.mark.parametrize("aim", ["prediction", "friction", "payload", "link:upper"])
def test_the_criterion_is_the_mean_squared_error_that_it_says(aim: str) -> None:
    others = [random_motion(TASK.feasibility, TASK.form, np.random.default_rng(9))]
    weight = aim_weight(aim, KNOWLEDGE, others)
    tangent = 0.01 * np.random.default_rng(10).standard_normal(len(weight))
    value = tangent @ weight @ tangent
    posterior = KNOWLEDGE.posterior
    moved = posterior.manifold.straight(posterior.point, tangent).parameters - posterior.parameters
    if aim == "prediction":
        times = np.linspace(0.0, TASK.form.period, 2000, endpoint=False)
        coefficients = KNOWLEDGE.model.rows(samples_of(others[0].at(times)[:3])).coefficients
        assert value == pytest.approx(np.mean((coefficients @ moved / KNOWLEDGE.sigmas) ** 2), rel=0.05)
    elif aim == "friction":
        own = [i for i, e in enumerate(posterior.effects) if e.name in ("viscous_friction", "coulomb_friction")]
        first = posterior.manifold.inertial.stop
        relative = moved[first:][own] / posterior.parameters[first:][own]
        assert value == pytest.approx(np.sum(relative**2), rel=1e-6)
    else:
        link = posterior.links.index("fore" if aim == "payload" else "upper")
        own = np.zeros_like(tangent)
        own[posterior.manifold.link(link)] = tangent[posterior.manifold.link(link)]
        reached = posterior.manifold.exp(posterior.point, own)
        assert value == pytest.approx(posterior.manifold.distance(posterior.point, reached) ** 2, rel=1e-6)


def test_what_is_expected_is_said_honestly() -> None:
    """A random motion as good as the designed one: the design is no better, and twice as long is better."""
    weight = aim_weight("prediction", KNOWLEDGE, [motion(1)])
    found = expected_learning(KNOWLEDGE, weight, motion(2), [motion(2)])
    assert any("the design is no better than a random motion" in sentence for sentence in found.sentences)
    assert any("recording longer helps more than the design" in sentence for sentence in found.sentences)
    assert found.before.error > found.designed.error > found.twice.error
    assert np.all(found.before.links >= found.designed.links - 1e-12)


WALLS = ("plane:1,0,0,-0.08", "plane:-1,0,0,-0.08", "plane:0,1,0,-0.08", "plane:0,-1,0,-0.08")


@pytest.mark.parametrize("clearance", [0.02, 0.3])
def test_pairs_that_begin_closer_than_the_clearance_are_said_to_keep_half(clearance: float) -> None:
    """The walls begin 0.05 m from the arm."""
    wish = MotionOptions(duration=3.0, repeats=1, avoid=WALLS, clearance=clearance)
    found = design(small_task(wish), wish)
    assert ("half of their distance at the start" in found.closest) is (clearance > 0.05)


def test_in_a_tight_place_the_error_on_feasible_motions_is_foretold() -> None:
    """The arm stands upright in a shaft, 0.16 m wide, in which random motions within its limits collide."""
    wish = MotionOptions(duration=6.0, repeats=1, avoid=WALLS)
    task = small_task(wish)
    found = design(task, wish)
    random = np.random.default_rng(8)
    after = task.belief.updated(task.belief.information(found.motion)).posterior.covariance

    def error(make: Callable[[Feasibility, MotionForm, np.random.Generator], ExcitingMotion]) -> float:
        motions = [make(task.feasibility, task.form, random) for _ in range(12)]
        return float(np.sqrt(np.sum(aim_weight("prediction", task.belief, motions) * after)))

    foretold = found.learning.designed.error
    assert foretold == pytest.approx(error(random_feasible), rel=0.2)
    assert error(random_motion) > 5.0 * foretold
