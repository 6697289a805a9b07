"""Findings, rivals, what is left without a name, and the words for it."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.gap import candidates as library
from geomid_ros.gap import verdict
from geomid_ros.gap.candidates import settled_by
from geomid_ros.gap.records import Records
from geomid_ros.gap.result import Finding, GapResult, ResidualDependence
from geomid_ros.gap.verdict import locate_residuals, share, strongest
from geomid_ros.gap.workflow import find_gap
from geomid_ros.inference.prior import GAIN
from geomid_ros.model.effects import EFFECTS, Quantity
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import SMOOTH_SIGN, Samples
from geomid_ros.types import FloatArray

from . import planted

MODEL = planted.model()
JOINTS = MODEL.robot.joint_names
CANDIDATES = library.candidates(MODEL)
PAYLOAD = next(c for c in CANDIDATES if c.payload == len(MODEL.identified) - 1)


RNG = np.random.default_rng(3)
VARIABLE = RNG.uniform(-1.0, 1.0, 4000)
NOISE = RNG.standard_normal(4000)
SMOOTH = np.sin(2.0 * VARIABLE)
GAPS = np.where(np.arange(4000) % 3 == 0, np.nan, 0.0)
WILD = np.where(np.arange(4000) < 10, 1e6, 1.0) * VARIABLE  # does not spoil its curve


@pytest.mark.parametrize(
    ("values", "variable", "least", "most"),
    [
        (SMOOTH, VARIABLE, 0.99, 1.0),
        (NOISE, VARIABLE, 0.0, 0.01),
        (2.0 * VARIABLE + NOISE, VARIABLE, 0.541, 0.601),  # 4/3 of 7/3
        (np.sin(6.0 * VARIABLE), WILD, 0.9, 1.0),
        (np.arange(12.0), np.arange(12.0), 0.0, 0.0),  # too few
        (np.arange(14.0), np.arange(14.0), 0.9, 1.0),
        (VARIABLE, np.ones(4000), 0.0, 0.0),  # one place
    ],
)
def test_a_curve_of_one_variable_explains_a_share(
    values: FloatArray, variable: FloatArray, least: float, most: float
) -> None:
    assert least <= share(values, variable) <= most


def test_what_curves_explain_of_noise_or_is_not_measured_does_not_count() -> None:
    shares = [share(np.random.default_rng(k).standard_normal(60), VARIABLE[:60]) for k in range(200)]
    assert 0.0 <= min(shares) < 0.01
    assert np.mean(shares) < 0.1
    values, kept = SMOOTH + NOISE, np.isfinite(GAPS)
    assert share(values + GAPS, VARIABLE) == share(values[kept], VARIABLE[kept])


def located(residual: FloatArray, load: FloatArray, motion: FloatArray, channels: Any = MODEL.channels) -> Any:
    """Of a motion: position and velocity ``(2, N, J)``."""
    model: Any = SimpleNamespace(channels=channels)
    samples = SimpleNamespace(seconds=np.arange(len(residual)) * 0.01, position=motion[0], velocity=motion[1])
    records: Any = SimpleNamespace(samples=samples)
    return locate_residuals(model, records, residual, load)


def test_a_remainder_is_located_by_what_it_depends_on() -> None:
    """At three joints: on the second one's position, and on the direction of the third; the first shows its load."""
    rng = np.random.default_rng(8)
    motion = position, velocity = rng.uniform(-1.0, 1.0, (2, 3000, 3))
    load = rng.uniform(0.0, 5.0, (3000, 3))
    residual = np.column_stack([(load[:, 0] - 2.5) ** 2 - 2.0, np.sin(3.0 * position[:, 1]), np.sign(velocity[:, 2])])
    found = located(residual, load, motion)
    assert [entry.channel for entry in found] == list(JOINTS)
    assert [strongest(entry) for entry in found] == ["load", "position", "reversals"]
    drifting = np.column_stack([np.linspace(-1.0, 1.0, 3000)] * 3)
    assert [strongest(entry) for entry in located(drifting, load, motion)] == ["time"] * 3
    assert [strongest(entry) for entry in located(velocity**3, load, motion)] == ["velocity"] * 3
    nothing = ResidualDependence("wrench/fx", 0.0, 0.0, 0.0, 0.0, 0.0)
    assert strongest(nothing) == "unknown", "not the first in line"


def test_a_wrench_depends_on_load_and_time_alone() -> None:
    load = np.random.default_rng(1).uniform(size=(500, 1))
    channels = (SimpleNamespace(name="wrench/fx", joint=None),)
    (found,) = located(load - 0.5, load, np.zeros((2, 500, 0)), channels)
    assert (found.channel, strongest(found)) == ("wrench/fx", "load")
    assert (found.velocity, found.position, found.reversals) == (0.0, 0.0, 0.0)


def finding(effect: str, parameters: dict[str, Quantity], probability: float = 1.0, **place: Any) -> Finding:
    """A finding without rivals."""
    rest = {"rivals": (), "separability": 1.0, "loss": 9.0, "share": 1.0, "was": {}, "settled_by": ""}
    return Finding(effect=effect, parameters=parameters, probability=probability, **rest, **place)


@pytest.mark.parametrize(("separable", "expected"), [(1.0, 0.1), (0.25, 0.2), (0.0, 1.0)])
def test_the_remainder_counts_by_the_part_of_the_columns_that_determines_a_size(
    separable: float, expected: float
) -> None:
    spring = next(c for c in CANDIDATES if c.name == "spring")
    found = widened(spring, {"stiffness": Quantity(2.0, 0.0, "N m/rad")}, separable, identified=True)
    assert found["stiffness"].std == pytest.approx(2.0 * expected)


@pytest.mark.parametrize(("identified", "expected"), [(True, 0.0), (False, 0.9 * GAIN)])
def test_a_gain_beside_a_drawing_is_as_uncertain_as_the_others_are(identified: bool, expected: float) -> None:
    gain = next(c for c in CANDIDATES if c.name == "effort_gain")
    found = widened(gain, {"gain": Quantity(0.9, 0.01, "-")}, 1.0, of_remainder=0.0, identified=identified)
    assert found["gain"].std == pytest.approx(np.hypot(0.01, expected))


def widened(
    candidate: Any, sizes: dict[str, Quantity], separable: float, *, identified: bool, of_remainder: float = 0.1
) -> dict[str, Quantity]:
    """Sizes of a new effect with the doubt of the remainder."""
    search, support = SimpleNamespace(prior=SimpleNamespace(identified=identified)), {"relative_std": of_remainder}
    analysis: Any = SimpleNamespace(search=search, supports={candidate: SimpleNamespace(**support)})
    return verdict.widened_by_remainder(analysis, candidate, sizes, {}, separable)


FOUND = {"level": Quantity(0.5, 0.01, "N m"), "gain": Quantity(1.25, 0.1, "-")}


@pytest.mark.parametrize(
    ("joint", "link", "where"),
    [("elbow", "", " at 'elbow'"), ("elbow", "forearm", " at link 'forearm'"), ("", "", "")],
)
def test_a_sentence_says_what_where_and_how_much(joint: str, link: str, where: str) -> None:
    sure, likely = (finding("stribeck_friction", FOUND, p, joint=joint, link=link) for p in (1.0, 0.6))
    values = "level 0.5 ± 0.02 N m, gain 1.25 ± 0.2 (95 % interval)."
    assert sure.sentence == f"Stribeck friction{where}: {values}"
    assert likely.sentence == f"Perhaps Stribeck friction{where}: {values}"


def test_a_sentence_says_the_first_parameters_or_the_first_moment_where_no_mass_is_told() -> None:
    found = {name: Quantity(1.0, 0.1, "m") for name in ("mass", "com_x", "com_y", "com_z", "ixx")}
    text = finding("payload", found, joint="wrist", link="hand").sentence
    assert text.startswith("A payload at link 'hand': mass 1 ± 0.2 m,")
    assert "com_z" in text
    assert "ixx" not in text
    moment = {"m x": Quantity(0.02, 0.001, "kg m")}
    assert "m x 0.02 ± 0.002 kg m" in finding("payload", found, joint="wrist", link="hand", moment=moment).sentence


def test_what_settles_payloads_at_two_links_is_a_motion_that_turns_both() -> None:
    payload, spring = EFFECTS["payload"](), EFFECTS["spring"]()
    both = settled_by(payload, "wrist", [(payload, "elbow"), (spring, "base")])
    assert both == "a motion that turns 'wrist', 'elbow' through their ranges"
    assert settled_by(payload, "wrist", [(spring, "base")]) == payload.settled_by
    assert settled_by(spring, "wrist", [(spring, "elbow")]) == spring.settled_by
    assert settled_by(payload, "wrist", []) == payload.settled_by


CREEP = 0.02  # [N m/s]


def test_uncertainty_of_the_fit_explains_what_noise_does_not() -> None:
    """Seven seconds teach little of a faster motion: what they leave of it is larger than noise, as much as is said."""
    squares, expected = [], []
    for seed in range(5):
        dynamics = planted.rigid(planted.true_inertias(seed, 0.1))
        train, unseen = planted.recording(dynamics, seed, 7.0), planted.recording(dynamics, 100 + seed, 20.0, pace=2.0)
        gap = find_gap(planted.model(), [train], [unseen], planted.CUTOFF).gap
        squares.append(gap.after**2)
        expected.append(gap.expected**2)
    assert np.mean(expected) > 1.1, "else this says nothing"
    assert np.mean(squares) == pytest.approx(np.mean(expected), rel=0.35)


def test_a_gap_that_stays_open_is_told_with_what_it_depends_on_and_nothing_is_named_for_it() -> None:
    """An effort that creeps in the unseen recording only, so that nothing can be learnt of it."""
    dynamics = planted.rigid(planted.true_inertias(3, 0.1))
    unseen = planted.recording(dynamics, 4, 30.0)
    creeping = unseen.effort.copy()
    creeping[:, 1] += CREEP * ((unseen.stamps - unseen.stamps[0]) * 1e-9 - 15.0)
    unseen = replace(unseen, effort=creeping)
    result = find_gap(planted.model(), [planted.recording(dynamics, 3)], [unseen], planted.CUTOFF)
    (entry,) = result.unexplained
    assert (result.verdict, entry.joint, entry.depends_on) == ("incomplete", JOINTS[1], "time")
    assert entry.gap == pytest.approx(result.moving[1], rel=0.01)
    assert result.findings == ()


SEED, JOINT = 20, 1


def coulomb(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """An arm with Coulomb friction at one joint."""
    efforts = planted.rigid(planted.true_inertias(SEED, 0.1))(q, v, a)
    efforts[:, JOINT] += 0.3 * np.sign(v[:, JOINT])
    return efforts


def unmeasured(samples: Samples, joints: Sequence[int]) -> Samples:
    effort = samples.effort.copy()
    effort[:, list(joints)] = np.nan
    return replace(samples, effort=effort)


TRAIN, UNSEEN = planted.recording(coulomb, SEED), planted.recording(coulomb, SEED + 1000, 15.0)


@pytest.mark.parametrize("unseen", [unmeasured(UNSEEN, range(3)), UNSEEN.select(slice(0, 8))], ids=["nothing", "short"])
def test_unseen_data_that_judge_nothing_are_refused(unseen: Samples) -> None:
    with pytest.raises(InputError, match="no usable held-out data"):
        find_gap(planted.model(), [TRAIN], [unseen])


def test_a_joint_of_which_nothing_is_measured_is_left_out_without_a_word() -> None:
    rest = [0, 2]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = find_gap(planted.model(), [unmeasured(TRAIN, [JOINT])], [unmeasured(UNSEEN, [JOINT])])
    assert result.verdict == "no gap"
    assert np.all(np.isfinite(result.gap.after[rest]))
    assert np.isnan(result.gap.after[JOINT])


def test_a_joint_that_moves_and_cannot_be_judged_is_not_without_a_gap() -> None:
    """Its dry friction is unsure at all unseen instants: whether it is what it was, nothing tells."""
    model = MeasurementModel(planted.model().robot, (EFFECTS["coulomb_friction"](),))
    known = np.concatenate([planted.true_inertias(SEED, 0.1).ravel(), [0.0, 0.3, 0.0]])
    entries, effects = UNSEEN.entries, UNSEEN.effects.copy()
    effects[:, entries.at(SMOOTH_SIGN, JOINT)] = 0.0

    def judged(unseen: Samples) -> GapResult:
        return find_gap(model, [TRAIN], [unseen], planted.CUTOFF, nominal=known)

    whole, blind = judged(UNSEEN), judged(replace(UNSEEN, effects=effects))
    assert (whole.verdict, whole.unjudged) == ("no gap", ())
    assert blind.verdict == "incomplete"
    assert JOINTS[JOINT] in blind.unjudged


def test_a_moment_without_an_effort_costs_that_moment_of_delayed_efforts() -> None:
    effort, missing = TRAIN.effort.copy(), slice(1000, 1010)
    effort[missing, JOINT] = np.nan
    records = Records.make([replace(TRAIN, effort=effort)], planted.CUTOFF)
    whole = Records.make([TRAIN], planted.CUTOFF)
    lag = 0.004  # [s]
    found, exact = (each.with_shifted_efforts(lag).dense[0].effort[:, JOINT] for each in (records, whole))
    known = np.isfinite(found)
    np.testing.assert_array_equal(np.flatnonzero(~known), [*range(999, 1010), len(TRAIN) - 1])
    away = known & (np.abs(np.arange(len(TRAIN)) - 1005) > 30)
    np.testing.assert_allclose(found[away], exact[away], atol=1e-6)


@pytest.mark.parametrize(
    ("curvature", "std"), [(8.0, np.sqrt(2.0 / 8.0 + np.log(2.0) ** 2 / 12.0)), (-8.0, 1.0), (0.5, 1.0)]
)
def test_the_std_of_a_grid_constant_is_that_of_a_parabola_widened_by_the_steps(curvature: float, std: float) -> None:
    """The score is minus twice a Gaussian's log, over constants a factor of two apart. At a maximum the std is 1."""
    names: list[Any] = [
        SimpleNamespace(effect=SimpleNamespace(grid_value=value), group="one", in_model=False)
        for value in (0.1, 0.2, 0.4)
    ]
    search = SimpleNamespace(
        hypotheses=names,
        fit=lambda chosen, _: SimpleNamespace(score=0.5 * curvature * np.log(chosen[-1].effect.grid_value / 0.25) ** 2),
    )
    analysis: Any = SimpleNamespace(search=search, effects=SimpleNamespace(chosen=[names[1]]))
    assert verdict._scanned_std(analysis, names[1]) == pytest.approx(std)
    assert verdict._scanned_std(analysis, names[0]) == 1.0  # at the edge of the grid
