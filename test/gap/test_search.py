"""The search over sets of names, on designs of random columns."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from geomid_ros.inference import selection
from geomid_ros.inference.candidates import Candidate, EffectTerm
from geomid_ros.inference.design import ChannelRows, Design
from geomid_ros.inference.fit import JointFit, fit
from geomid_ros.inference.prior import Prior
from geomid_ros.inference.selection import Selection
from geomid_ros.model.effects.friction import SPEEDS, CoulombFriction, StribeckFriction
from geomid_ros.types import IntArray

from .small import LINK, PAYLOAD, PRIOR, ROWS, Recording, at

VISCOUS, OFFSET, ROTOR = (at(name, 0) for name in ("viscous_friction", "effort_offset", "rotor_inertia"))
OTHERS = tuple(at(name, 1) for name in ("viscous_friction", "effort_offset", "rotor_inertia"))
SPRING, COULOMB = at("spring", 0), at("coulomb_friction", 0)
CANDIDATES = (VISCOUS, OFFSET, ROTOR, *OTHERS, SPRING, COULOMB)
STRONG = 0.2  # a coefficient, of columns of size 1 under noise of 0.1


def search(
    planted: Mapping[Candidate, Sequence[float]] | None = None,
    *,
    seed: int = 0,
    among: Sequence[Candidate] = CANDIDATES,
    alike: Mapping[EffectTerm, EffectTerm] | None = None,
) -> Selection:
    """Of a robot with these coefficients of names."""
    recording = Recording(seed, among, alike)
    values = {t: v for c, all_of in (planted or {}).items() for t, v in zip(c.terms, all_of, strict=True)}
    return Selection(recording.design(values), PRIOR, among)


def names(found: JointFit | None) -> set[Candidate]:
    assert found is not None
    return set(found.chosen)


def test_what_is_planted_is_found_and_nothing_else() -> None:
    for seed in range(5):
        one = search({VISCOUS: [STRONG], OTHERS[1]: [-STRONG]}, seed=seed)
        assert names(one.optimise(one.fit([]))) == {VISCOUS, OTHERS[1]}
        none = search(seed=seed)
        assert names(none.optimise(none.fit([]))) == set()


def test_a_name_is_taken_that_is_worth_it() -> None:
    """The gain grows with the square of the coefficient; a name has to make up for its parameters, and more."""
    gains, taken = [], []
    for size in np.linspace(0.01, 0.05, 21):
        one = search({VISCOUS: [size]}, among=[VISCOUS])
        gains.append(one.fit([]).score - one.fit([VISCOUS]).score)
        taken.append(bool(one.grow(one.fit([])).chosen))
    assert taken == [gain > 0.0 for gain in gains]
    assert 0 < sum(taken) < len(taken)


def test_what_a_chosen_name_excludes_is_not_tried() -> None:
    one = search({SPRING: [0.3, 0.3]})
    tried = [trial.candidate for trial in one.ranked(one.fit([SPRING]))]
    assert OFFSET not in tried
    assert SPRING not in tried
    assert OTHERS[1] in tried


def test_names_with_a_wrong_sign_are_impossible() -> None:
    for size in (STRONG, -STRONG):
        one = search({COULOMB: [size]}, among=[COULOMB])
        assert one.is_plausible(one.fit([COULOMB])) == (size > 0.0)
        assert names(one.optimise(one.fit([]))) == ({COULOMB} if size > 0.0 else set())
        assert names(one.within_range(one.fit([COULOMB]))) == ({COULOMB} if size > 0.0 else set())


def test_a_payload_that_outweighs_the_robot_is_impossible() -> None:
    for times, possible in ((0.5, True), (1.5, False)):
        recording = Recording(1, [])
        heavy = Selection(recording.design({}, link=(1.0 + times) * LINK), replace(PRIOR, prior_std=1e-2), [PAYLOAD])
        precise = replace(PRIOR, prior_std=1e-3, certainty=1e6)
        heavy = Selection(heavy.design, precise, [PAYLOAD])
        found = heavy.fit([PAYLOAD])
        mass = found.point.pseudo_inertias[1, 3, 3]
        assert mass == pytest.approx(times * LINK[0], rel=0.05)
        assert heavy.is_plausible(found) == possible


def test_pruning_leaves_out_what_is_not_worth_its_parameters_and_nothing_else() -> None:
    one = search({VISCOUS: [STRONG], OTHERS[1]: [STRONG]})
    everything = one.fit([VISCOUS, OFFSET, ROTOR, *OTHERS])
    assert names(one.prune(everything)) == {VISCOUS, OTHERS[1]}
    assert one.prune(one.fit([VISCOUS, OTHERS[1]])) is one.fit([VISCOUS, OTHERS[1]])


def test_rivals_stand_in_the_place_of_a_name() -> None:
    """Two columns are nearly the same; a third name is no rival however well it fits."""
    one = search({VISCOUS: [STRONG], OFFSET: [0.02]}, alike={ROTOR.terms[0]: VISCOUS.terms[0]}, among=CANDIDATES[:6])
    current = one.fit([VISCOUS])
    rivals = one.rivals(current, VISCOUS)
    assert [names(rival) for rival in rivals] == [{ROTOR}]
    assert rivals[0].score > current.score


SPEEDY = [at(StribeckFriction(speed, 0.003), 0) for speed in SPEEDS[:9]]


def test_the_constant_is_found_among_many() -> None:
    """Each constant's column is like the next one's."""
    own = [candidate.terms[1] for candidate in SPEEDY]
    recording = Recording(5, SPEEDY)
    for before, after in pairwise(own):
        recording.columns[after] = recording.columns[before] + 0.5 * recording.columns[after]
    truth = SPEEDY[6]
    design = recording.design(dict(zip(truth.terms, (STRONG, STRONG), strict=True)))
    one = Selection(design, PRIOR, SPEEDY)
    assert names(one.optimise(one.fit([]))) == {truth}


def test_a_rival_comes_with_the_constants_that_suit_it() -> None:
    """Of friction the blunter form and a quadratic one leave next to nothing of the sharper form and a viscous one,
    while neither of these suits either of those."""
    blunt, sharp = (at(CoulombFriction(smoothing), 0) for smoothing in (0.2, 0.02))
    quadratic = at("quadratic_friction", 0)
    among = [blunt, sharp, VISCOUS, quadratic]
    recording = Recording(6, among)
    columns, shared = recording.columns, np.random.default_rng(7).normal(size=400)
    columns[VISCOUS.terms[0]] = shared + columns[quadratic.terms[0]] + 0.3 * columns[VISCOUS.terms[0]]
    columns[blunt.terms[0]] = columns[sharp.terms[0]] + shared
    one = Selection(recording.design({sharp.terms[0]: 1.0, VISCOUS.terms[0]: 1.0}), PRIOR, among)
    trapped = one.fit([blunt, quadratic])
    assert min(one.fit(pair).score for pair in ([blunt, VISCOUS], [sharp, quadratic])) > trapped.score
    assert {sharp, VISCOUS} in [names(rival) for rival in one.rivals(trapped, quadratic)]
    assert names(one.optimise(trapped)) == {sharp, VISCOUS}


def test_a_name_that_turns_all_columns_ends_a_search_unless_it_is_the_last() -> None:
    """Of a tilted base the columns of all others depend on its size."""

    class Turning(type(VISCOUS.effect)):  # type: ignore[misc]
        name = "turning"
        relinearise_beyond = (0.01,)

    turning = at(Turning(), 1)
    one = search({turning: [1.0], VISCOUS: [STRONG]}, among=[VISCOUS, turning])
    assert names(one.grow(one.fit([]), to_the_end=False)) == {turning}
    assert names(one.optimise(one.fit([]))) == {turning, VISCOUS}
    assert names(one.grow(one.fit([turning]), to_the_end=False)) == {turning, VISCOUS}


NAMES = tuple(at(effect, joint) for effect in ("viscous_friction", "coulomb_friction", "spring") for joint in (0, 1))
TWO_LINKS = Prior(
    inertias=np.tile(LINK, 2), prior_std=0.2, terms=(), values=np.zeros(0), prior_stds=np.zeros(0), certainty=4.0
)


def channel(rng: np.random.Generator, link: int) -> ChannelRows:
    """Rows of a joint that carries one link alone, with viscous friction."""
    terms = [term for name in NAMES if name.terms[0].joints == (link,) for term in name.terms]
    columns = rng.normal(size=(ROWS, 11 + len(terms)))
    columns[:, -1] += columns[:, :10] @ LINK + 0.3 * columns[:, 10]
    places, links = {term: 10 + place for place, term in enumerate(terms)}, np.full(20, -1)
    links[10 * link : 10 * link + 10] = np.arange(10)
    return ChannelRows(columns, np.zeros((ROWS, 0)), np.zeros(0, dtype=np.intp), places, links)


def whole(current: JointFit) -> IntArray:
    """All parameters are one limb's."""
    return np.zeros(len(current.information), dtype=np.int64)


def test_a_limb_s_score_tests_are_those_beside_all_parameters(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    design = Design.of([channel(rng, 0), channel(rng, 1)], 20)
    current = fit(design, TWO_LINKS, [NAMES[0]])
    assert np.unique(selection._limbs(current)).tolist() == [0, 10]
    limbs = selection.score_tests(design, current, NAMES[1:])
    monkeypatch.setattr(selection, "_limbs", whole)
    for own, dense in zip(limbs, selection.score_tests(design, current, NAMES[1:]), strict=True):
        assert own.candidate is dense.candidate
        assert own.gain == pytest.approx(dense.gain, rel=1e-8)
        assert own.separability == pytest.approx(dense.separability, rel=1e-8)
