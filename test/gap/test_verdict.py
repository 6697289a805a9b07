"""Findings, rivals, what is left without a name, and the words for it."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geomid_ros.gap.candidates import AnyCandidate, Candidate
from geomid_ros.gap.judgement import verdict
from geomid_ros.gap.judgement.confidence import moves_one_way
from geomid_ros.gap.judgement.locate import located, share, strongest
from geomid_ros.gap.judgement.naming import link_name, sentence, settled_by
from geomid_ros.gap.result import Located, Unexplained
from geomid_ros.gap.search.score_test import Trial
from geomid_ros.model.effects import EFFECTS, Quantity
from geomid_ros.model.effects.stribeck_friction import SPEEDS
from geomid_ros.model.moving import SIGN

from .judged import CANDIDATES, JOINTS, MODEL, PAYLOAD, Fit, Judged, curve, named

COULOMB, SPRING = named("coulomb_friction"), named("spring")
STRIBECK = sorted(
    (c for c in CANDIDATES if c.name == "stribeck_friction" and c.joint == 1),
    key=lambda candidate: candidate.effect.scanned,
)


def analysis_with(judged: Judged, **own: Any) -> Any:
    """An analysis whose search can do more."""
    analysis = judged.analysis
    vars(analysis.search).update(own)
    return analysis


def moving(forward: float) -> Any:
    """One whose second joint moves forward at this share of the instants that are used, and back at all others."""
    count = 1000
    signs, valid = np.ones((2 * count, 3)), np.ones((2 * count, 3), dtype=bool)
    signs[round(forward * count) :, 1] = -1.0
    valid[count:, 1] = False
    samples = SimpleNamespace(column=lambda column: signs if column is SIGN else None)
    return SimpleNamespace(records=SimpleNamespace(samples=samples), valid=valid)


@pytest.mark.parametrize(
    ("forward", "expected"), [(0.02, True), (0.08, False), (0.5, False), (0.92, False), (0.98, True), (1.0, True)]
)
def test_a_joint_that_hardly_ever_moves_to_the_other_side_moves_one_way(forward: float, expected: bool) -> None:
    assert moves_one_way(SimpleNamespace(problem=moving(forward)), 1) == expected  # type: ignore[arg-type]
    assert moves_one_way(SimpleNamespace(problem=moving(forward)), 0)  # type: ignore[arg-type]


def rivals(
    name: Candidate, others: dict[AnyCandidate, float], forward: float = 0.5, both: float = 0.0, possible: bool = True
) -> list[tuple[str, str, float]]:
    """Of a name beside another one, with the scores of others in its place, and that with ``both``."""
    beside = named("viscous_friction", 0)
    judged = Judged(name=name, others=[beside])
    fits = [Fit(score, np.ones(3), (beside, other)) for other, score in others.items()]
    more = {"fit": lambda chosen, _: Fit(both, np.ones(3), tuple(chosen)), "possible": lambda _: possible}
    analysis = analysis_with(judged, rivals=lambda _, __: fits, **more)
    analysis.problem = moving(forward)
    return [(r.effect, r.joint, r.loss) for r in verdict._rivals(MODEL, analysis, name, analysis.whole)]


def test_rivals_are_listed_by_how_much_worse_they_are() -> None:
    assert rivals(COULOMB, {named("spring", 2): 9.0, named("effort_gain", 0): 4.0}) == [
        ("effort_gain", JOINTS[0], 4.0),
        ("spring", JOINTS[2], 9.0),
    ]


@pytest.mark.parametrize(
    ("other", "both", "possible", "loss"),
    [
        ("effort_gain", -150.0, True, 50.0),
        ("effort_gain", -11.0, True, -100.0),
        ("effort_gain", -150.0, False, -100.0),
        ("stribeck_friction", -150.0, True, -100.0),
    ],
)
def test_what_a_rival_explains_beside_a_name_is_no_doubt_of_it(
    other: str, both: float, possible: bool, loss: float
) -> None:
    """Unless it would not be taken beside it, cannot be, or makes no sense there."""
    where = 1 if other == "stribeck_friction" else 0
    ((_, _, found),) = rivals(COULOMB, {named(other, where): -100.0}, both=both, possible=possible)
    assert found == loss


def test_friction_at_a_joint_that_moves_one_way_is_an_offset_as_well() -> None:
    """Once, however the score has it."""
    offset, elsewhere = named("effort_offset"), named("effort_offset", 0)
    assert rivals(COULOMB, {offset: 30.0, elsewhere: 40.0}, forward=1.0) == [
        ("effort_offset", JOINTS[1], 0.0),
        ("effort_offset", JOINTS[0], 40.0),
    ]
    assert rivals(COULOMB, {offset: 30.0}) == [("effort_offset", JOINTS[1], 30.0)]
    assert rivals(SPRING, {}, forward=1.0) == []


@pytest.mark.parametrize("std", [0.03, 0.3, 0.6])
def test_a_scanned_constant_is_as_sure_as_the_curvature_of_the_score_says(std: float) -> None:
    """The score is minus twice a log likelihood; between two neighbours nothing is told apart."""
    middle = STRIBECK[10]
    judged = Judged(name=middle)

    def fit(chosen: Sequence[Candidate], _: Fit) -> Fit:
        (candidate,) = chosen
        return Fit(5.0 + float(np.log(candidate.effect.scanned / middle.effect.scanned) / std) ** 2, np.ones(3))

    analysis = analysis_with(judged, fit=fit, neighbours=lambda _: [STRIBECK[9], STRIBECK[11]])
    step = np.log(SPEEDS[1] / SPEEDS[0])
    found = verdict._scanned_std(analysis, middle)
    assert found == pytest.approx(np.sqrt(std**2 + step**2 / 12.0), rel=1e-2)


def test_a_scanned_constant_is_unsure_by_itself_where_the_score_says_nothing() -> None:
    middle = STRIBECK[10]
    both = [STRIBECK[9], STRIBECK[11]]
    for around, slope in ((both[:1], 1.0), (both, 0.0), (both, -3.0)):

        def fit(chosen: Sequence[Candidate], _: Fit, slope: float = slope) -> Fit:
            return Fit(slope * float(np.log(chosen[0].effect.scanned / middle.effect.scanned)) ** 2, np.ones(3))

        own = {"fit": fit, "neighbours": lambda _, around=around: around}
        assert verdict._scanned_std(analysis_with(Judged(name=middle), **own), middle) == 1.0


def test_a_name_without_a_scanned_constant_is_sure_of_it() -> None:
    assert verdict._scanned_std(Judged().analysis, named("viscous_friction")) == 0.0


def unexplained(judged: Judged, *depends_on: str) -> dict[str, tuple[str, float]]:
    """What is left, by joint, where the remainders depend on these."""
    unseen = judged.unseen
    unseen.located = [
        replace(Located("", 0.0, 0.0, 0.0, 0.0, 0.0), **({name: 0.5} if name else {})) for name in depends_on
    ]
    left = verdict.unexplained(MODEL, judged.analysis, unseen)
    assert all(isinstance(entry, Unexplained) for entry in left)
    return {entry.joint: (entry.depends_on, entry.gap) for entry in left}


def test_what_is_left_is_said_with_what_it_depends_on() -> None:
    judged = Judged(after=(1.0, 2.0, 3.0))
    assert unexplained(judged, "time", "load", "") == {JOINTS[1]: ("load", 2.0), JOINTS[2]: ("unknown", 3.0)}
    assert unexplained(Judged(), "time", "load", "") == {}


def test_what_a_curve_says_is_said_once() -> None:
    judged = Judged(others=[curve(1, "position")], after=(1.0, 2.0, 3.0))
    assert unexplained(judged, "time", "time", "time") == {JOINTS[1]: ("position", 2.0), JOINTS[2]: ("time", 3.0)}
    closed = Judged(others=[curve(1, "position")])
    assert unexplained(closed, "time", "time", "time") == {}


def test_findings_come_with_the_one_that_matters_most_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verdict, "score_test", lambda *asked: Trial(asked[-1], 0.0, 1.7))
    monkeypatch.setattr(verdict.naming, "parameters", lambda *_: {"coefficient": Quantity(0.5, 0.01, "N m s/rad")})
    monkeypatch.setattr(verdict, "scattered", lambda _, found: found)
    monkeypatch.setattr(verdict, "as_unsure", lambda *asked: asked[3])
    seen = []
    judge = verdict.Evidence.confidence
    monkeypatch.setattr(verdict.Evidence, "confidence", lambda own, sizes: (seen.append(sizes), judge(own, sizes))[1])
    wide = {"coefficient": Quantity(0.5, 9.0, "N m s/rad")}
    monkeypatch.setattr(verdict, "as_unsure_beside_others", lambda *_: wide)
    beside = named("viscous_friction", 0)
    judged = Judged(others=[beside, curve(2)], losses={beside: 2000.0})
    rivals = {named("spring", 2): 500.0, named("spring", 0): 1500.0, named("effort_gain", 0): 8.0}
    fits = [Fit(score, np.ones(3), (beside, other)) for other, score in rivals.items()]
    of_beside = [Fit(9e3, np.ones(3), (judged.name, named("spring", 0)))]
    alone = {"fit": lambda *_: judged.analysis.whole, "possible": lambda _: True}
    analysis = analysis_with(judged, rivals=lambda _, c: fits if c is judged.name else of_beside, **alone)
    (_, first), (candidate, second) = verdict.findings(MODEL, analysis, judged.unseen)
    assert candidate is judged.name
    assert (first.joint, first.loss, first.rivals, first.settled_by) == (JOINTS[0], 2000.0, (), first.settled_by)
    assert (second.effect, second.joint, second.link, second.loss) == ("viscous_friction", JOINTS[1], "", 1000.0)
    assert [rival.loss for rival in second.rivals] == [8.0, 500.0], "one that is worse than nothing is no rival"
    assert (second.confidence, second.separability, second.share) == ("ambiguous", 1.0, 1.0)
    assert second.parameters == wide
    assert [sizes["coefficient"].std for sizes in seen] == [0.01, 0.01], "another size is no doubt that it is there"
    assert second.settled_by == judged.name.effect.settled_by
    assert second.sentence.startswith("One of several explanations: ")


def test_the_ranking_has_the_chosen_names_by_their_worth_and_then_the_best_of_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(verdict, "score_test", lambda *asked: Trial(asked[-1], 3.0, 0.9))
    beside = named("spring", 0)
    judged = Judged(others=[beside, curve(2)], losses={beside: 2000.0})
    trials = [Trial(c, 50.0 - place, 0.5) for place, c in enumerate([*CANDIDATES[:25], curve(1)])]
    trials.append(Trial(CANDIDATES[25], -np.inf, 0.0))
    found = verdict.ranking(MODEL, analysis_with(judged, ranked=lambda _: trials))
    chosen = [(entry.effect, entry.joint, entry.gain, entry.separability) for entry in found if entry.chosen]
    assert chosen == [("spring", JOINTS[0], 2000.0, 0.9), ("viscous_friction", JOINTS[1], 1000.0, 0.9)]
    assert [entry.gain for entry in found[2:]] == [50.0 - place for place in range(20)]
    assert not any(entry.chosen for entry in found[2:])
    few = [Trial(curve(1), 9.0, 1.0), Trial(CANDIDATES[0], -np.inf, 0.0), Trial(CANDIDATES[1], -2.0, 0.3)]
    assert [entry.gain for entry in verdict.ranking(MODEL, analysis_with(judged, ranked=lambda _: few))[2:]] == [-2.0]


class TestShare:
    """Of a mean square that a curve of one variable explains."""

    RNG = np.random.default_rng(3)
    VARIABLE = RNG.uniform(-1.0, 1.0, 4000)
    NOISE = RNG.standard_normal(4000)

    def test_a_smooth_curve_is_explained_and_noise_is_not(self) -> None:
        assert share(np.sin(2.0 * self.VARIABLE), self.VARIABLE) > 0.99
        assert share(self.NOISE, self.VARIABLE) < 0.01

    def test_a_sum_of_both_is_explained_in_part(self) -> None:
        both = 2.0 * self.VARIABLE + self.NOISE
        assert share(both, self.VARIABLE) == pytest.approx((4.0 / 3.0) / (4.0 / 3.0 + 1.0), abs=0.03)

    def test_what_curves_explain_of_noise_does_not_count(self) -> None:
        shares = [share(np.random.default_rng(k).standard_normal(60), self.VARIABLE[:60]) for k in range(200)]
        assert 0.0 <= min(shares) < 0.01
        assert np.mean(shares) < 0.1

    def test_nothing_is_said_of_too_few_or_of_one_place(self) -> None:
        assert share(np.arange(12.0), np.arange(12.0)) == 0.0
        assert share(np.arange(14.0), np.arange(14.0)) > 0.9
        assert share(self.VARIABLE, np.ones(4000)) == 0.0

    def test_what_is_not_measured_does_not_matter(self) -> None:
        values = np.sin(2.0 * self.VARIABLE) + self.NOISE
        holes = np.where(np.arange(4000) % 3 == 0, np.nan, values)
        kept = np.isfinite(holes)
        assert share(holes, self.VARIABLE) == share(values[kept], self.VARIABLE[kept])

    def test_a_wild_value_of_the_variable_does_not_spoil_its_curve(self) -> None:
        wild = self.VARIABLE.copy()
        wild[:10] *= 1e6
        assert share(np.sin(6.0 * self.VARIABLE), wild) > 0.9


def test_a_remainder_is_located_by_what_it_depends_on() -> None:
    """At three joints: on the second one's position, and on the direction of the third; the first shows its load."""
    rng = np.random.default_rng(8)
    position, velocity = rng.uniform(-1.0, 1.0, (2, 3000, 3))
    load = rng.uniform(0.0, 5.0, (3000, 3))
    samples = SimpleNamespace(seconds=np.arange(3000) * 0.01, position=position, velocity=velocity)
    residual = np.column_stack([(load[:, 0] - 2.5) ** 2 - 2.0, np.sin(3.0 * position[:, 1]), np.sign(velocity[:, 2])])
    found = located(MODEL, SimpleNamespace(samples=samples), residual, load)  # type: ignore[arg-type]
    assert [entry.channel for entry in found] == list(JOINTS)
    assert [strongest(entry) for entry in found] == ["load", "position", "reversals"]
    drifting = np.column_stack([np.linspace(-1.0, 1.0, 3000)] * 3)
    in_time = located(MODEL, SimpleNamespace(samples=samples), drifting, load)  # type: ignore[arg-type]
    assert [strongest(entry) for entry in in_time] == ["time"] * 3
    with_speed = located(MODEL, SimpleNamespace(samples=samples), velocity**3, load)  # type: ignore[arg-type]
    assert [strongest(entry) for entry in with_speed] == ["velocity"] * 3


def test_a_wrench_depends_on_load_and_time_alone() -> None:
    channels = (SimpleNamespace(name="wrench/fx", joint=None),)
    samples = SimpleNamespace(seconds=np.arange(500) * 0.01, position=np.zeros((500, 0)), velocity=np.zeros((500, 0)))
    load = np.random.default_rng(1).uniform(size=(500, 1))
    model, records = SimpleNamespace(channels=channels), SimpleNamespace(samples=samples)
    (found,) = located(model, records, load - 0.5, load)  # type: ignore[arg-type]
    assert (found.channel, strongest(found)) == ("wrench/fx", "load")
    assert (found.velocity, found.position, found.reversals) == (0.0, 0.0, 0.0)


FOUND = {"level": Quantity(0.5, 0.01, "N m"), "gain": Quantity(1.25, 0.1, "-")}


@pytest.mark.parametrize(
    ("joint", "link", "where"),
    [("elbow", "", " at 'elbow'"), ("elbow", "forearm", " at link 'forearm'"), ("", "", "")],
)
def test_a_sentence_says_what_where_and_how_much(joint: str, link: str, where: str) -> None:
    effect = EFFECTS["stribeck_friction"]()
    values = "level 0.5 ± 0.02 N m, gain 1.25 ± 0.2 (95 % interval)."
    assert sentence(effect, joint, link, FOUND, {}, "confident") == f"Stribeck friction{where}: {values}"
    assert sentence(effect, joint, link, FOUND, {}, "tentative") == f"Perhaps Stribeck friction{where}: {values}"


def test_a_sentence_does_not_say_how_sharply_friction_sets_in() -> None:
    found = {"level": Quantity(0.5, 0.01, "N m"), "smoothing": Quantity(0.08, 0.0, "rad/s")}
    assert "smoothing" not in sentence(COULOMB.effect, "elbow", "", found, {}, "confident")


def test_a_sentence_begins_with_a_capital_and_says_the_first_parameters() -> None:
    found = {name: Quantity(1.0, 0.1, "m") for name in ("mass", "com_x", "com_y", "com_z", "ixx")}
    text = sentence(PAYLOAD.effect, "wrist", "hand", found, {}, "confident")
    assert text.startswith("A payload at link 'hand': mass 1 ± 0.2 m,")
    assert "com_z" in text
    assert "ixx" not in text


def test_what_settles_payloads_at_two_links_is_a_motion_that_turns_both() -> None:
    payload, spring = EFFECTS["payload"](), EFFECTS["spring"]()
    both = settled_by(payload, "wrist", [(payload, "elbow"), (spring, "base")])
    assert both == "a motion that turns 'wrist', 'elbow' through their ranges"
    assert settled_by(payload, "wrist", [(spring, "base")]) == payload.settled_by
    assert settled_by(spring, "wrist", [(spring, "elbow")]) == spring.settled_by
    assert settled_by(payload, "wrist", []) == payload.settled_by


def test_only_a_payload_has_a_link() -> None:
    assert link_name(MODEL, PAYLOAD) == MODEL.body_names[-1]
    assert link_name(MODEL, COULOMB) == ""
