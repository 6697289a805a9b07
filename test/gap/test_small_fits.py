"""The joint fit on designs of random columns: its objective, its uncertainty, and what is known before."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from geomid_ros.estimation.profile_objective import Profile, ProfileObjective
from geomid_ros.gap.candidates import CLEARLY, parameters
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.inference import prior as before
from geomid_ros.inference.candidates import Candidate, EffectTerm
from geomid_ros.inference.design import ChannelRows, Design
from geomid_ros.inference.fit import JointFit, fit, fit_of_prior, scattered
from geomid_ros.inference.prior import GAIN, OtherRecordings
from geomid_ros.inference.remainder import DEFAULT_VARIANCE
from geomid_ros.inference.selection import ScoreTest, Selection, score_tests
from geomid_ros.model.effects import AtSensor
from geomid_ros.model.effects.sensor_errors import WrenchOffset
from geomid_ros.types import FloatArray

from .planted import model
from .small import LINK, PAYLOAD, PRIOR, ROWS, Recording, at

VISCOUS, OFFSET, ELSEWHERE = at("viscous_friction", 0), at("effort_offset", 0), at("viscous_friction", 1)
COULOMB = at("coulomb_friction", 0)
NAMES = (VISCOUS, OFFSET, ELSEWHERE)
MODEL = model()
TERM = VISCOUS.terms[0]
STEP = 1e-5


def score_test(design: Design, current: JointFit, candidate: Candidate) -> ScoreTest:
    (trial,) = score_tests(design, current, [candidate])
    return trial


def designed(seed: int, value: float = 0.3, link: FloatArray = LINK) -> Design:
    return Recording(seed, NAMES).design({TERM: value}, link)


def objective(counts: float = 1.0) -> ProfileObjective:
    """At no minimum; ``counts`` of rows, relative."""
    design = designed(1)
    manifold = ParameterManifold(1, 0, np.array([0.5, 2.0]))
    known = np.random.default_rng(2).normal(size=(4, manifold.dimension + 1))
    profile = Profile(
        manifold,
        design.gather([], [TERM, OFFSET.terms[0]]),
        counts * design.counts,
        manifold.point(np.append(LINK, [0.1, 0.0])),
    )
    return ProfileObjective(profile, np.append(np.full(10, 3.0), [1.0, 5.0]), known.T @ known)


def moved(own: ProfileObjective, direction: FloatArray, steps: tuple[float, ...]) -> list[float]:
    """Values along a straight line."""
    start = own.manifold.point(np.append(1.1 * LINK, [0.2, -0.1]))
    return [own.evaluate(own.manifold.straight(start, step * direction)).value for step in steps]


def test_the_gradient_is_the_slope_of_the_value() -> None:
    own = objective()
    start = own.manifold.point(np.append(1.1 * LINK, [0.2, -0.1]))
    gradient = own.evaluate(start).gradient
    for direction in np.eye(own.manifold.dimension):
        ahead, behind = moved(own, direction, (STEP, -STEP))
        assert gradient @ direction == pytest.approx((ahead - behind) / (2.0 * STEP), rel=1e-5, abs=1e-4)


def test_the_hessian_of_what_is_known_is_the_bend_of_the_value() -> None:
    """Without rows that are measured; those bend by their information alone."""
    own, step = objective(counts=0.0), 1e-3
    start = own.manifold.point(np.append(1.1 * LINK, [0.2, -0.1]))
    hessian = own.evaluate(start).hessian
    for direction in np.random.default_rng(4).normal(size=(8, own.manifold.dimension)):
        unit = direction / np.linalg.norm(direction)
        ahead, here, behind = moved(own, unit, (step, 0.0, -step))
        assert unit @ hessian @ unit == pytest.approx((ahead - 2.0 * here + behind) / step**2, rel=1e-3)


def test_a_row_that_a_name_explains_exactly_does_not_lose_itself_in_the_remainder() -> None:
    """Beside other recordings the remainder grows with what is named, in units of a noise of which one row says
    nothing: the two in turn, each larger by the other, stay within rounding."""
    whole = designed(3)
    first, other = whole.channels
    few = ChannelRows(
        first.columns[:1], np.ones((1, 1)), np.zeros(1, dtype=np.intp), first.place, first.links, 1e-3 * np.eye(1)
    )
    design, found = Design.of((few, other), whole.dimension), None
    for _ in range(6):
        found = fit(design, PRIOR, [VISCOUS], found)
        design = found.with_fitted_remainder(design)
        assert design.gather([], found.terms).targets[0] > 0.0
        assert np.isfinite(found.score)


@pytest.mark.parametrize("candidate", [PAYLOAD, VISCOUS])
def test_beside_other_recordings_each_block_may_change_by_a_twentieth_of_what_is_named(candidate: Candidate) -> None:
    """No effect acts exactly as its columns state, and a body does not either."""
    whole = designed(3)
    features = np.random.default_rng(4).normal(size=(ROWS, 2))
    rows = [ChannelRows(c.columns, features, np.arange(2), c.place, c.links, 1e-3 * np.eye(2)) for c in whole.channels]
    design = Design.of(rows, whole.dimension)
    found = fit(design, PRIOR, [candidate])
    changes = np.array(found.with_fitted_remainder(design).variances) - DEFAULT_VARIANCE
    powers = design.powers(candidate, found.changes[candidate]) / found.squares
    np.testing.assert_allclose(changes, np.outer(0.05**2 * powers, [1.0, 1.0]), rtol=1e-6, atol=1e-12)
    assert np.max(changes) > 0.0


def test_standard_deviations_are_those_of_the_errors() -> None:
    """Over robots: mean squares of errors in standard deviations, false once in ten thousand."""
    errors = []
    for seed in range(60):
        found = fit(designed(seed), PRIOR, [VISCOUS, OFFSET, ELSEWHERE])
        stds = np.sqrt(np.diag(found.covariance))
        own = [(found.value(c.terms[0]) - 0.3 * (c is VISCOUS)) / stds[found.place(c.terms[0])] for c in NAMES]
        jacobian = found.manifold.whiten(found.point, np.eye(found.manifold.dimension))
        links = np.linalg.solve(jacobian, found.point.parameters - np.append(LINK, [0.3, 0.0, 0.0]))
        errors.append([*own, *(links @ found.information @ links / len(links),)])
    squares = np.sum(np.array(errors)[:, :3] ** 2)
    assert chi2.ppf(5e-5, 180) < squares < chi2.ppf(1.0 - 5e-5, 180)
    count = 60 * 13
    assert chi2.ppf(5e-5, count) < 13 * np.sum(np.array(errors)[:, 3]) < chi2.ppf(1.0 - 5e-5, count)


def test_what_a_joint_that_moves_one_way_feels_is_friction_rather_than_an_offset() -> None:
    """Sensors are rarely far off; `identify` expects their offsets to be as small."""
    recording = Recording(7, [COULOMB, OFFSET])
    recording.columns = dict.fromkeys(recording.columns, np.ones(ROWS))
    search = Selection(recording.design({COULOMB.terms[0]: 1.0}), PRIOR, [COULOMB, OFFSET])
    assert search.fit([COULOMB]).score < search.fit([OFFSET]).score - CLEARLY
    found = search.fit([COULOMB, OFFSET])
    assert found.value(COULOMB.terms[0]) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("planted", "expected"), [(0.05, 0.1), (0.2, 0.2), (0.6, 0.5)])
def test_the_spread_is_the_one_of_the_best_score(planted: float, expected: float) -> None:
    """And follows the links' errors, as far as one link tells."""
    spreads = []
    for seed in range(8):
        direction = np.random.default_rng(seed).standard_normal((4, 4))
        root = scipy.linalg.sqrtm(pseudo_inertia.from_parameters(LINK))
        body = root @ spd.sym_exp(planted * 0.5 * (direction + direction.T)) @ root
        design = designed(seed, link=np.asarray(pseudo_inertia.to_parameters(body)))
        found = fit(design, PRIOR, [])
        spreads.append(found.prior_stds[0])
        around = [
            fit(design, PRIOR, [], prior_std=float(found.prior_stds[0]) * factor).score for factor in (0.75, 1.0, 1.35)
        ]
        assert around[1] == min(around)
    assert np.median(spreads) == pytest.approx(expected, rel=0.35)


def test_a_spread_that_is_certain_stays() -> None:
    far = designed(1, link=2.0 * LINK)
    assert fit(far, replace(PRIOR, certainty=1e7), []).prior_stds[0] == pytest.approx(0.2, rel=1e-3)
    assert fit(far, PRIOR, []).prior_stds[0] > 0.25
    assert fit(far, replace(PRIOR, prior_std=1e-3, certainty=1e-3), [], prior_std=0.07).prior_stds[0] == 0.07


class TestWhatTheModelHas:
    """Effects with values and spreads that are known before."""

    def fit(self, value: float, spread: float, chosen: tuple[Candidate, ...] = (), planted: float = 0.3) -> JointFit:
        prior = replace(PRIOR, terms=(TERM,), values=np.array([value]), prior_stds=np.array([spread]))
        return fit(designed(5, planted), prior, chosen)

    def test_of_two_that_are_as_sure_the_mean_is_taken(self) -> None:
        free = self.fit(0.0, 1e3)
        std = float(np.sqrt(free.covariance[free.place(TERM), free.place(TERM)]))
        known = free.value(TERM) + 2.0 * std
        both = self.fit(known, std)
        middle = 0.5 * (known + free.value(TERM))
        assert both.value(TERM) == pytest.approx(middle, abs=0.1 * std)
        found = np.sqrt(both.covariance[both.place(TERM), both.place(TERM)])
        assert found == pytest.approx(std / np.sqrt(2.0), rel=0.05)


class TestScoreTest:
    def test_separability_is_the_share_of_a_column_that_the_others_cannot_imitate(self) -> None:
        """By least squares on all other columns of the channel, without a prior to speak of."""
        recording = Recording(7, [VISCOUS, COULOMB])
        recording.columns[TERM] += 2.0 * recording.columns[COULOMB.terms[0]] + recording.coefficients[:, 0, 0]
        recording.coefficients[:, 1] *= 1e-3  # else the other channel tells the inertias, and they imitate less
        design = recording.design({TERM: 0.3})
        current = fit(design, replace(PRIOR, certainty=1e6, prior_std=50.0), [COULOMB], prior_std=50.0)
        separability = score_test(design, current, VISCOUS).separability
        others = np.column_stack([recording.coefficients[:, 0], recording.columns[COULOMB.terms[0]]])
        column = recording.columns[TERM]
        left = column - others @ np.linalg.lstsq(others, column)[0]
        assert separability == pytest.approx(float(left @ left / (column @ column)), rel=0.02)

    def test_what_reaches_nothing_or_has_the_wrong_sign_brings_nothing(self) -> None:
        recording = Recording(1, [COULOMB])
        design = recording.design({COULOMB.terms[0]: -0.3})
        bare = fit(design, PRIOR, [])
        trial = score_test(design, bare, COULOMB)
        assert trial.gain == -np.inf
        assert trial.separability > 0.5
        nowhere = score_test(design, bare, at("spring", 5))
        assert (nowhere.gain, nowhere.separability) == (-np.inf, 0.0)
        positive = Recording(1, [COULOMB]).design({COULOMB.terms[0]: 0.3})
        assert score_test(positive, fit(positive, PRIOR, []), COULOMB).gain > 100.0

    @pytest.mark.parametrize("value", [0.05, 3.0])
    def test_it_foretells_the_gain_of_the_fit(self, value: float) -> None:
        design = designed(8, value)
        bare = fit(design, PRIOR, [])
        gain = score_test(design, bare, VISCOUS).gain
        exact = bare.score - fit(design, PRIOR, [VISCOUS], prior_std=float(bare.prior_stds[0])).score
        assert gain == pytest.approx(exact, rel=0.05, abs=1.0)

    def test_it_foretells_it_beside_a_prior_that_pulls(self) -> None:
        """The link is another than the prior says, which holds it hard: a name that the link can imitate lets it go."""
        recording, spread = Recording(8, NAMES), 0.02
        recording.columns[TERM] += recording.coefficients[:, 0, 0]
        design = recording.design({TERM: 0.03}, 1.2 * LINK)
        bare = fit(design, PRIOR, [], prior_std=spread)
        gain = score_test(design, bare, VISCOUS).gain
        exact = bare.score - fit(design, PRIOR, [VISCOUS], bare, prior_std=spread).score
        assert gain == pytest.approx(exact, abs=2.0)


class TestBlocks:
    """Blocks of time that are left out."""

    def design(self, values: FloatArray) -> Design:
        """Of a recording with a name whose coefficient has these values in eight equal parts of time."""
        recording = Recording(9, NAMES)
        column = recording.columns[TERM]
        recording.columns[TERM] = np.repeat(values, ROWS // 8) * column
        targets = recording.targets({TERM: 1.0})
        recording.columns[TERM] = column
        return recording.design_of(targets)

    def test_a_size_is_as_unsure_as_the_blocks_scatter(self) -> None:
        """Eight values about their mean, against what white noise would leave of one value."""
        values = np.array([0.3, -0.25, 0.35, -0.2, 0.25, -0.3, 0.3, -0.25])
        constant, varying = (self.scattered(each) for each in (np.full(8, 0.1), values))
        assert varying == pytest.approx(np.std(values, ddof=1) / np.sqrt(8.0), rel=0.25)
        assert constant < 0.1 * varying

    def scattered(self, values: FloatArray) -> float:
        """The standard deviation of a coefficient that has these values in turn."""
        design = self.design(values)
        found = scattered(design, fit(design, PRIOR, [VISCOUS]))
        place = found.place(TERM)
        return float(np.sqrt(found.covariance[place, place]))


def known_rows(known: OtherRecordings) -> FloatArray:
    """Of a link and no effects."""
    return known.present_rows(10, 10, {})[0]


class TestOtherRecordings:
    KNOWN = OtherRecordings(np.random.default_rng(1).normal(size=(12, 10)), np.arange(12.0))

    def test_effects_of_now_are_those_of_then_and_what_they_have_changed_by(self) -> None:
        """Their covariance is the sum of both, the probability of the rows is the integral over those of then. Of one
        that is another now only the integral is left, with its prior of then."""
        rng = np.random.default_rng(2)
        changes, spread = np.array([0.5, 2.0]), 3.0
        known = OtherRecordings(rng.normal(size=(12, 12)), rng.normal(size=12), changes)
        rows, cost = known.present_rows(20, 15, {})
        own = rows[:, [*range(10), 15, 16]]
        assert not np.any(rows[:, [*range(10, 15), 17, 18, 19]])
        then, now = (np.linalg.inv(each.T @ each) for each in (known.rows, own))
        np.testing.assert_allclose(now, then + np.diag([*np.zeros(10), *changes**2]), rtol=1e-8, atol=1e-8)
        best = [np.linalg.solve(*each) for each in ((known.rows, -known.residuals), (own, -rows[:, -1]))]
        np.testing.assert_allclose(*best, rtol=1e-8)
        determinants = [np.linalg.slogdet(each)[1] for each in (now, then)]
        assert cost == pytest.approx(determinants[0] - determinants[1])
        others, more = known.present_rows(20, 15, {1: spread})
        assert not np.any(others[:, 16])
        left = own.T @ own + np.diag([*np.zeros(11), spread**-2])
        links = left[:11, :11] - np.outer(left[:11, 11], left[11, :11]) / left[11, 11]
        kept = others[:, [*range(10), 15]]
        np.testing.assert_allclose(kept.T @ kept, links, rtol=1e-8, atol=1e-8)
        assert more - cost == pytest.approx(np.log(left[11, 11] * spread**2))

    def test_what_effects_may_have_changed_by_counts_in_the_score(self) -> None:
        """The same rows without a change that is to be integrated out are the more probable ones by that."""
        design = Recording(3, [VISCOUS]).design({})
        rng, nothing = np.random.default_rng(5), np.zeros(1)
        known = OtherRecordings(rng.normal(size=(3, 11)), rng.normal(size=3), np.array([1.5]))
        rows, cost = known.present_rows(11, 10, {})
        done = OtherRecordings(rows[:, :-1], rows[:, -1], nothing)
        prior = replace(PRIOR, terms=(TERM,), values=nothing, prior_stds=np.ones(1))
        scores = [fit(design, replace(prior, other_recordings=each), []).score for each in (known, done)]
        assert scores[0] - scores[1] == pytest.approx(cost)
        assert cost > 0.1

    def test_of_some_coefficients_the_others_are_as_they_were(self) -> None:
        known = OtherRecordings(np.arange(26.0).reshape(2, 13), np.zeros(2), np.zeros(3))
        some = known.of_coefficients(np.array([0, 2]), np.array([0.1, 0.2]))
        np.testing.assert_array_equal(some.rows, known.rows[:, [*range(11), 12]])
        assert some.links == 10

    def test_the_inflation_is_the_most_probable_one(self) -> None:
        """Of residuals in units of enlarged standard deviations, and of the inflation itself."""
        rows = known_rows(self.KNOWN)
        manifold = ParameterManifold(1, 0, np.zeros(0))
        prior = manifold.point(LINK)
        point = manifold.point(1.05 * LINK)
        squares = float(np.sum((rows @ np.append(0.05 * LINK, 1.0)) ** 2))
        best = minimize_scalar(
            lambda size: squares / np.exp(size) + before.cost_of_inflation(rows, float(np.exp(size)))
        )
        certain = 1e-6 * np.eye(10)
        found = before.inflation_of(rows, manifold, point, prior, certain)
        assert found == pytest.approx(np.exp(best.x), rel=1e-3)
        assert found > 5.0

    def test_what_the_fit_leaves_open_counts_as_error(self) -> None:
        rows = known_rows(replace(self.KNOWN, residuals=np.zeros(12)))
        manifold = ParameterManifold(1, 0, np.zeros(0))
        point = manifold.point(LINK)
        sure, unsure = (before.inflation_of(rows, manifold, point, point, std * np.eye(10)) for std in (1e-5, 1e3**0.5))
        assert sure == 1.0
        normals = manifold.whiten(point, rows[:, :-1])
        assert unsure == pytest.approx((1e3 * np.sum(normals**2) + 4.0) / (12 + 4.0))

    def test_rows_that_say_nothing_do_not_count(self) -> None:
        silent = np.vstack([self.KNOWN.rows, np.zeros((5, 10))])
        empty = OtherRecordings(silent, np.append(self.KNOWN.residuals, np.zeros(5)))
        assert before.cost_of_inflation(known_rows(empty), 7.0) == before.cost_of_inflation(known_rows(self.KNOWN), 7.0)


def test_a_payload_s_mass_and_centre_are_found() -> None:
    """Beside inertias that are nearly certain."""
    precise = replace(PRIOR, prior_std=1e-3, certainty=1e6)
    for mass, centre in ((0.1, [0.0, 0.0, 0.0]), (1.0, [0.5, -0.3, 0.2]), (1.5, [0.0, 1.0, 0.0])):
        offset = np.array(centre)
        about = (offset @ offset + 0.02) * np.eye(3) - np.outer(offset, offset)
        rows, columns = pseudo_inertia.INERTIA_ENTRIES
        body = mass * np.concatenate([[1.0], offset, about[rows, columns]])
        found = fit(Recording(2, []).design({}, LINK + body), precise, [PAYLOAD])
        payload = pseudo_inertia.to_parameters(found.point.pseudo_inertias)[1]
        stds = np.sqrt(np.diag(found.covariance))[10:20]
        np.testing.assert_array_less(np.abs(payload - body), 4.0 * stds)
        assert stds[0] < 0.1


def test_a_payload_s_parameters_are_as_sure_as_its_body() -> None:
    """By differences of mass, centre and central inertia with each of the body's ten parameters; and but for the gain
    of what is measured, which leaves the centre where it is."""
    design = Recording(2, []).design({}, 1.4 * LINK)
    found = fit(design, replace(PRIOR, prior_std=1e-3, certainty=1e6, identified=True), [PAYLOAD])
    quantities = parameters(MODEL, found, PAYLOAD)
    body = np.asarray(pseudo_inertia.to_parameters(found.point.pseudo_inertias))[1]

    def said(values: FloatArray) -> FloatArray:
        rows, columns = pseudo_inertia.INERTIA_ENTRIES
        central = pseudo_inertia.central_inertia(values)[rows, columns]
        return np.concatenate([values[:1], values[1:4] / values[0], central])

    step = 1e-6
    slopes = np.array([(said(body + d) - said(body - d)) / (2.0 * step) for d in step * np.eye(10)]).T
    stds = np.sqrt(np.diag(slopes @ found.covariance[10:20, 10:20] @ slopes.T))
    stds = np.hypot(stds, GAIN * said(body) * np.array([1.0, *3 * [0.0], *6 * [1.0]]))
    assert list(quantities) == [form.name for form in PAYLOAD.effect.parameters]
    np.testing.assert_allclose([q.value for q in quantities.values()], said(body))
    np.testing.assert_allclose([q.std for q in quantities.values()], stds, rtol=1e-3)
    assert [q.unit for q in quantities.values()] == ["kg", *["m"] * 3, *["kg m^2"] * 6]


def test_a_body_of_a_urdf_is_as_sure_as_the_data_make_it() -> None:
    """As if the URDF's errors were three times as large; what data or another identification tell keeps its std."""
    for identified, factor in ((False, 9.0), (True, 1.0)):
        prior = replace(PRIOR, prior_std=5.0, certainty=1e6, identified=identified)
        unseen, seen = fit_of_prior(prior), fit(designed(1), prior, ())
        np.testing.assert_allclose(unseen.body_covariance(0), factor * unseen.covariance[:10, :10], atol=1e-12)
        np.testing.assert_allclose(seen.body_covariance(0), seen.covariance[:10, :10], rtol=0.05, atol=1e-7)


def test_parameters_of_a_spring_are_as_sure_as_its_coefficients_together() -> None:
    spring = at("spring", 0)
    design = Recording(2, [ELSEWHERE, spring]).design(dict(zip(spring.terms, (2.0, -0.6), strict=True)))
    found = fit(design, PRIOR, [ELSEWHERE, spring])
    quantities = parameters(MODEL, found, spring)
    places = [found.place(term) for term in spring.terms]
    covariance = found.covariance[np.ix_(places, places)]
    stiffness, offset = (found.value(term) for term in spring.terms)
    slope = np.array([offset / stiffness**2, -1.0 / stiffness])
    assert quantities["stiffness"].std == pytest.approx(np.sqrt(covariance[0, 0]))
    assert quantities["equilibrium"].value == pytest.approx(-offset / stiffness)
    assert quantities["equilibrium"].std == pytest.approx(np.sqrt(slope @ covariance @ slope))


def test_a_sensor_s_offset_has_a_parameter_for_each_axis_with_its_unit() -> None:
    place = AtSensor("/wrench", (3, 4))
    own: Any = SimpleNamespace(
        channels=[*MODEL.channels, SimpleNamespace(axis="fx", unit="N"), SimpleNamespace(axis="tz", unit="N m")]
    )
    terms = tuple(EffectTerm(WrenchOffset(), place, index) for index in range(2))
    values = dict(zip(terms, (3.0, -0.5), strict=True))
    found: Any = SimpleNamespace(value=values.__getitem__, covariance_of={terms: np.diag([0.25, 0.01])}.__getitem__)
    quantities = parameters(own, found, Candidate(WrenchOffset(), place, terms))
    assert {name: (q.value, q.std, q.unit) for name, q in quantities.items()} == {
        "fx": (3.0, 0.5, "N"),
        "tz": (-0.5, 0.1, "N m"),
    }


@pytest.mark.parametrize(("excess", "known"), [(-3.0, None), (-3.0, "rows"), (-0.6, None)])
def test_known_dry_friction_drives_no_joint(excess: float, known: str | None) -> None:
    """Where the data would have it so, the fit is that of one column: friction that is nothing at standstill."""
    stribeck = at("stribeck_friction", 0)
    level, own = stribeck.terms
    recording = Recording(4, [stribeck, VISCOUS])
    design = recording.design({level: 1.0, own: excess})
    others = OtherRecordings(np.random.default_rng(1).normal(scale=3.0, size=(8, 10)), np.zeros(8)) if known else None
    wide = replace(PRIOR, other_recordings=others)
    found = fit(design, replace(wide, terms=(level, own), values=np.ones(2), prior_stds=np.full(2, 1e3)), [])
    if excess > -1.0:
        assert found.value(own) == pytest.approx(excess, abs=0.05)
        return
    assert found.value(level) + found.value(own) == pytest.approx(0.0, abs=1e-3)
    merged = Recording(4, [stribeck, VISCOUS])
    merged.columns[TERM] = merged.columns[level] - merged.columns[own]
    free = replace(wide, terms=(TERM,), values=np.ones(1), prior_stds=np.full(1, 1e3))
    one = fit(merged.design({level: 1.0, own: excess}), free, [])
    assert found.value(level) == pytest.approx(one.value(TERM), rel=1e-3)
    np.testing.assert_allclose(found.inertias, one.inertias, atol=1e-3)
