"""How often names are true that are stated with a probability, on designs of random columns."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geomid_ros.gap import analysis
from geomid_ros.gap.verdict import ranking
from geomid_ros.inference.probability import Support, Supports, relative_std_from_remainder, separability
from geomid_ros.inference.selection import Selection

from . import planted
from .small import LINK, PAYLOAD, PRIOR, ROWS, Recording, at

CANDIDATES = [
    at(name, joint)
    for joint in (0, 1)
    for name in ("viscous_friction", "effort_offset", "rotor_inertia", "load_friction")
]
VISCOUS, OFFSET, ROTOR = CANDIDATES[:3]


def supports(sizes: dict[object, float], seed: int, alike: object = None) -> dict[object, Support]:
    """Of what is found of a robot with these sizes of names; the rotor's column is nearly that of one ``alike``."""
    columns = {ROTOR.terms[0]: alike.terms[0]} if alike else None  # type: ignore[attr-defined]
    recording = Recording(seed, CANDIDATES, columns)
    design = recording.design({c.terms[0]: size for c, size in sizes.items()})  # type: ignore[attr-defined]
    selection = Selection(design, PRIOR, CANDIDATES)
    found = selection.optimise(selection.fit([]))
    each = Supports(selection, found)
    return {c: each.of(c) for c in found.chosen}


def test_of_names_that_are_stated_as_sure_hardly_any_is_wrong() -> None:
    """One in six names is there, of sizes about those that just show."""
    rng, stated = np.random.default_rng(1), []
    for seed in range(40):
        sizes = {c: float(rng.uniform(0.0, 0.06)) for c in CANDIDATES if rng.random() < 1.0 / 6.0}
        stated += [(support.probability, c in sizes) for c, support in supports(sizes, seed).items()]
    sure = [true for probability, true in stated if probability > 0.95]
    assert len(sure) > 15
    assert np.mean(sure) >= 0.97
    assert all(0.0 <= probability <= 1.0 for probability, _ in stated)


def test_a_large_name_is_sure_and_one_with_an_equal_rival_is_not() -> None:
    (alone,) = supports({VISCOUS: 0.3}, 2).values()
    assert alone.probability > 0.999
    for seed in range(4):
        contested = supports({VISCOUS: 0.03}, seed, alike=VISCOUS)
        for support in contested.values():
            assert support.probability < 0.95
            assert support.rivals[0][0] in (VISCOUS, ROTOR)


def test_what_every_joint_may_have_is_likely_from_three_standard_deviations_on_and_not_before() -> None:
    """Of a name that is as likely as not, a size is evidence or none, and its probability is not held back besides."""
    ordinary, beyond, within = at("effort_gain", 0, odds=1.0), [], []
    for seed in range(60):
        design = Recording(seed, [ordinary]).design({ordinary.terms[0]: 0.1}, noise=0.03 * np.sqrt(ROWS))
        selection = Selection(design, PRIOR, [ordinary])
        found = selection.fit([ordinary])
        each = Supports(selection, found)
        deviations = found.value(ordinary.terms[0]) / np.sqrt(each._sized.covariance_of(ordinary.terms)[0, 0])
        (beyond if deviations > 3.0 else within).append(each.of(ordinary).probability)
    assert min(len(beyond), len(within)) > 5
    assert min(beyond) > 0.7
    assert max(within) < 0.5 + 1e-9


def test_of_what_is_less_likely_than_nothing_nothing_is_said_and_the_others_are_judged_beside_it() -> None:
    """A second column explains nothing, or what else would be taken for a lack along the first one."""
    search = Selection(Recording(3, CANDIDATES).design({VISCOUS.terms[0]: 1.0}), PRIOR, CANDIDATES)
    found = search.fit([VISCOUS, OFFSET])
    (said,) = analysis._evidence(Supports(search, found), ()).items()
    assert said[0] is VISCOUS
    assert said[1].loss == pytest.approx(search.without(found, VISCOUS).score - found.score)
    unused: Any = None
    whole = analysis.Analysis(
        problem=unused, search=search, inertias_only=search.fit([]), effects=found, supports=dict([said]), floor=unused
    )
    assert whole.likely.chosen == (VISCOUS,)
    ranked = ranking(planted.model(), whole, (), ())
    assert (OFFSET.name, "joint1") in {(each.effect, each.joint) for each in ranked}


def test_a_change_that_is_likely_only_beside_one_less_likely_than_nothing_is_not_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The rotor's column is nearly that of the friction, of which the doubt is set: they show in their difference."""
    tried, adjusted_loss = [VISCOUS, ROTOR], Supports.adjusted_loss
    recording = Recording(1, tried, {ROTOR.terms[0]: VISCOUS.terms[0]})
    search = Selection(recording.design({VISCOUS.terms[0]: 0.5, ROTOR.terms[0]: -0.5}), PRIOR, tried)
    both = Supports(search, search.fit(tried))
    assert both.of(ROTOR).probability > 0.95
    assert analysis._likely(both) is both
    monkeypatch.setattr(Supports, "adjusted_loss", lambda s, c: -1.0 if c is VISCOUS else adjusted_loss(s, c))
    assert analysis._likely(both).found.chosen == ()


def test_names_are_as_common_as_the_others_were_found_to_be() -> None:
    """By Beta's distribution: with one found before, of a hundred, and with none or three of seven others here."""
    recording = Recording(4, CANDIDATES)
    selection = Selection(recording.design({c.terms[0]: 0.3 for c in CANDIDATES[:4]}), PRIOR, CANDIDATES)
    for chosen, others in ((CANDIDATES[:1], 0), (CANDIDATES[:4], 3)):
        odds = (1 + others) / (99 + 8 - others)  # of the next one of eight, beside 99 that had been without
        found = Supports(selection, selection.fit(chosen))._common(VISCOUS)
        assert found == pytest.approx(2.0 * np.log(odds / VISCOUS.odds))


def test_how_common_names_are_counts_beside_what_one_is_worth() -> None:
    """Of a small one without a rival to speak of, with none or two others."""
    tried = [VISCOUS, at("viscous_friction", 1), at("effort_offset", 1)]
    for count in (1, 3):
        sizes = {c.terms[0]: 0.3 if c is not tried[0] else 0.03 for c in tried[:count]}
        selection = Selection(Recording(4, tried).design(sizes), PRIOR, tried)
        each = Supports(selection, selection.fit(tried[:count]))
        support, worth, common = each.of(tried[0]), each.adjusted_loss(tried[0]), each._common(tried[0])
        assert 4.0 < worth < 30.0
        assert not [loss for _, loss in support.rivals if loss < worth + 20.0]
        assert -2.0 < common < 5.0
        odds = support.probability / (1.0 - support.probability)
        assert 2.0 * np.log(odds) == pytest.approx(worth + common, abs=0.1)


def test_a_drawing_s_inner_link_may_be_wrong_as_well_as_loaded() -> None:
    load = np.array([1.0, 0.3, 0.0, 0.2, 0.4, 0.0, 0.4, 0.0, 0.0, 0.4])
    design = Recording(3, [PAYLOAD]).design({}, LINK + load)
    search = Selection(design, replace(PRIOR, prior_std=0.05, certainty=100.0), [PAYLOAD])
    found = Supports(search, search.fit([PAYLOAD]))
    for inner, least, most in (((), 0.99, 1.0), ((0,), 0.49, 0.5)):
        assert least < analysis._evidence(found, inner)[PAYLOAD].probability <= most


def test_each_channel_s_lack_counts_by_the_weight_that_least_squares_give_what_it_says() -> None:
    """One coefficient at three channels: lack where little is told is little doubt."""
    rng = np.random.default_rng(5)
    for _ in range(5):
        powers, squares, lacks = rng.uniform(0.1, 10.0, (3, 3))
        channels = [SimpleNamespace(before=None)] * 3
        design: Any = SimpleNamespace(channels=channels, powers=lambda *_, own=powers: own)
        lacking = [SimpleNamespace(power=power, freedom=16.0) for power in lacks]
        found: Any = SimpleNamespace(squares=squares, remainders=lambda _, own=lacking: own)
        weights = powers / squares / np.sum(powers / squares)
        of_each = 0.25 * lacks / powers  # relative variance of the size as one channel alone says it
        expected = np.sum(weights * np.sqrt(of_each))  # the errors may have one cause
        assert relative_std_from_remainder(design, found, 0, np.ones(1)) == pytest.approx(expected)


def test_separability_is_what_the_others_leave_of_a_column_and_a_known_parameter_imitates_nothing() -> None:
    design = Recording(3, [VISCOUS, ROTOR], {ROTOR.terms[0]: VISCOUS.terms[0]}).design({VISCOUS.terms[0]: 0.5})
    selection = Selection(design, PRIOR, [VISCOUS, ROTOR])
    assert separability(design, selection.fit([VISCOUS]), VISCOUS) > 0.9
    assert separability(design, selection.fit([VISCOUS, ROTOR]), VISCOUS) == pytest.approx(0.01, rel=0.3)
    known = replace(PRIOR, terms=ROTOR.terms, values=np.zeros(1), prior_stds=np.full(1, 1e-6))
    assert separability(design, Selection(design, known, [VISCOUS]).fit([VISCOUS]), VISCOUS) > 0.9
