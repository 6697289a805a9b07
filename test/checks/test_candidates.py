"""Probabilities of causes are those of hypotheses of equal odds, and nothing wrong is one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from checks.test_efforts import case
from geomid_ros.checks.candidates import (
    PROBABLE,
    CandidateTest,
    FaultCandidate,
    contradicted,
    decide,
    probabilities,
)
from geomid_ros.checks.causes import Cause
from geomid_ros.checks.effort_data import EffortData
from geomid_ros.checks.evidence import LEAST_SIGMA, Evidence
from geomid_ros.checks.sample_reservoir import FEWEST


@pytest.mark.parametrize("count", [1, 20, 300])
def test_without_evidence_nothing_is_as_probable_as_all_causes(count: int) -> None:
    shares = probabilities(np.zeros(count).tolist(), count)
    assert shares[-1] == pytest.approx(0.5)


def test_the_more_causes_are_tried_the_more_one_has_to_explain() -> None:
    """By Bayes' rule: n causes of equal odds, each of which is one in 2 n at first."""
    for count in (10, 1000):
        odds = PROBABLE / (1.0 - PROBABLE)
        gain = np.log(odds * count) / FEWEST
        assert probabilities([gain], count)[0] == pytest.approx(PROBABLE)


COUNT = 100


def subject() -> EffortData:
    """Seven joints, of which the last one hardly carries anything, and noise at each."""
    seven = case("arm7", 1)
    samples = seven.samples.select(slice(None, None, 10))
    every = EffortData.of_all(seven.model.robot, samples)
    noise = np.random.default_rng(0).normal(size=every.measured.shape)
    return every.with_efforts(every.measured + 0.5 * every.measured_std * noise)


def tried(of: EffortData, better: Sequence[float], places: Sequence[int], first: float = 1.0) -> CandidateTest:
    """A cause by which each joint is so much better explained, in the first part of the recording by a factor."""
    begin = of.samples.stamps[0]

    def undo(part: EffortData) -> Evidence:
        gain = np.sum(better) * (
            first if part.samples.stamps[0] == begin and len(part.samples) < len(of.samples) else 1.0
        )
        return replace(
            part.nominal,
            log_evidence=part.nominal.log_evidence + gain * len(part.samples),
            sigmas=part.nominal.sigmas * np.exp(-np.array(better)),
        )

    cause = Cause(kind="cause", sentence="it is this", places=tuple(of.names[place] for place in places))
    return CandidateTest(FaultCandidate(cause=cause, fit_corrected=undo), of)


@pytest.mark.parametrize(
    ("better", "place", "is_named"),
    [
        ([0.0, 1.0, *[0.0] * 5], 1, True),
        ([0.0, 1.0, -0.3, *[0.0] * 4], 1, True),
        ([0.0, -0.05, *[0.0] * 4, 1.0], 6, True),
        ([0.0, -0.1, *[0.0] * 4, 1.0], 6, False),
        ([*[0.0] * 4, -0.1, 1.0, 0.0], 5, True),
        ([*[0.0] * 4, -0.1, 0.0, 1.0], 6, False),
    ],
)
def test_joints_that_it_explains_worse_contradict_a_cause_unless_larger_efforts_say_so(
    better: Sequence[float], place: int, is_named: bool
) -> None:
    """The last joint carries least: what it gains outweighs no other joint."""
    of = subject()
    assert of.relative_std[1] > LEAST_SIGMA
    assert of.relative_std[-1] < LEAST_SIGMA
    decision = decide([tried(of, better, [place])], COUNT, of.nominal)
    assert (decision.finding is not None) == is_named
    assert len(decision.unconfirmed) == (not is_named)
    assert contradicted(decision.unconfirmed, COUNT) == []


def test_what_one_half_contradicts_says_nothing() -> None:
    of = subject()
    decision = decide([tried(of, [0.0, 1.0, *[0.0] * 5], [1], first=-1.0)], COUNT, of.nominal)
    assert len(decision.unconfirmed) == 1
    assert contradicted(decision.unconfirmed, COUNT) == []


def test_of_a_joint_that_a_doubted_cause_is_about_nothing_is_named() -> None:
    """Nor of one that a more probable cause of both joints is about; a third one is another matter."""
    of = subject()
    doubted = tried(of, [0.0, 2.0, *[0.0] * 5], [1], first=-1.0)
    both, other = tried(of, [0.0, 1.0, *[0.0] * 5], [1, 3]), tried(of, [0.0, 0.0, 0.0, 0.9, *[0.0] * 3], [3])
    third = tried(of, [0.0] * 4 + [0.9, 0.0, 0.0], [4])
    assert decide([doubted, both, other], COUNT, of.nominal).finding is None
    alone = decide([doubted, both, third], COUNT, of.nominal).finding
    assert alone is not None
    assert alone.cause.places == (of.names[4],)


def test_what_is_hidden_still_says_that_something_is_wrong() -> None:
    """Whatever hides it: of a joint that counts the recording is not explained as it is."""
    of = subject()
    small, hidden = tried(of, [0.0, -0.3, *[0.0] * 4, 2.0], [6]), tried(of, [0.0, 1.0, *[0.0] * 5], [1, 6])
    decision = decide([small, hidden], COUNT, of.nominal)
    assert decision.finding is None
    (doubt,) = contradicted(decision.unconfirmed, COUNT)
    assert doubt.places == (of.names[1],)
