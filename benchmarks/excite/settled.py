"""Rivals that a designed motion tells apart: efforts by the true one, with noise, and both names fitted to them.

True efforts are made without the package's columns of effects: by shifted motions, by links that are behind, by
formulas. A finding is as large as makes a random motion undecided.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.excite.robots import SPREAD, task, wish
from benchmarks.report import Report
from geomid_ros.excitation.belief import ROWS_PER_SECOND
from geomid_ros.excitation.motion import ExcitingMotion
from geomid_ros.excitation.rivals import DECIDED, DiscriminationCriterion, discriminating_motion, responses
from geomid_ros.excitation.search import random_feasible
from geomid_ros.model.effects import OnLink, joints_of
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import samples_of
from geomid_ros.session.excitation import DesignTask, rival_effects
from geomid_ros.types import FloatArray

ROBOTS = ("panda", "ur10")
LEFT = 8.0  # difference of -2 log p that a random motion is expected to leave
SURE = 5.0  # of the score, beyond which a name is given: odds of 12 to 1
MOST = 5  # times that a motion is recorded
_FINE = 0.005  # [s]


@dataclass(frozen=True)
class Case:
    """A found effect and its rival, each at a joint by its place (None: the whole robot), and the parameters of what
    was found."""

    found: str
    at: int | None
    rival: str
    rival_at: int | None
    parameters: tuple[tuple[str, float, str], ...]


CASES = (
    Case("joint_elasticity", 1, "effort_delay", None, (("stiffness", 3000.0, "N m/rad"),)),
    Case("rotor_inertia", 4, "payload", -1, (("inertia", 0.05, "kg m^2"),)),
    Case("spring", 1, "effort_offset", 1, (("stiffness", 2.0, "N m/rad"), ("equilibrium", 0.3, "rad"))),
    Case("viscous_friction", 0, "coulomb_friction", 0, (("coefficient", 2.0, "N m s/rad"),)),
    Case("spring", 2, "payload", -1, (("stiffness", 2.0, "N m/rad"), ("equilibrium", -0.4, "rad"))),
)


def settled(report: Report, seconds: float, folder: Path) -> None:
    """Who is named after a designed motion, and after a random one."""
    rows, total = [], {"designed": [0, 0, 0], "random": [0, 0, 0]}
    for robot in ROBOTS:
        own = task(robot, wish(robot, seconds))
        for case in CASES:
            report.progress(f"{robot}: {case.found} or {case.rival}")
            for row, outcome in _outcomes(own, case, folder):
                rows.append([robot, case.found, case.rival, *row])
                for kind, decided in outcome.items():
                    total[kind][decided] += 1
    headings = ["robot", "found", "rival", "true", "expected", "random", "score", "random", "designed", "random"]
    count = sum(total["designed"])
    caption = "; ".join(
        f"{kind}: {right} right, {none} open, {wrong} wrong" for kind, (right, none, wrong) in total.items()
    )
    report.table(f"{count} cases", headings, rows, caption)
    report.result("settled", total)


def _outcomes(own: DesignTask, case: Case, folder: Path) -> list[tuple[list[str], dict[str, int]]]:
    random = np.random.default_rng(3)
    others = [random_feasible(own.feasibility, own.form, random) for _ in range(3)]
    judge = _sized(own, case, others, folder)
    designed = discriminating_motion(own.feasibility, own.form, judge, random)
    judge.prepare(others[0].scaled(0.5))
    found = []
    for true_is_found in (True, False):
        row = [case.found if true_is_found else case.rival]
        row += [f"{judge.smallest_difference(designed):.1f}", f"{judge.smallest_difference(others[1]):.1f}"]
        outcome, scores = {}, []
        times = int(np.clip(np.ceil(DECIDED / judge.smallest_difference(designed)), 1, MOST))
        for kind, motion in (("designed", designed), ("random", others[1])):
            scores.append(_score(own, judge, case, _repeated(motion, times), true_is_found))
            outcome[kind] = 0 if scores[-1] > SURE else 2 if scores[-1] < -SURE else 1
        words = ("right", "open", "WRONG")
        found.append(([*row, *(f"{score:.1f}" for score in scores), *(words[o] for o in outcome.values())], outcome))
    return found


def _repeated(motion: ExcitingMotion, times: int) -> ExcitingMotion:
    return ExcitingMotion(replace(motion.form, repeats=times), motion.start, motion.coefficients)


def _sized(own: DesignTask, case: Case, others: list[ExcitingMotion], folder: Path) -> DiscriminationCriterion:
    """The judge of a finding that is so large that random motions leave it open."""
    low, high = -7.0, 7.0  # of the logarithm of its size
    for _ in range(10):
        middle = 0.5 * (low + high)
        judge = _judge(own, case, float(np.exp(middle)), folder)
        judge.prepare(others[0].scaled(0.5))
        open_still = np.median([judge.smallest_difference(other) for other in others]) < LEFT
        low, high = (middle, high) if open_still else (low, middle)
    return judge


def _judge(own: DesignTask, case: Case, factor: float, folder: Path) -> DiscriminationCriterion:
    names = own.feasibility.names

    def place(index: int | None) -> str:
        return "" if index is None else names[index]

    # A compliance grows with its inverse; where a spring rests does not grow.
    sizes = {"stiffness": 1.0 / factor if case.found == "joint_elasticity" else factor, "equilibrium": 1.0}
    parameters: dict[str, Any] = {
        name: {"value": value * sizes.get(name, factor), "std": None, "unit": unit}
        for name, value, unit in case.parameters
    }
    rivals = [{"effect": case.rival, "joint": place(case.rival_at), "loss": 1.0}]
    finding = {"effect": case.found, "joint": place(case.at), "parameters": parameters, "rivals": rivals}
    path = folder / "gap.json"
    path.write_text(json.dumps({"format": 1, "findings": [finding], "floor": {}}), encoding="utf-8")
    return rival_effects(own.feasibility, path)


def _score(
    own: DesignTask, judge: DiscriminationCriterion, case: Case, motion: ExcitingMotion, true_is_found: bool
) -> float:
    """By how much the score of what is true is better: -2 log p with a penalty for each coefficient."""
    random = np.random.default_rng([1, true_is_found])
    model, sigmas = own.belief.model.without_effects(), own.belief.sigmas
    manifold = model.manifold(np.zeros(0))
    nominal = manifold.point(model.nominal_inertias)
    inertias = np.array(manifold.exp(nominal, SPREAD * random.standard_normal(len(model.nominal_inertias))).parameters)
    dispute, (variant, imitation) = judge.ambiguities[0], judge.imitations[0, 0]
    rival = dispute.rivals[0]
    name, coefficients = (case.found, dispute.coefficients) if true_is_found else (case.rival, imitation)
    effect = dispute.found.variants[0] if true_is_found else rival.variants[variant]
    place = dispute.found.place if true_is_found else rival.place
    times = np.arange(_FINE, motion.form.duration, _FINE)
    index = place.link if isinstance(place, OnLink) else next(iter(joints_of(place)), 0)
    true = _TRUE[name](model, inertias, motion, times, index, coefficients, getattr(effect, "smoothing", 0.0))
    chosen = np.arange(5, len(times) - 5, round(1.0 / (ROWS_PER_SECOND * _FINE)))
    measured = true[chosen] + sigmas * random.standard_normal((len(chosen), len(sigmas)))
    states = motion.at(times)[:3]
    target = (measured - _rigid(model, model.nominal_inertias, states[:, chosen])) / sigmas
    rows = manifold.whiten(nominal, _rows(model, states[:, chosen]).reshape(-1, model.dimension))
    rows = rows.reshape(len(chosen), len(sigmas), -1) / sigmas[:, None]
    scores = []
    for own_name in (dispute.found, rival):
        pairs = [(own_effect, own_name.place) for own_effect in own_name.variants]
        columns = [found[chosen] / sigmas[:, None] for found in responses(model, states, _FINE, pairs)]
        least = min(_left(rows, own_columns, target) for own_columns in columns)
        scores.append(least + np.log(target.size) * own_name.parameters)
    return float(scores[1] - scores[0] if true_is_found else scores[0] - scores[1])


def _left(rows: FloatArray, columns: FloatArray, target: FloatArray) -> float:
    """What inertias within their prior and columns leave of a target, squared."""
    size = rows.shape[2]
    both = np.concatenate([rows, columns], axis=2).reshape(target.size, -1)
    prior = np.zeros((size, both.shape[1]))
    prior[:, :size] = np.eye(size) / SPREAD
    stacked, wanted = np.concatenate([both, prior]), np.concatenate([target.ravel(), np.zeros(size)])
    return float(np.sum((wanted - stacked @ np.linalg.lstsq(stacked, wanted, rcond=None)[0]) ** 2))


def _rows(model: MeasurementModel, states: FloatArray) -> FloatArray:
    return model.rows(samples_of(states)).coefficients


def _rigid(model: MeasurementModel, inertias: FloatArray, states: FloatArray) -> FloatArray:
    return np.asarray(_rows(model, states) @ inertias)


_Truth = Callable[[MeasurementModel, FloatArray, ExcitingMotion, FloatArray, int, FloatArray, float], FloatArray]


def _elastic(
    model: MeasurementModel,
    inertias: FloatArray,
    motion: ExcitingMotion,
    times: FloatArray,
    joint: int,
    coefficients: FloatArray,
    _: float,
) -> FloatArray:
    """The links behind the gear's load, which is that of the links there."""
    motor = motion.at(times)[:3]
    efforts = _rigid(model, inertias, motor)
    for _round in range(3):
        behind = coefficients[0] * efforts[:, joint]
        links, rate = motor.copy(), np.gradient(behind, _FINE)
        for order, moved in enumerate((behind, rate, np.gradient(rate, _FINE))):
            links[order, :, joint] -= moved
        efforts = _rigid(model, inertias, links)
    return efforts


def _late(
    model: MeasurementModel,
    inertias: FloatArray,
    motion: ExcitingMotion,
    times: FloatArray,
    _joint: int,
    coefficients: FloatArray,
    _: float,
) -> FloatArray:
    return _rigid(model, inertias, motion.at(times - coefficients[0])[:3])


def _carried(
    model: MeasurementModel,
    inertias: FloatArray,
    motion: ExcitingMotion,
    times: FloatArray,
    link: int,
    coefficients: FloatArray,
    _: float,
) -> FloatArray:
    changed = inertias.copy()
    changed[10 * link : 10 * link + 10] += coefficients
    return _rigid(model, changed, motion.at(times)[:3])


def _at_joint(formula: Callable[[FloatArray, FloatArray, float], FloatArray]) -> _Truth:
    """An effect that adds a function of one joint's position, speed and acceleration to its effort."""

    def efforts(
        model: MeasurementModel,
        inertias: FloatArray,
        motion: ExcitingMotion,
        times: FloatArray,
        joint: int,
        coefficients: FloatArray,
        smoothing: float,
    ) -> FloatArray:
        states = motion.at(times)[:3]
        found = _rigid(model, inertias, states)
        found[:, joint] += formula(coefficients, states[:, :, joint], smoothing)
        return found

    return efforts


_TRUE: dict[str, _Truth] = {
    "joint_elasticity": _elastic,
    "effort_delay": _late,
    "payload": _carried,
    "rotor_inertia": _at_joint(lambda c, motion, _: c[0] * motion[2]),
    "spring": _at_joint(lambda c, motion, _: c[0] * motion[0] + c[1]),
    "effort_offset": _at_joint(lambda c, motion, _: np.full(motion.shape[1], c[0])),
    "viscous_friction": _at_joint(lambda c, motion, _: c[0] * motion[1]),
    "coulomb_friction": _at_joint(lambda c, motion, smoothing: c[0] * np.tanh(motion[1] / smoothing)),
}
