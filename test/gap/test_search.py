"""The search over sets of names, on designs of random columns."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from geomid_ros.gap.candidates import AnyCandidate, Candidate, Term
from geomid_ros.gap.fitting.fit import JointFit
from geomid_ros.gap.search import beam_search
from geomid_ros.gap.search.beam_search import KEPT_PROMISE, LEAST_GAIN, Search
from geomid_ros.model.effects.places import AtJoints
from geomid_ros.model.effects.stribeck_friction import SPEEDS, StribeckFriction

from .small import LINK, PAYLOAD, PRIOR, Recording, at, curve

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
    curves: Sequence[AnyCandidate] = (),
    alike: Mapping[Term, Term] | None = None,
) -> Search:
    """Of a robot with these coefficients of names."""
    recording = Recording(seed, [*among, *curves], alike)
    values = {t: v for c, all_of in (planted or {}).items() for t, v in zip(c.terms, all_of, strict=True)}
    return Search(recording.design(values), PRIOR, among, curves)  # type: ignore[arg-type]


def names(found: JointFit | None) -> set[AnyCandidate]:
    assert found is not None
    return set(found.chosen)


def test_what_is_planted_is_found_and_nothing_else() -> None:
    for seed in range(5):
        one = search({VISCOUS: [STRONG], OTHERS[1]: [-STRONG]}, seed=seed)
        assert names(one.settle(one.fit([]))) == {VISCOUS, OTHERS[1]}
        none = search(seed=seed)
        assert names(none.settle(none.fit([]))) == set()


def test_a_name_is_taken_that_is_worth_it() -> None:
    """The gain grows with the square of the coefficient; a name has to make up for its parameters, and more."""
    gains, taken = [], []
    for size in np.linspace(0.01, 0.05, 21):
        one = search({VISCOUS: [size]}, among=[VISCOUS])
        gains.append(one.fit([]).score - one.fit([VISCOUS]).score)
        taken.append(one.grow(one.fit([])) is not None)
    assert taken == [gain > LEAST_GAIN for gain in gains]
    assert 0 < sum(taken) < len(taken)


def test_a_set_is_fitted_once_in_whatever_order() -> None:
    one = search()
    assert one.fit([VISCOUS, OFFSET]) is one.fit([OFFSET, VISCOUS])
    assert one.without(one.fit([VISCOUS, OFFSET]), OFFSET) is one.fit([VISCOUS])


def test_the_best_comes_first() -> None:
    one = search({VISCOUS: [0.1], OFFSET: [0.3], OTHERS[0]: [0.2]}, among=CANDIDATES[:6])
    assert one.ranked(one.fit([]))[0].candidate is OFFSET
    current, order = one.fit([]), []
    while (larger := one.grow(current)) is not None:
        order.append(names(larger) - names(current))
        current = larger
    assert order == [{OFFSET}, {OTHERS[0]}, {VISCOUS}]


def test_of_one_name_with_several_constants_the_best_is_ranked() -> None:
    slow, fast = (at(StribeckFriction(speed, 0.003), 0) for speed in (SPEEDS[0], SPEEDS[-1]))
    for better in (slow, fast):
        one = search({better: [0.3, 0.3]}, among=[slow, fast])
        (trial,) = one.ranked(one.fit([]))
        assert trial.candidate is better


def test_only_scouts_are_tried_before_a_name_is_chosen() -> None:
    scout, rest = (at(StribeckFriction(speed, 0.003), 0, scout=speed == SPEEDS[0]) for speed in SPEEDS[:2])
    one = search({rest: [0.3, 0.3]}, among=[scout, rest])
    assert [trial.candidate for trial in one.ranked(one.fit([]))] == [scout]
    assert [trial.candidate for trial in one.ranked(one.fit([]), [rest])] == [rest]


def test_what_a_chosen_name_excludes_is_not_tried() -> None:
    one = search({SPRING: [0.3, 0.3]})
    tried = [trial.candidate for trial in one.ranked(one.fit([SPRING]))]
    assert OFFSET not in tried
    assert SPRING not in tried
    assert OTHERS[1] in tried


def test_names_with_a_wrong_sign_are_impossible() -> None:
    for size in (STRONG, -STRONG):
        one = search({COULOMB: [size]}, among=[COULOMB])
        assert one.possible(one.fit([COULOMB])) == (size > 0.0)
        assert names(one.settle(one.fit([]))) == ({COULOMB} if size > 0.0 else set())
        assert names(one.without_absurd(one.fit([COULOMB]))) == ({COULOMB} if size > 0.0 else set())


def test_an_absurd_name_becomes_the_simple_one_in_it() -> None:
    """A spring that rests many turns away is an offset."""
    one = search({OFFSET: [1.0]}, among=[SPRING, OFFSET, VISCOUS])
    stiff = one.fit([SPRING, VISCOUS])
    assert not one.possible(stiff)
    assert names(one.without_absurd(stiff)) == {OFFSET, VISCOUS}


def test_a_payload_that_outweighs_the_robot_is_impossible() -> None:
    for times, possible in ((0.5, True), (1.5, False)):
        recording = Recording(1, [])
        heavy = Search(recording.design({}, link=(1.0 + times) * LINK), replace(PRIOR, spread=1e-2), [PAYLOAD])
        precise = replace(PRIOR, spread=1e-3, certainty=1e6)
        heavy = Search(heavy.design, precise, [PAYLOAD])
        found = heavy.fit([PAYLOAD])
        mass = found.point.pseudo_inertias[1, 3, 3]
        assert mass == pytest.approx(times * LINK[0], rel=0.05)
        assert heavy.possible(found) == possible


def test_a_payload_is_found_once() -> None:
    precise = replace(PRIOR, spread=1e-3, certainty=1e6)
    carrying = Search(Recording(1, [VISCOUS]).design({}, link=1.5 * LINK), precise, [VISCOUS, PAYLOAD])
    found = carrying.settle(carrying.fit([]))
    assert names(found) == {PAYLOAD}
    assert PAYLOAD not in [trial.candidate for trial in carrying.ranked(found)]


def test_pruning_leaves_out_what_is_not_worth_its_parameters_and_nothing_else() -> None:
    one = search({VISCOUS: [STRONG], OTHERS[1]: [STRONG]})
    everything = one.fit([VISCOUS, OFFSET, ROTOR, *OTHERS])
    assert names(one.prune(everything)) == {VISCOUS, OTHERS[1]}
    assert one.prune(one.fit([VISCOUS, OTHERS[1]])) is one.fit([VISCOUS, OTHERS[1]])


def test_a_name_that_is_worth_a_little_is_not_pruned() -> None:
    """Below a rough estimate of its worth it is tried to be left out; what it is worth then decides."""
    for size in np.linspace(0.015, 0.04, 11):
        one = search({VISCOUS: [size], OFFSET: [STRONG]}, among=[VISCOUS, OFFSET], seed=3)
        both = one.fit([VISCOUS, OFFSET])
        worth = one.fit([OFFSET]).score - both.score
        assert names(one.prune(both)) == ({VISCOUS, OFFSET} if worth > LEAST_GAIN else {OFFSET})


def test_rivals_stand_in_the_place_of_a_name() -> None:
    """Two columns are nearly the same; a third name is no rival however well it fits."""
    one = search({VISCOUS: [STRONG], OFFSET: [0.02]}, alike={ROTOR.terms[0]: VISCOUS.terms[0]}, among=CANDIDATES[:6])
    current = one.fit([VISCOUS])
    rivals = one.rivals(current, VISCOUS)
    assert [names(rival) for rival in rivals] == [{ROTOR}]
    assert rivals[0].score > current.score


def test_a_rival_promises_half_of_what_the_name_is_worth() -> None:
    for share, expected in ((0.9, [{ROTOR}]), (0.4, [])):
        one = search({VISCOUS: [STRONG], ROTOR: [share * STRONG]}, among=[VISCOUS, ROTOR], seed=4)
        found = [names(rival) for rival in one.rivals(one.fit([VISCOUS]), VISCOUS)]
        assert found == expected


def test_exchange_takes_the_better_of_two_alike() -> None:
    one = search({VISCOUS: [STRONG]}, alike={ROTOR.terms[0]: VISCOUS.terms[0]}, among=CANDIDATES[:6])
    assert names(one.exchange(one.fit([ROTOR]))) == {VISCOUS}
    assert one.exchange(one.fit([VISCOUS])) is one.fit([VISCOUS])


def test_one_exchange_mends_all_names() -> None:
    """At each of two joints one stands for its like."""
    truth = {VISCOUS: [STRONG], OTHERS[0]: [STRONG]}
    wrong = {ROTOR.terms[0]: VISCOUS.terms[0], OTHERS[2].terms[0]: OTHERS[0].terms[0]}
    one = search(truth, alike=wrong, among=CANDIDATES[:6])
    assert names(one.exchange(one.fit([ROTOR, OTHERS[2]]))) == {VISCOUS, OTHERS[0]}


def test_what_an_exchange_has_taken_away_is_not_exchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    """As the gains of single joints, when those of all take the place of a payload."""
    one, asked = search({OFFSET: [STRONG]}, among=CANDIDATES[:6]), []

    def exchanged(_: JointFit, candidate: AnyCandidate) -> list[JointFit]:
        asked.append(candidate)
        return [one.fit([OFFSET])]

    monkeypatch.setattr(one, "_exchanged", exchanged)
    assert names(one.exchange(one.fit([VISCOUS, ROTOR]))) == {OFFSET}
    assert asked == [VISCOUS]


@pytest.mark.parametrize(("sizes", "leads_by"), [((0.75,), "the second"), ((0.45, 0.45), "half its loss")])
def test_a_name_that_led_all_others_is_tried_again_once_the_search_has_gained_as_much(
    sizes: tuple[float, ...], leads_by: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    weak, strong = OTHERS[0], OTHERS[1 : 1 + len(sizes)]
    truth = {VISCOUS: [STRONG], weak: [0.2 * STRONG], **{c: [s * STRONG] for c, s in zip(strong, sizes, strict=True)}}
    one, asked = search(truth, among=list(truth)), set[AnyCandidate]()
    exchanged = one._exchanged

    def spied(current: JointFit, candidate: AnyCandidate) -> list[JointFit]:
        asked.add(candidate)
        return exchanged(current, candidate)

    monkeypatch.setattr(one, "_exchanged", spied)

    def asked_of(*chosen: AnyCandidate) -> set[AnyCandidate]:
        asked.clear()
        one.exchange(one.fit(chosen))
        return set(asked)

    alone, little, much = (one.fit([VISCOUS, *more]).score for more in ([], [weak], strong))
    leads = {"the second": one.fit(strong[:1]).score - alone, "half its loss": 0.5 * (one.fit([]).score - alone)}
    assert leads_by == min(leads, key=lambda by: leads[by])
    assert alone - little < leads[leads_by] < alone - much
    assert asked_of(VISCOUS) == {VISCOUS}
    assert one._contested_at[VISCOUS] == pytest.approx(alone - leads[leads_by])
    assert asked_of(VISCOUS) == set()
    assert asked_of(VISCOUS, weak) == {weak}
    assert asked_of(VISCOUS, *strong) == {VISCOUS, *strong}


def test_names_bring_what_the_score_test_promises() -> None:
    """Within the factor by which the search relies on it."""
    rng = np.random.default_rng(1)
    for seed in range(20):
        sizes = {c: rng.uniform(0.0, 1.0, len(c.terms)) for c in CANDIDATES[:6]}
        one = search({c: list(size) for c, size in sizes.items()}, seed=seed, among=CANDIDATES[:6])
        start = one.fit([])
        for trial in one.ranked(start):
            alone = one.fit([trial.candidate])
            assert not one.possible(alone) or start.score - alone.score < KEPT_PROMISE * max(trial.gain, 0.0) + 1.0


def test_what_promises_too_little_beside_the_best_is_not_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    fitted = []
    real = beam_search.fit
    monkeypatch.setattr(beam_search, "fit", lambda *given: (fitted.append(set(given[2])), real(*given))[1])
    for weak, expected in ((0.02, [{OFFSET}]), (0.9, [{OFFSET}, {OTHERS[0]}])):
        one = search({OFFSET: [1.0], OTHERS[0]: [weak]}, among=[OFFSET, OTHERS[0]])
        start = one.fit([])
        fitted.clear()
        assert names(one.grow(start)) == {OFFSET}
        assert [chosen for chosen in fitted if chosen] == expected


SPEEDY = [at(StribeckFriction(speed, 0.003), 0, scout=place % 4 == 0) for place, speed in enumerate(SPEEDS[:9])]


def test_neighbours_are_the_next_constants_of_the_same_name() -> None:
    elsewhere = [at(StribeckFriction(speed, 0.003), 1) for speed in SPEEDS[:9]]
    one = search(among=[*SPEEDY[::-1], *elsewhere, VISCOUS])
    assert one.neighbours(SPEEDY[4]) == [SPEEDY[3], SPEEDY[5]]
    assert one.neighbours(SPEEDY[0]) == [SPEEDY[1]]
    assert one.neighbours(SPEEDY[8]) == [SPEEDY[7]]
    assert one.neighbours(VISCOUS) == []
    assert one.neighbours(curve(0, "position", "curve")) == []


def test_the_constant_is_found_between_the_scouts() -> None:
    """Each constant's column is like the next one's."""
    own = [candidate.terms[1] for candidate in SPEEDY]
    recording = Recording(5, SPEEDY)
    for before, after in pairwise(own):
        recording.columns[after] = recording.columns[before] + 0.5 * recording.columns[after]
    truth = SPEEDY[6]
    design = recording.design(dict(zip(truth.terms, (STRONG, STRONG), strict=True)))
    one = Search(design, PRIOR, SPEEDY)
    assert names(one.settle(one.fit([]))) == {truth}


def test_a_simpler_name_is_taken_where_that_costs_little() -> None:
    among = [SPRING, OFFSET]
    only_offset = search({OFFSET: [STRONG]}, among=among)
    assert names(only_offset.simplified(only_offset.fit([SPRING]))) == {OFFSET}
    both = search({SPRING: [STRONG, STRONG]}, among=among)
    assert names(both.simplified(both.fit([SPRING]))) == {SPRING}


WAVE, DRIFT, ELSEWHERE = curve(0, "position", "wave", 2), curve(0, "time", "drift"), curve(1, "time", "drift")


def test_a_free_curve_is_added_where_it_is_worth_its_parameters() -> None:
    curves = [WAVE, DRIFT, ELSEWHERE]
    one = search({WAVE: [STRONG, STRONG]}, among=[VISCOUS], curves=curves)
    assert names(one.add_curve(one.fit([]))) == {WAVE}
    assert one.add_curve(one.fit([WAVE])) is None
    nothing = search(among=[VISCOUS], curves=curves)
    assert nothing.add_curve(nothing.fit([])) is None


def test_two_curves_of_one_variable_are_one_too_many() -> None:
    other = curve(0, "position", "curve")
    one = search({WAVE: [STRONG, STRONG], other: [STRONG]}, among=[VISCOUS], curves=[WAVE, other, ELSEWHERE])
    tried = [trial.candidate for trial in one.ranked(one.fit([WAVE]), one.curves)]
    assert tried == [ELSEWHERE]


def test_instead_of_a_name_a_curve_stands_at_the_same_joint() -> None:
    curves = [DRIFT, ELSEWHERE]
    one = search({VISCOUS: [STRONG]}, among=[VISCOUS], curves=curves, alike={DRIFT.terms[0]: VISCOUS.terms[0]})
    assert names(one.instead(one.fit([VISCOUS]), VISCOUS)) == {DRIFT}
    unlike = search({VISCOUS: [0.1 * STRONG]}, among=[VISCOUS], curves=[ELSEWHERE])
    assert unlike.instead(unlike.fit([VISCOUS]), VISCOUS) is None


def test_instead_of_a_name_of_two_joints_curves_stand_at_both() -> None:
    """A place of joints 0 and 1; a curve of another joint's motion may be what such a name says."""
    pair = replace(VISCOUS, place=AtJoints(0, 1))
    curves = [DRIFT, ELSEWHERE]
    alike = {DRIFT.terms[0]: VISCOUS.terms[0], ELSEWHERE.terms[0]: OTHERS[0].terms[0]}
    one = search({VISCOUS: [STRONG], OTHERS[0]: [STRONG]}, among=[VISCOUS, OTHERS[0]], curves=curves, alike=alike)
    instead = one.instead(one.fit([pair]), pair)
    assert names(instead) == {DRIFT, ELSEWHERE}


def test_a_name_that_turns_all_columns_ends_a_search_unless_it_is_the_last() -> None:
    """Of a tilted base the columns of all others depend on its size."""

    class Turning(type(VISCOUS.effect)):  # type: ignore[misc]
        name = "turning"
        far = (0.01,)

    turning = at(Turning(), 1)
    one = search({turning: [1.0], VISCOUS: [STRONG]}, among=[VISCOUS, turning])
    assert names(one.settle(one.fit([]))) == {turning}
    assert names(one.settle(one.fit([]), to_the_end=True)) == {turning, VISCOUS}
    assert names(one.settle(one.fit([turning]))) == {turning, VISCOUS}
