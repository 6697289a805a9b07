"""What is learned from designed and from random motions, with drawn truths and the package's own estimates."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.excite.robots import Recorded, identified, predicted_error, recorded, task, truth, wish
from benchmarks.report import Report
from geomid_ros.excitation.belief import Belief, aim_weight, belief_from_estimate
from geomid_ros.excitation.feasibility import Feasibility
from geomid_ros.excitation.motion import ExcitingMotion, MotionForm
from geomid_ros.excitation.search import Search, expected_error, random_feasible, typical_motions
from geomid_ros.session.excitation import DesignTask
from geomid_ros.types import FloatArray

_RANDOM = 60
_OTHERS = 5
_MORE = 4  # random motions, whose errors' mean counts: one may be lucky
_EXPECTED = 6  # motions by which a design counts the expected error


def against_random(report: Report, robots: list[str], seconds: float, truths: int) -> None:
    """Errors of predicted efforts after a designed motion and after random ones."""
    rows, ratios = [], []
    for robot in robots:
        report.progress(f"{robot}: {_RANDOM} random motions")
        own = task(robot, wish(robot, seconds))
        random = np.random.default_rng(1)
        weight = _weight(own, own.belief, random)
        motions = [random_feasible(own.feasibility, own.form, random) for _ in range(_RANDOM)]
        errors = [_expected(own.belief, weight, motion) for motion in motions]
        designed = _designed(own, weight, random)
        tried = {
            "random": [motions[0]],
            "best of 60": [motions[int(np.argmin(errors))]],
            "designed": [designed],
            "random, twice as long": motions[:2],
            "designed, twice": [designed, designed],
        }
        others = [random_feasible(own.feasibility, own.form, random) for _ in range(_OTHERS)]
        found = {name: _errors(own.belief, parts, others, truths) for name, parts in tried.items()}
        means = {name: float(np.mean(values)) for name, values in found.items()}
        ratios.append(means["designed"] / means["best of 60"])
        sure = np.std(np.array(found["designed"]) / np.array(found["best of 60"])) / np.sqrt(truths)
        foretold = _expected(own.belief, aim_weight("prediction", own.belief, others), designed)
        rows.append(
            [robot, *(f"{mean:.3f}" for mean in means.values()), f"{ratios[-1]:.2f} ± {sure:.2f}", f"{foretold:.3f}"]
        )
        report.result(f"learning {robot}", means | {"foretold": foretold})
    headings = ["robot", *tried, "designed to best", "foretold"]
    caption = f"mean of designed to best of {_RANDOM}: {np.mean(ratios):.3f}"
    report.table(f"Error of predicted efforts in units of noise, {truths} truths", headings, rows, caption)


def _weight(own: DesignTask, knowledge: Belief, random: np.random.Generator) -> FloatArray:
    others = typical_motions(own.feasibility, own.form, random, _EXPECTED)
    return aim_weight("prediction", knowledge, others)


def _designed(own: DesignTask, weight: FloatArray, random: np.random.Generator) -> ExcitingMotion:
    return Search(own.feasibility, own.form, expected_error(own.feasibility, weight, own.form)).run(random)


def _expected(knowledge: Belief, weight: FloatArray, motion: ExcitingMotion) -> float:
    after = knowledge.updated(knowledge.information(motion))
    return float(np.sqrt(np.sum(weight * after.posterior.covariance)))


def _errors(knowledge: Belief, motions: list[ExcitingMotion], others: list[ExcitingMotion], truths: int) -> list[float]:
    errors = []
    for seed in range(truths):
        random = np.random.default_rng(seed)
        true = truth(knowledge, random)
        recordings = [recorded(knowledge, motion, true, random) for motion in motions]
        errors.append(predicted_error(knowledge, identified(knowledge, recordings).parameters, true, others))
    return errors


@dataclass(frozen=True, eq=False)
class _Poor:
    """A recording from which little is known, and what an estimate makes of it."""

    recording: Recorded
    knowledge: Belief


def after_poor_data(report: Report, robots: list[str], seconds: float, truths: int) -> None:
    """Errors after a minute of pick and place and ten seconds more."""
    rows, ratios = [], []
    for robot in robots:
        own = task(robot, wish(robot, seconds))
        random = np.random.default_rng(2)
        generic = _designed(own, _weight(own, own.belief, random), random)
        more = [random_feasible(own.feasibility, own.form, random) for _ in range(_MORE)]
        others = [random_feasible(own.feasibility, own.form, random) for _ in range(_OTHERS)]
        found = []
        for seed in range(truths):
            report.progress(f"{robot}: truth {seed}")
            draw = np.random.default_rng(seed)
            true = truth(own.belief, draw)
            poor = _pick_and_place(own, true, draw)
            feasible = _knowing(own, poor.knowledge)
            designed = _designed(feasible, _weight(own, poor.knowledge, random), random)
            errors = [_error_after(own.belief, [poor.recording], true, others)]
            for motions in (more, [generic], [designed]):
                recordings = [
                    recorded(own.belief, motion, true, np.random.default_rng([seed, 1])) for motion in motions
                ]
                each = [_error_after(own.belief, [poor.recording, r], true, others) for r in recordings]
                errors.append(float(np.mean(each)))
            found.append(errors)
        means = np.mean(found, axis=0)
        ratios.append(means[3] / means[1])
        rows.append([robot, *(f"{mean:.3f}" for mean in means), f"{ratios[-1]:.2f}"])
        report.result(f"poor {robot}", means.tolist())
    headings = ["robot", "pick and place", "+ random", "+ generic design", "+ designed from it", "designed to random"]
    caption = f"mean of designed to random: {np.mean(ratios):.3f}"
    report.table(f"Error of predicted efforts after 60 s of pick and place, {truths} truths", headings, rows, caption)


def _error_after(
    knowledge: Belief, recordings: list[Recorded], true: FloatArray, others: list[ExcitingMotion]
) -> float:
    return predicted_error(knowledge, identified(knowledge, recordings).parameters, true, others)


def _pick_and_place(own: DesignTask, true: FloatArray, random: np.random.Generator) -> _Poor:
    """A minute of the same two small motions to and fro."""
    form = MotionForm(period=6.0, slow_fraction=0.999, repeats=10)
    motion = ExcitingMotion(
        form, own.feasibility.start, random.standard_normal((form.size, len(own.feasibility.start)))
    )
    keep = np.zeros((form.size, 1))
    keep[form.waves :] = 1.0
    small = motion.scaled(keep)
    feasible = own.feasibility.shrunk_to_feasible(small.scaled(0.5 * own.feasibility.largest_scale(small)))
    recording = recorded(own.belief, feasible, true, random)
    found = identified(own.belief, [recording])
    return _Poor(
        recording, belief_from_estimate(own.belief.model, found.posterior, own.belief.sigmas.tolist(), "estimate")
    )


def _knowing(own: DesignTask, knowledge: Belief) -> DesignTask:
    """The task of one who knows that."""
    before = own.feasibility
    feasibility = Feasibility(knowledge, before.limits, before.start, before.collision)
    return replace(own, belief=knowledge, feasibility=feasibility)
