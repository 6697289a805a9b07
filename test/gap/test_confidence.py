"""How sure a name is: each rule alone, on analyses that nobody made."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from geomid_ros.gap.judgement import closing, confidence, verdict
from geomid_ros.gap.result import Confidence, Rival
from geomid_ros.model.effects import Quantity

from .judged import CANDIDATES, IDENTIFIED, JOINTS, PAYLOAD, Judged, curve, named

SURE = Judged()
OPEN = (1.0, 2.0, 1.0)  # times the floor: what unseen data leave at the second joint
ELSEWHERE = (1.0, 1.0, 2.0)  # and at the third
LEFT = replace(SURE, after=ELSEWHERE)
"""Something is left without a name, at another joint."""
CARRIED = replace(SURE, name=PAYLOAD, reached=(0, 1, 2))
COULOMB = replace(SURE, name=named("coulomb_friction"))
TILT = replace(SURE, name=named("gravity_tilt", None), reached=(0, 1, 2))
SIZE = {"size": Quantity(1.0, 0.01, "")}


@pytest.fixture(autouse=True)
def _every_name_generalises(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of time have a test of their own; and no curve contains a name."""
    monkeypatch.setattr(confidence, "generalises", lambda *_: True)
    all_curves_contain(monkeypatch, False)


def all_curves_contain(monkeypatch: pytest.MonkeyPatch, expected: bool) -> None:
    """Every name, or none."""
    for module in (closing, confidence):
        monkeypatch.setattr(module, "contains", lambda *_: expected)


def test_a_name_that_matters_and_leaves_nothing_is_sure() -> None:
    assert SURE.confidence() == "confident"
    assert CARRIED.confidence() == "confident"
    assert TILT.confidence() == "confident"


@pytest.mark.parametrize(
    ("rival", "expected"),
    [
        (Rival("spring", JOINTS[0], 5.0), "ambiguous"),
        (Rival("spring", JOINTS[0], 11.0), "ambiguous"),
        (Rival("spring", JOINTS[0], 14.0), "confident"),
        (Rival("stribeck_friction", JOINTS[1], 5.0), "ambiguous"),
    ],
)
def test_another_name_that_fits_nearly_as_well_makes_it_ambiguous(rival: Rival, expected: Confidence) -> None:
    assert replace(SURE, rivals=[Rival("payload", JOINTS[2], 500.0), rival]).confidence() == expected


RICHER = Rival("stribeck_friction", JOINTS[1], 5.0)


@pytest.mark.parametrize(
    ("rival", "after", "expected"),
    [
        (RICHER, (1.0, 1.0, 1.0), "confident"),
        (replace(RICHER, loss=0.0), (1.0, 1.0, 1.0), "confident"),
        (replace(RICHER, loss=-1.0), (1.0, 1.0, 1.0), "ambiguous"),
        (replace(RICHER, joint=JOINTS[0]), (1.0, 1.0, 1.0), "ambiguous"),
        (RICHER, OPEN, "ambiguous"),
        (RICHER, (1.0, 1.3, 1.0), "confident"),
        (replace(RICHER, loss=-1.0), (1.0, 1.3, 1.0), "confident"),
        (RICHER, ELSEWHERE, "confident"),
    ],
    ids=[
        "as good",
        "no better",
        "better",
        "elsewhere",
        "much is left here",
        "little is left here",
        "little, and better",
        "something is left elsewhere",
    ],
)
def test_a_name_that_contains_it_is_no_rival_unless_it_is_needed(
    rival: Rival, after: tuple[float, ...], expected: Confidence
) -> None:
    """Stribeck friction fits whatever Coulomb friction fits."""
    assert replace(COULOMB, rivals=[rival], after=after).confidence() == expected


def test_a_payload_that_wrong_inertias_explain_as_well_is_ambiguous_where_these_are_a_guess() -> None:
    imitated = replace(CARRIED, without=(1.0, 1.05, 1.0))
    assert imitated.confidence() == "ambiguous"
    assert replace(imitated, without=(1.0, 1.3, 1.0)).confidence() == "confident"


def test_of_an_identified_robot_a_payload_is_what_the_known_inertias_leave(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fitted ones take its place, and leave as little; the other coefficients are as they were fitted."""
    unfitted = SimpleNamespace(unseen=())
    monkeypatch.setattr(closing, "fit", lambda *_: unfitted)
    imitated = replace(CARRIED, without=(1.0, 1.0, 1.0), bare=(1.0, 1.0, 1.0), certainty=IDENTIFIED)
    evidence = imitated.evidence
    whole, search = evidence.analysis.whole, evidence.analysis.search
    search.prior.inertias = np.array([1.0])
    whole.point = SimpleNamespace(parameters=np.array([1.5, 0.7, 0.2]))  # a link, the payload, a coefficient
    whole.manifold = SimpleNamespace(inertial=slice(0, 2))
    whole.bodies, whole.terms = (), ()
    products = np.array([np.diag([0.5, 9.0, 0.0, 0.5]), np.diag([3.0, 9.0, 25.0, 0.0]), np.eye(4) / 2.04])
    search.design.gather = lambda *_: products
    np.testing.assert_allclose(evidence._squares_without, [1.0, 4.0, 1.0])
    assert evidence.share == 1.0
    assert evidence.confidence({"mass": Quantity(1.0, 0.01, "kg")}) == "confident"


@pytest.mark.parametrize(("loss", "expected"), [(15.0, "tentative"), (25.0, "confident")])
def test_it_matters_little(loss: float, expected: Confidence) -> None:
    assert replace(SURE, loss=loss).confidence() == expected


@pytest.mark.parametrize(
    ("loss", "after", "expected"),
    [
        (90.0, ELSEWHERE, "tentative"),
        (110.0, ELSEWHERE, "confident"),
        (190.0, OPEN, "tentative"),
        (210.0, OPEN, "confident"),
    ],
)
def test_beside_what_has_no_name_it_has_to_matter_more(
    loss: float, after: tuple[float, ...], expected: Confidence
) -> None:
    """And more still if what is left is where it acts."""
    assert replace(SURE, after=after, loss=loss).confidence() == expected


@pytest.mark.parametrize(("instead", "expected"), [(-3.0, "tentative"), (10.0, "tentative"), (14.0, "confident")])
def test_a_free_curve_that_fits_nearly_as_well_makes_it_unsure(instead: float, expected: Confidence) -> None:
    assert replace(SURE, instead=instead).confidence() == expected


GEAR, OTHER = named("joint_elasticity", 0), named("spring", 0)


@pytest.mark.parametrize(("loss", "expected"), [(200.0, "tentative"), (300.0, "confident")])
def test_a_small_name_beside_a_large_one_that_is_known_to_first_order_may_be_its_shadow(
    loss: float, expected: Confidence
) -> None:
    beside = replace(SURE, loss=loss, others=[GEAR], losses={GEAR: 1000.0})
    assert beside.confidence() == expected
    assert replace(beside, others=[OTHER], losses={OTHER: 1000.0}).confidence() == "confident"


def test_of_several_such_names_the_largest_counts_and_none_is_its_own_shadow() -> None:
    small = named("backlash", 0)
    beside = replace(SURE, loss=200.0, others=[GEAR, small], losses={GEAR: 1000.0, small: 300.0})
    assert beside.confidence() == "tentative"
    assert replace(SURE, name=named("joint_elasticity")).confidence() == "confident"


@pytest.mark.parametrize(("without", "expected"), [(1.08, "tentative"), (1.14, "confident")])
def test_a_name_whose_absence_no_channel_shows_is_unsure(without: float, expected: Confidence) -> None:
    """Squares 10 % larger are a remainder 5 % larger; one channel is enough."""
    assert replace(SURE, without=(1.0, without, 1.0), bare=(1.0, 1.14, 1.0)).confidence() == expected


def test_but_for_a_payload() -> None:
    """Inertias that were identified would take its place."""
    evidence = replace(CARRIED, without=(1.0, 1.08, 1.0)).evidence
    assert not evidence._is_small


@pytest.mark.parametrize(
    ("left", "expected"),
    [
        (curve(1), "tentative"),
        (curve(0), "confident"),
        (curve(0, JOINTS[1]), "tentative"),
        (curve(0, JOINTS[2]), "confident"),
    ],
    ids=["at its joint", "at another joint", "by its joint's motion", "by another joint's motion"],
)
def test_what_has_no_name_at_its_joint_makes_it_unsure(left: object, expected: Confidence) -> None:
    assert replace(SURE, others=[left], after=(1.3, 1.3, 1.3), unnamed=(1.0, 2.0, 1.0)).confidence() == expected


@pytest.mark.parametrize(("at_one", "at_all", "expected"), [(2.6, 4.2, "tentative"), (2.8, 4.4, "confident")])
def test_but_for_a_name_that_closes_eight_times_what_is_left(
    at_one: float, at_all: float, expected: Confidence
) -> None:
    """Of each channel ``1.3^2 - 1`` is left; without the name one of them has the square of what is given."""
    left = replace(SURE, others=[curve(1)], after=(1.3, 1.3, 1.3), unnamed=(1.0, at_one, 1.0))
    assert left.confidence() == expected
    everywhere = replace(TILT, others=[curve(1)], after=(1.3, 1.3, 1.3), unnamed=(1.3, at_all, 1.3))
    assert replace(everywhere, bare=(1.0, 12.0, 1.0)).confidence() == expected


def test_a_curve_that_unseen_data_leave_no_room_for_is_nothing_without_a_name() -> None:
    assert replace(SURE, others=[curve(1)], loss=25.0).confidence() == "confident"


@pytest.mark.parametrize(
    ("loss", "bare", "expected"),
    [(250.0, 4.0, "confident"), (250.0, 12.0, "tentative"), (250.0, 8.0, "confident"), (150.0, 4.0, "tentative")],
    ids=["large", "a quarter of the gap", "nearly half of it", "small"],
)
def test_a_name_of_the_whole_robot_is_blamed_for_what_is_left_anywhere(
    loss: float, bare: float, expected: Confidence
) -> None:
    everywhere = replace(TILT, after=ELSEWHERE, unnamed=(1.0, 4.0, 3.0), loss=loss)
    assert replace(everywhere, bare=(1.0, bare, 1.0)).confidence() == expected


def test_a_rival_or_curve_of_such_a_name_makes_it_matter_less() -> None:
    everywhere = replace(TILT, after=ELSEWHERE, unnamed=(1.0, 4.0, 3.0))
    assert replace(everywhere, instead=150.0).confidence() == "tentative"
    assert replace(everywhere, rivals=[Rival("payload", JOINTS[2], 150.0)]).confidence() == "tentative"


@pytest.mark.parametrize(
    ("bare", "loss", "expected"),
    [(61.0, 50.0, "confident"), (151.0, 50.0, "tentative"), (151.0, 90.0, "tentative"), (151.0, 120.0, "confident")],
    ids=["five percent", "two", "two, and matters a little", "two, but matters much"],
)
def test_a_small_share_of_the_gap_hides_behind_the_others(bare: float, loss: float, expected: Confidence) -> None:
    """It closes 3 of ``bare - 1``."""
    assert replace(SURE, bare=(1.0, bare, 1.0), loss=loss).confidence() == expected


def test_a_small_share_is_hidden_however_much_it_matters_if_much_is_left() -> None:
    """Of the second joint it closes 8, and ``1.5^2 - 1`` is a sixth of that; ``1.3^2 - 1`` a twelfth."""
    left = replace(SURE, after=(1.0, 1.5, 1.0), loss=1e4)
    assert replace(left, bare=(1.0, 151.0, 1.0)).confidence() == "tentative"
    assert replace(left, bare=(1.0, 61.0, 1.0)).confidence() == "confident"
    assert replace(left, bare=(1.0, 151.0, 1.0), after=(1.0, 1.3, 1.0)).confidence() == "confident"


@pytest.mark.parametrize(
    ("rival", "after", "expected"),
    [(50.0, ELSEWHERE, "tentative"), (70.0, ELSEWHERE, "confident"), (50.0, (1.0, 1.0, 1.0), "confident")],
)
def test_of_a_small_share_beside_what_has_no_name_rivals_are_far(
    rival: float, after: tuple[float, ...], expected: Confidence
) -> None:
    """Five times as far as of others, as its loss is."""
    small = replace(SURE, bare=(1.0, 151.0, 1.0), after=after)
    assert replace(small, rivals=[Rival("rotor_inertia", JOINTS[1], rival)]).confidence() == expected


@pytest.mark.parametrize(("curved", "expected"), [((1.0, 2.0, 1.0), "tentative"), ((1.0, 1.1, 1.0), "confident")])
def test_what_curves_say_on_unseen_data_too_is_no_doubt_of_a_name_beside_them(
    curved: tuple[float, ...], expected: Confidence
) -> None:
    """A name closes 5 of what is left, 3: it does not dominate, but beside a curve nothing is left. Its share is small
    beside what larger names close, or not."""
    beside = replace(SURE, others=[curve(1)], after=OPEN, with_curves=curved)
    assert beside.confidence() == expected
    assert replace(beside, bare=(1.0, 151.0, 1.0)).confidence() == expected
    assert replace(beside, bare=(1.0, 151.0, 1.0), instead=50.0).confidence() == "tentative"
    assert replace(beside, name=named("gravity_tilt", None), bare=(1.0, 12.0, 1.0)).confidence() == "tentative"


@pytest.mark.parametrize(
    ("after", "dry", "expected"),
    [
        ((1.0, 1.5, 1.0), True, "tentative"),
        ((1.0, 1.3, 1.0), True, "confident"),
        ((1.0, 1.3, 1.0), False, "tentative"),
    ],
)
def test_a_name_that_dominates_is_not_judged_beside_a_curve_by_which_its_size_varies(
    after: tuple[float, ...], dry: bool, expected: Confidence
) -> None:
    """Friction by position is Coulomb friction, and more: beside it nothing is lost without that."""
    spanning = replace(curve(1), dry=dry)
    evidence = replace(COULOMB, others=[spanning], after=after).evidence
    beside = spanning in evidence.whole.chosen
    assert replace(evidence, loss=5.0 if beside else 1000.0).confidence(SIZE) == expected


@pytest.mark.parametrize("name", ["coulomb_friction", "spring"])
def test_of_other_names_than_dry_friction_no_curve_says_that_their_size_varies(name: str) -> None:
    evidence = replace(SURE, name=named(name)).evidence
    assert evidence.closing.dominates
    assert evidence.closing.is_varied_by(replace(curve(1), dry=True)) is (name == "coulomb_friction")


def test_a_name_that_closes_little_does_not_dominate_where_nothing_is_left() -> None:
    """Eight times the share of a channel that still counts as closed, ``1.15^2 - 1``, are 2.58."""
    assert not replace(SURE, unnamed=(1.0, 1.88, 1.0)).evidence.closing.dominates
    assert replace(SURE, unnamed=(1.0, 1.9, 1.0)).evidence.closing.dominates


@pytest.mark.parametrize(("instead", "expected"), [(-3.0, "tentative"), (3.0, "confident")])
def test_a_curve_that_contains_a_name_has_to_be_better(
    instead: float, expected: Confidence, monkeypatch: pytest.MonkeyPatch
) -> None:
    all_curves_contain(monkeypatch, True)
    left = replace(SURE, after=(1.0, 1.5, 1.0))
    assert replace(left, instead=instead).confidence() == expected


def test_the_share_is_of_what_the_inertias_leave_in_the_channels_that_it_reaches() -> None:
    assert replace(SURE, bare=(99.0, 7.0, 99.0)).evidence.share == pytest.approx(0.5)
    both = replace(SURE, reached=(0, 1), without=(3.0, 4.0, 1.0), bare=(6.0, 6.0, 9.0))
    assert both.evidence.share == pytest.approx((2.0 + 3.0) / (5.0 + 5.0))


def test_the_share_is_between_nothing_and_all() -> None:
    """Where inertias alone leave less than the other names do without this one, all of the gap is its own."""
    assert replace(SURE, bare=(1.0, 1.0, 1.0)).evidence.share == 1.0
    assert replace(SURE, without=(1.0, 0.5, 1.0)).evidence.share == 0.0
    assert replace(SURE, without=(1.0, 1.0, 1.0), bare=(1.0, 1.0, 1.0)).evidence.share == 0.0


@pytest.mark.parametrize(("std", "expected"), [(0.4, "tentative"), (0.3, "confident")])
def test_a_payload_has_to_weigh_something(std: float, expected: Confidence) -> None:
    """Three standard deviations."""
    assert CARRIED.confidence(1.0, std) == expected


@pytest.mark.parametrize(
    ("effect", "sizes", "expected"),
    [
        ("viscous_friction", [(1.0, 0.4)], "tentative"),
        ("viscous_friction", [(-1.0, 0.4)], "tentative"),
        ("viscous_friction", [(1.0, 0.3)], "confident"),
        ("spring", [(1.0, 0.4), (5.0, 0.1)], "confident"),
        ("effort_gain", [(1.3, 0.11)], "tentative"),
        ("effort_gain", [(1.3, 0.09)], "confident"),
    ],
)
def test_a_name_whose_size_may_be_that_of_no_effect_is_unsure(
    effect: str, sizes: list[tuple[float, float]], expected: Confidence
) -> None:
    """Three standard deviations; no gain is a gain of one."""
    parameters = {str(place): Quantity(*size, "") for place, size in enumerate(sizes)}
    found = replace(SURE, name=named(effect))
    assert found.evidence.confidence(parameters) == expected
    monitored = found.evidence
    monitored.analysis.search.prior.terms = found.name.terms
    assert monitored._may_be_nothing(parameters) is False  # that of the model has changed, to nothing maybe


@pytest.mark.parametrize(("std", "expected"), [(0.4, "tentative"), (0.3, "confident")])
def test_how_sharply_friction_sets_in_is_no_size_of_it(std: float, expected: Confidence) -> None:
    parameters = {"level": Quantity(1.0, std, "N m"), "smoothing": Quantity(0.08, 0.0, "rad/s")}
    assert replace(SURE, name=named("coulomb_friction")).evidence.confidence(parameters) == expected


@pytest.mark.parametrize(("std", "expected"), [(0.4, "tentative"), (0.3, "confident")])
@pytest.mark.parametrize("effect", ["stribeck_friction", "coupled_viscous_friction", "backlash"])
def test_what_a_name_has_beside_its_size_makes_it_no_surer(effect: str, std: float, expected: Confidence) -> None:
    """A ratio, a speed, a drag."""
    name = next(c for c in CANDIDATES if c.name == effect)
    sizes = sum(part.count for part in name.effect.parts)
    parameters = {
        form.name: Quantity(1.0, std if place < sizes else 0.0, "") for place, form in enumerate(name.effect.parameters)
    }
    assert replace(SURE, name=name).evidence._may_be_nothing(parameters) is (expected == "tentative")


SPRING, STRIBECK = named("spring"), named("stribeck_friction")


@pytest.mark.parametrize(
    ("judged", "expected"),
    [
        (replace(SURE, outdoing={SPRING: (1.0, 1.01, 1.0)}), "confident"),
        (replace(SURE, outdoing={SPRING: (1.0, 0.99, 1.0)}), "tentative"),
        (replace(SURE, outdoing={SPRING: (1.0, 0.99, 1.0)}, outdoing_loss=202.0), "tentative"),
        (replace(SURE, outdoing={SPRING: (1.0, 0.99, 1.0)}, outdoing_loss=214.0), "confident"),
        (replace(SURE, outdoing={SPRING: (1.0, 1.0, 1.0)}, outdoing_loss=11.0), "tentative"),
        (replace(SURE, outdoing={SPRING: (1.0, 1.0, 1.0)}, outdoing_loss=13.0), "confident"),
        (replace(SURE, outdoing={SPRING: (0.5, 1.01, 0.5)}), "confident"),
        (replace(COULOMB, outdoing={STRIBECK: (1.0, 0.9, 1.0)}), "confident"),
        (replace(CARRIED, outdoing={SPRING: (0.9, 0.9, 0.9)}), "confident"),
    ],
)
def test_a_name_is_unsure_in_whose_place_another_is_about_as_likely_by_all_data(
    judged: Judged, expected: Confidence
) -> None:
    """Of 10,000 unseen instants a hundredth less that is left is worth a score of 201."""
    assert judged.confidence() == expected


def test_a_payload_of_unknown_mass_is_unsure() -> None:
    assert CARRIED.confidence(np.nan, 0.1) == "tentative"


@pytest.mark.parametrize(("unnamed", "expected"), [(2.4, "tentative"), (2.8, "confident")])
def test_where_something_is_left_a_sure_name_closes_half_of_the_gap_of_unseen_data(
    unnamed: float, expected: Confidence
) -> None:
    """Of 2.4^2 - 1 it closes 2.4^2 - 2^2, which is less than half; of 2.8^2 - 1 more."""
    left = replace(SURE, after=OPEN, unnamed=(1.0, unnamed, 1.0))
    assert left.confidence() == expected


def test_only_the_channels_that_it_reaches_judge_it_and_nan_says_nothing() -> None:
    left = replace(SURE, after=OPEN, unnamed=(9.0, 2.4, 9.0))
    assert left.confidence() == "tentative"
    assert replace(left, reached=(0, 1)).confidence() == "confident"
    assert replace(left, reached=(0, 1), after=(np.nan, 2.0, 1.0)).confidence() == "tentative"


def test_where_something_is_left_a_sure_name_generalises(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(confidence, "generalises", lambda *_: False)
    assert LEFT.confidence() == "tentative"
    assert SURE.confidence() == "confident"


def test_a_name_that_unseen_data_do_not_judge_is_not_sure_by_leaving_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(confidence, "generalises", lambda *_: False)
    unjudged = replace(SURE, counts=(1e4, 0.0, 1e4), after=(1.0, np.nan, 1.0))
    assert unjudged.confidence() == "tentative"
    assert replace(unjudged, reached=(0, 1)).confidence() == "confident"


@pytest.mark.parametrize(
    ("after", "counts", "expected"),
    [
        (1.1, 1e6, False),
        (1.2, 1e6, True),
        (1.6, 8.0, False),
        (1.8, 8.0, True),
        (np.nan, 0.0, False),
        (0.0, 1e6, False),
    ],
)
def test_a_channel_is_open_that_is_above_the_floor_by_more_than_few_instants_explain(
    after: float, counts: float, expected: bool
) -> None:
    """By 15 %, and by two standard deviations of a standard deviation: 2 / sqrt(2 n)."""
    judged = replace(SURE, after=(after, 1.0, 1.0), counts=(counts, 1e6, 1e6))
    assert confidence.is_open(judged.unseen).tolist() == [expected, False, False]
    doubled = replace(judged, after=2.0 * np.array(judged.after), expected=(2.0, 2.0, 2.0))
    assert confidence.is_open(doubled.unseen).tolist() == [expected, False, False]


def test_a_curve_is_open_where_unseen_data_leave_any_room() -> None:
    some, none = curve(0), curve(1)
    judged = replace(SURE, others=[some, none], after=(1.05, 1.0, 1.0))
    assert confidence.open_curves(judged.analysis, judged.unseen) == [some]


@pytest.mark.parametrize(
    ("judged", "expected"),
    [
        (SURE, "named"),
        (replace(SURE, after=OPEN), "incomplete"),
        (replace(SURE, others=[curve(0)], after=(1.1, 1.0, 1.0)), "unexplained"),
        (replace(SURE, others=[curve(0)], after=(1.0, 1.0, 1.3)), "incomplete"),
    ],
)
def test_the_verdict(judged: Judged, expected: str) -> None:
    assert verdict.verdict(judged.analysis, judged.unseen) == expected


@pytest.mark.parametrize(("change", "expected"), [(0.29, "tentative"), (0.31, "confident"), (-0.31, "confident")])
def test_what_the_model_has_has_changed_by_more_than_it_was_unsure(change: float, expected: Confidence) -> None:
    """It was 0.5 with a standard deviation of 0.1."""
    analysis = SURE.analysis
    (term,) = SURE.name.terms
    analysis.search.prior.terms, analysis.search.prior.values = (term,), np.array([0.5])
    analysis.search.prior.spreads = np.array([0.1])
    analysis.names.value = lambda _: 0.5 + change
    evidence = replace(SURE.evidence, analysis=analysis)
    assert evidence.confidence({}) == expected


@pytest.mark.parametrize(("gain", "expected"), [(0.5, "tentative"), (1.0, "confident"), (0.8, "confident")])
def test_an_offset_behind_a_new_gain_is_as_it_was(gain: float, expected: Confidence) -> None:
    """It was 1.0 of the measured effort: 2.0 of one that is divided by a gain of a half."""
    offset = replace(SURE, name=named("effort_offset"))
    analysis, found = offset.analysis, named("effort_gain")
    (term,) = offset.name.terms
    analysis.search.prior.terms, analysis.search.prior.values = (term,), np.array([1.0])
    analysis.search.prior.spreads = np.array([0.02])
    analysis.names.chosen = [found]
    analysis.names.value = lambda of: 2.0 if of is term else gain - 1.0
    assert replace(offset.evidence, analysis=analysis).confidence({}) == expected


def test_a_name_that_shares_a_part_with_what_the_model_has_is_new() -> None:
    """A spring beside an offset that is as it was."""
    spring = replace(SURE, name=named("spring"))
    analysis = spring.analysis
    _, offset = spring.name.terms
    analysis.search.prior.terms, analysis.search.prior.values = (offset,), np.array([0.5])
    analysis.search.prior.spreads = np.array([0.1])
    analysis.names.value = lambda _: 0.5
    assert replace(spring.evidence, analysis=analysis).confidence(SIZE) == "confident"


@pytest.mark.parametrize(
    ("judged", "expected"),
    [
        (SURE, 0.0),
        (LEFT, 0.5 * np.sqrt((1.15**2 - 1.0) / 8.0)),
        (replace(SURE, after=OPEN), 0.5 * np.sqrt(3.0 / 5.0)),
        (replace(SURE, after=(2.0, 2.0, 1.0), unnamed=(2.0, 3.0, 1.0), reached=(0, 1)), 0.5 * np.sqrt(6.0 / 5.0)),
        (replace(LEFT, unnamed=(1.0, 1.01, 2.0)), 1.0),
        (replace(LEFT, unnamed=(1.0, 0.9, 2.0)), 1.0),
    ],
    ids=[
        "nothing left",
        "left elsewhere",
        "left here",
        "left at two joints",
        "hardly anything closed",
        "worse with it",
    ],
)
def test_half_of_what_is_left_may_lie_along_a_name(judged: Judged, expected: float) -> None:
    """Of what it closes; where it acts nothing is taken to be left only if all of the robot is explained."""
    assert judged.evidence.closing.doubt == pytest.approx(expected)
