"""Rounds of search and linearisation: when they end, and what is noise in them."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from geomid_ros.gap import analysis
from geomid_ros.gap import candidates as library
from geomid_ros.gap.analysis import _ends, _identifiable
from geomid_ros.gap.candidates import Candidate, EffectsPrior
from geomid_ros.inference.fit import fit
from geomid_ros.inference.prior import OtherRecordings
from geomid_ros.inference.selection import Selection
from geomid_ros.model.effects import AtJoint, AtJoints, OnLink, OnRobot, Place
from geomid_ros.types import BoolArray

from . import planted
from .small import LINK, PAYLOAD, PRIOR, ROWS, Recording, at

VISCOUS, OFFSET = at("viscous_friction", 0), at("effort_offset", 0)
OTHER = at("viscous_friction", 1)


TERM, OWN = VISCOUS.terms[0], OFFSET.terms[0]


def test_the_size_of_a_remainder_is_that_of_what_is_used() -> None:
    rng = np.random.default_rng(2)
    residual = np.column_stack([0.3 * rng.standard_normal(20_000), rng.standard_normal(20_000), np.zeros(20_000)])
    valid = rng.uniform(size=residual.shape) > 0.5
    valid[:, 2] = False
    wild = np.where(valid, residual, 1e6)
    np.testing.assert_allclose(analysis._typical_size(wild, valid), [0.3, 1.0, np.nan], rtol=0.02)


class TestFirstNoise:
    """Before anything is named: what the motion of the channel's own joint does not explain."""

    RNG = np.random.default_rng(7)
    COUNT = 3000

    def noise(self, memory: float, own: float, others: float, free: float = 0.0) -> Any:
        """Of noise with a memory, under an effect at its joint and what another joint and a curve do."""
        mine, alien, smooth = self.RNG.standard_normal((3, self.COUNT))
        alien, smooth = (np.convolve(column, np.ones(20), mode="same") for column in (alien, smooth))
        noise = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], self.RNG.standard_normal(self.COUNT))
        own_column = np.convolve(mine, np.ones(20), mode="same")
        left = noise + own * own_column + others * alien + free * smooth
        columns = {
            TERM: {0: own_column},
            OTHER.terms[0]: {0: alien, 1: alien},
        }
        residual = np.column_stack([left, np.zeros(self.COUNT)])
        problem: Any = SimpleNamespace(
            residual=lambda *_: residual,
            records=SimpleNamespace(segment=np.zeros(self.COUNT, dtype=int)),
            model=SimpleNamespace(channels=[SimpleNamespace(joint=TERM.joints[0]), SimpleNamespace(joint=1)]),
        )
        valid = np.ones((self.COUNT, 2), dtype=bool)
        valid[self.COUNT // 2] = False
        return analysis._flexible_noise(problem, columns, None, valid)[0]  # type: ignore[arg-type]

    @pytest.mark.parametrize("memory", [0.0, 0.7])
    def test_an_effect_at_its_joint_is_no_noise(self, memory: float) -> None:
        noise = self.noise(memory, own=3.0, others=0.0)
        predictor = np.append(noise.predictors[noise.order], [0.0])
        assert predictor[0] == pytest.approx(memory, abs=0.06)
        assert noise.variances[-1] == pytest.approx(1.0 - memory**2, rel=0.1)

    def test_what_other_joints_and_curves_explain_is(self) -> None:
        assert self.noise(0.0, own=0.0, others=0.5).variances[0] > 2.0
        assert self.noise(0.0, own=0.0, others=0.0, free=0.5).variances[0] > 2.0


def test_the_first_noise_is_that_of_what_was_measured_however_many_columns_there_are() -> None:
    """Columns of as many directions as there are rows leave nothing, and what rounding says of the noise."""
    rng, rows, channels = np.random.default_rng(8), 80, 30
    shocks = rng.standard_normal((rows, channels))
    noise = np.zeros((rows, channels))
    for row in range(rows):
        noise[row] = 0.8 * noise[row - 1] + shocks[row]
    problem: Any = SimpleNamespace(
        residual=lambda *_: noise,
        records=SimpleNamespace(segment=np.zeros(rows, dtype=np.int64)),
        model=SimpleNamespace(channels=[SimpleNamespace(joint=channel) for channel in range(channels)]),
    )
    columns = rng.standard_normal((100, rows))
    everywhere: Any = {
        replace(TERM, place=OnRobot(), index=index): dict.fromkeys(range(channels), column)
        for index, column in enumerate(columns)
    }
    bare: Any = None
    found = analysis._flexible_noise(problem, everywhere, bare, np.ones(noise.shape, dtype=bool))
    assert 0.45 < np.mean([process.predictors[1][0] for process in found if process.order]) < 0.9
    assert 0.5 < np.mean([process.variances[-1] for process in found]) < 2.0


def test_a_rival_is_tried_with_a_remainder_of_its_own() -> None:
    """The one that was estimated beside the named effect explains what only this one leaves."""
    rotor, rng = at("rotor_inertia", 0), np.random.default_rng(1)
    recording = Recording(1, [VISCOUS, rotor])
    recording.features, recording.block = rng.normal(size=(ROWS, 12)), np.repeat([0, 1], [8, 4])
    alien, lacking = recording.features[:, :8] @ rng.normal(size=8), recording.features[:, 8:] @ np.full(4, 0.1)
    recording.columns[TERM] = recording.columns[rotor.terms[0]] + alien + lacking
    targets = recording.targets({rotor.terms[0]: 1.0})
    targets[:, 0] += lacking
    design = recording.design_of(targets)
    for _ in range(2):
        search = Selection(fit(design, PRIOR, [VISCOUS]).with_fitted_remainder(design), PRIOR, [VISCOUS, rotor])
        design = search.design
    found = search.optimise(search.fit([VISCOUS]))
    assert found.chosen == (VISCOUS,)
    assert analysis._exchanged(search, found)[1].chosen == (rotor,)


class Rounds:
    """Searches that do not settle: of each attempt what it was given, and the noise of what it left by channel, of
    which some are ``told``."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, told: Sequence[bool]) -> None:
        self.noises: list[Any] = []
        self.made = 0
        monkeypatch.setattr(analysis, "_beginning", lambda *_: (("first",) * len(told), None))
        monkeypatch.setattr(analysis, "_round", self.round)
        monkeypatch.setattr(analysis, "_same", lambda *_: False)
        monkeypatch.setattr(analysis, "_noise", self.noise)
        monkeypatch.setattr(analysis, "_typical_size", lambda *_: None)
        monkeypatch.setattr(analysis, "total_model", lambda *_: None)
        self.problem = SimpleNamespace(
            residual=lambda *_: 0.0,
            remainder=lambda *_: 0.0,
            valid=None,
            identifiable_floor=lambda _: (None, np.array(told)),
        )
        self.channels = len(told)

    def round(self, *given: Any, variances: object, attempt: int, settling: bool) -> Any:
        _, _, _, noise, before = given
        assert settling == (attempt > 4)
        assert variances == (attempt - 1 if attempt else ())
        assert attempt == len(self.noises)
        assert before is (attempt - 1 if attempt else None)
        self.noises.append(noise)
        return SimpleNamespace(
            columns=None, found=attempt, search=SimpleNamespace(design=SimpleNamespace(variances=attempt))
        )

    def noise(self, *_: Any) -> tuple[int, ...]:
        self.made += 1
        return (self.made,) * self.channels


def test_what_does_not_settle_is_fitted_in_the_noise_of_the_last_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a channel whose rows are too few to tell it in the one before."""
    rounds = Rounds(monkeypatch, told=(True, False))
    task: Any = SimpleNamespace(
        model=None, records=None, linearised=lambda *_: rounds.problem, progress=lambda *_: None
    )
    analysis._searched(task, None, "")  # type: ignore[arg-type]
    searches = ["first", 1, 2, 3, 4, 5]
    assert rounds.noises == [(noise, "first") for noise in (*searches, 5, 5, 5)]


def test_what_two_joints_share_is_looked_for_where_they_move_together() -> None:
    """And a payload at the first of links that move as one."""
    moving = np.zeros((200, 3), dtype=bool)
    moving[:100, 0] = moving[80:, 1] = True

    def looked_for(moving: BoolArray) -> set[tuple[str, Place]]:
        return {
            (c.name, c.place)
            for c in _identifiable(library.candidates(planted.model(), (), unknown_joints=True), moving)
        }

    found = looked_for(moving)
    assert ("viscous_friction", AtJoint(0)) in found
    assert ("gravity_tilt", OnRobot()) in found
    assert ("payload", OnLink(1, 1)) in found
    assert ("payload", OnLink(2, 2)) not in found, "the last joint never moves"
    pair = ("coupled_coulomb_friction", AtJoints(0, 1))
    assert pair not in found
    moving[50:, 1] = True
    assert pair in looked_for(moving)


@pytest.mark.parametrize(("links", "ends"), [([0, 1, 2], {2}), ([0, 1], {1}), ([], set())])
def test_the_end_of_a_limb_carries_no_other_link(links: list[int], ends: set[int]) -> None:
    assert _ends(planted.model(), links) == ends


def test_beside_a_drawing_alone_payloads_are_looked_for_at_all_links(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing else tells there what a link has gained."""
    monkeypatch.setattr(analysis, "_searched", lambda task, *_: task)
    monkeypatch.setattr(analysis, "_with_changed_link", lambda task, _: (task, 0.0))
    monkeypatch.setattr(analysis, "_judged", lambda task, *_: task)
    records: Any = SimpleNamespace(moving=np.ones((30, 3), dtype=bool))
    drawing = planted.prior()
    identified = replace(drawing, other_recordings=OtherRecordings(np.zeros((1, 30)), np.zeros(1)))
    for prior, links in ((drawing, [0, 1, 2]), (identified, [2])):
        task: Any = analysis.analyse(planted.model(), records, prior, lambda *_: None)
        assert [c.payload for c in task.tried if c.payload is not None] == links
        assert task.links == [0, 1, 2]


@pytest.mark.parametrize("names", [[PAYLOAD], [VISCOUS]])
def test_a_link_may_have_been_changed_beside_names_and_in_the_place_of_a_payload(
    monkeypatch: pytest.MonkeyPatch, names: list[Candidate]
) -> None:
    """What is lighter now carries nothing, whatever else makes a payload likely."""
    known = OtherRecordings(1e2 * np.eye(10), np.zeros(10))
    identified = replace(PRIOR, prior_std=0.05, certainty=100.0, identified=True, other_recordings=known)
    recording, size = Recording(7, [PAYLOAD, VISCOUS]), 0.5 if VISCOUS in names else 0.0
    design = recording.design({VISCOUS.terms[0]: size}, 0.7 * LINK)

    def searched(prior: EffectsPrior, *found: Candidate) -> analysis._Round:
        search = Selection(design, prior, [PAYLOAD, VISCOUS])
        unused: Any = None
        return analysis._Round(unused, unused, search, search.fit(found))

    beside = [c for c in names if c is not PAYLOAD]
    monkeypatch.setattr(analysis, "_searched", lambda _, prior, __: searched(prior, *beside))
    task: Any = SimpleNamespace(links=[0], tried=[PAYLOAD, VISCOUS])
    found, contested = analysis._with_changed_link(task, searched(identified, *names))
    assert found.search.prior.changed_link == 0
    assert contested == 0.0
