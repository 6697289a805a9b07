"""Rounds of search and linearisation: when they end, and what is noise in them."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from geomid_ros.gap import analysis
from geomid_ros.gap import candidates as library
from geomid_ros.gap.analysis import _ends, _identifiable
from geomid_ros.gap.noise import Autoregression
from geomid_ros.inference.candidates import Candidate, EffectTerm
from geomid_ros.inference.fit import fit
from geomid_ros.inference.prior import OtherRecordings, Prior
from geomid_ros.inference.selection import Selection
from geomid_ros.model.effects import AtJoint, AtJoints, OnLink, OnRobot, Place
from geomid_ros.types import BoolArray, FloatArray

from . import planted
from .small import LINK, PAYLOAD, PRIOR, ROWS, Recording, at

VISCOUS, OTHER = at("viscous_friction", 0), at("viscous_friction", 1)
TERM = VISCOUS.terms[0]


RNG = np.random.default_rng(7)


def first_noise(residual: FloatArray, columns: dict[EffectTerm, dict[int, FloatArray]]) -> tuple[Autoregression, ...]:
    """Before anything is named: what the motion of the channel's own joint does not explain, one joint a channel."""
    count, channels = residual.shape
    problem: Any = SimpleNamespace(
        residual=lambda *_: residual,
        records=SimpleNamespace(segment=np.zeros(count, dtype=np.int64)),
        model=SimpleNamespace(channels=[SimpleNamespace(joint=channel) for channel in range(channels)]),
    )
    bare: Any = None
    valid = np.ones(residual.shape, dtype=bool)
    valid[count // 2] = False
    return analysis._flexible_noise(problem, columns, bare, valid)


@pytest.mark.parametrize("memory", [0.0, 0.7])
def test_an_effect_at_its_joint_is_no_noise_and_what_others_and_curves_explain_is(memory: float) -> None:
    white, *smooth = RNG.standard_normal((4, 3000))
    noise = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], white)
    own, alien, curve = (np.convolve(column, np.ones(20), mode="same") for column in smooth)
    columns = {TERM: {0: own}, OTHER.terms[0]: {0: alien, 1: alien}}
    for extra, is_noise in ((3.0 * own, False), (0.5 * alien, True), (0.5 * curve, True)):
        found = first_noise(np.column_stack([noise + extra, np.zeros(3000)]), columns)[0]
        if is_noise:
            assert found.variances[0] > 2.0
        else:
            assert np.append(found.predictors[found.order], [0.0])[0] == pytest.approx(memory, abs=0.06)
            assert found.variances[-1] == pytest.approx(1.0 - memory**2, rel=0.1)


def test_the_first_noise_is_that_of_what_was_measured_however_many_columns_there_are() -> None:
    """Columns of as many directions as there are rows leave nothing, and what rounding says of the noise."""
    noise = lfilter([1.0], [1.0, -0.8], RNG.standard_normal((80, 30)), axis=0)
    everywhere = {
        replace(TERM, place=OnRobot(), index=index): dict.fromkeys(range(30), column)
        for index, column in enumerate(RNG.standard_normal((100, 80)))
    }
    found = first_noise(noise, everywhere)
    assert 0.45 < np.mean([process.predictors[1][0] for process in found if process.order]) < 0.9
    assert 0.5 < np.mean([process.variances[-1] for process in found]) < 2.0


def test_a_link_that_is_lighter_now_carries_nothing_whatever_else_makes_a_payload_likely(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It has been changed, beside another name."""
    known = OtherRecordings(1e2 * np.eye(10), np.zeros(10))
    identified = replace(PRIOR, prior_std=0.05, certainty=100.0, identified=True, other_recordings=known)
    design = Recording(7, [PAYLOAD, VISCOUS]).design({TERM: 0.5}, 0.7 * LINK)

    def searched(prior: Prior, *found: Candidate) -> analysis._Round:
        search = Selection(design, prior, [PAYLOAD, VISCOUS])
        unused: Any = None
        return analysis._Round(unused, unused, search, search.fit(found))

    monkeypatch.setattr(analysis, "_searched", lambda _, prior, __: searched(prior, VISCOUS))
    task: Any = SimpleNamespace(links=[0], tried=[PAYLOAD, VISCOUS])
    found, contested = analysis._with_changed_link(task, searched(identified, PAYLOAD, VISCOUS))
    assert found.search.prior.changed_link == 0
    assert contested == 0.0


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
