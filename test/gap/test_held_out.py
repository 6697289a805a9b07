"""Fits on data that they have not seen."""

from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.gap.judgement.held_out import strongest
from geomid_ros.gap.result import GapResult, Located
from geomid_ros.gap.workflow import GapSettings, find_gap

from . import planted

SETTINGS = GapSettings(cutoff=planted.CUTOFF)
CREEP = 0.02  # [N m/s]


def test_uncertainty_of_the_fit_explains_what_noise_does_not() -> None:
    """Seven seconds teach little of a faster motion: what they leave of it is larger than noise, as much as is said."""
    squares, expected = [], []
    for seed in range(5):
        dynamics = planted.rigid(planted.true_inertias(seed, 0.1))
        train, unseen = planted.recording(dynamics, seed, 7.0), planted.recording(dynamics, 100 + seed, 20.0, pace=2.0)
        gap = find_gap(planted.model(), [train], [unseen], SETTINGS).gap
        squares.append(gap.after**2)
        expected.append(gap.expected**2)
    assert np.mean(expected) > 1.1, "else this says nothing"
    assert np.mean(squares) == pytest.approx(np.mean(expected), rel=0.35)


@pytest.fixture(scope="module")
def drifting() -> GapResult:
    """An effort that creeps in the unseen recording only, so that nothing can be learnt of it."""
    dynamics = planted.rigid(planted.true_inertias(3, 0.1))
    unseen = planted.recording(dynamics, 4, 30.0)
    creeping = unseen.effort.copy()
    creeping[:, 1] += CREEP * ((unseen.stamps - unseen.stamps[0]) * 1e-9 - 15.0)
    unseen = replace(unseen, effort=creeping)
    return find_gap(planted.model(), [planted.recording(dynamics, 3)], [unseen], SETTINGS)


def test_a_gap_that_stays_open_is_told_with_what_it_depends_on(drifting: GapResult) -> None:
    assert drifting.verdict == "incomplete"
    assert [(entry.joint, entry.depends_on) for entry in drifting.unexplained] == [
        (planted.model().robot.joint_names[1], "time")
    ]
    assert drifting.unexplained[0].gap == pytest.approx(drifting.moving[1], rel=0.01)


def test_and_nothing_is_named_for_it(drifting: GapResult) -> None:
    assert drifting.findings == ()


def test_what_depends_on_nothing_is_not_said_to_depend_on_the_first_in_line() -> None:
    assert strongest(Located("wrench/fx", 0.0, 0.0, 0.0, 0.0, 0.0)) == "unknown"
    assert strongest(Located("joint1", 0.1, 0.0, 0.3, 0.2, 0.0)) == "load"
