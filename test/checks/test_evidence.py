"""The evidence is the density of a normal distribution, and what it holds at zero wants to be less."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

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
from geomid_ros.checks.effort_data import EffortData, _curves
from geomid_ros.checks.evidence import FRICTION, LEAST_SIGMA, Evidence, Unknowns, evidence
from geomid_ros.checks.sample_reservoir import FEWEST
from geomid_ros.types import FloatArray

INSTANTS, CHANNELS, LINKS = 40, 2, 3
SETTLED = 1e-4
SURE = np.array([-1.0, 2.0, 1.5, 1.2, 1.0])
"""Friction of which nothing is held at zero."""


def drawn(seed: int, friction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Columns ``(C, N, r + 5)`` and targets ``(C, N)`` with this friction ``(5,)`` at each channel."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(CHANNELS, INSTANTS, LINKS + FRICTION))
    unknowns = np.concatenate([rng.normal(size=LINKS), friction])
    return columns, columns @ unknowns + 0.3 * rng.normal(size=(CHANNELS, INSTANTS))


def found(columns: FloatArray, targets: FloatArray, tolerated: FloatArray) -> Evidence:
    by_instant = columns.transpose(1, 0, 2)
    return evidence(targets.T, Unknowns.of(by_instant[:, :, :LINKS], by_instant[:, :, LINKS:]), tolerated)


def test_instants_that_do_not_count_are_as_if_they_were_not_there() -> None:
    tolerated = np.full((CHANNELS, FRICTION), 2.0)
    columns, targets = drawn(0, SURE)
    by_instant, counted = columns.transpose(1, 0, 2), np.ones((INSTANTS, CHANNELS))
    counted[30:] = 0.0
    unknowns = Unknowns.of(by_instant[:, :, :LINKS], by_instant[:, :, LINKS:])
    some = evidence(targets.T, unknowns, tolerated, counted=counted)
    fewer = found(columns[:, :30], targets[:, :30], tolerated)
    assert some.log_evidence == pytest.approx(fewer.log_evidence)
    assert some.link_errors == pytest.approx(fewer.link_errors)


def test_by_channel_unknowns_are_those_of_all_columns() -> None:
    """Of links of which a channel does not feel all, in other units, with more of them and with others of its own."""
    rng = np.random.default_rng(5)
    links, more = rng.normal(size=(INSTANTS, CHANNELS, LINKS)), rng.normal(size=(INSTANTS, CHANNELS, 2))
    links[:, 0, 1] = more[:, 1, 0] = 0.0
    own, other = rng.normal(size=(2, INSTANTS, CHANNELS, 3))
    target, units, weights = (
        rng.normal(size=(INSTANTS, CHANNELS)),
        np.array([0.5, 3.0]),
        rng.random((INSTANTS, CHANNELS)),
    )
    unknowns = Unknowns.of(links, own).with_separate(other).with_errors(more).times(weights).select(slice(10, None))
    every = np.concatenate([links, more], axis=2)
    errors = rng.normal(size=LINKS + 2)
    assert unknowns.link_efforts(errors) == pytest.approx((weights * (every @ errors))[10:])
    sums = unknowns.with_target(target[10:], units)
    for channel in range(CHANNELS):
        of_own = np.zeros((INSTANTS, 3 * CHANNELS))
        of_own[:, 3 * channel : 3 * channel + 3] = other[:, channel]
        felt = weights[:, channel, None] * np.column_stack([every[:, channel] / units[channel], of_own])
        rows = np.column_stack([felt, target[:, channel]])[10:]
        assert sums.weighed(np.arange(len(sums)) == channel) == pytest.approx(rows.T @ rows)


def test_it_is_the_density_of_all_targets_together() -> None:
    """With friction that is surely positive nothing is held: then it is a plain normal distribution."""
    tolerated = np.full((CHANNELS, FRICTION), 2.0)
    columns, targets = drawn(0, SURE)
    result = found(columns, targets, tolerated)
    own = np.zeros((CHANNELS, INSTANTS, FRICTION * CHANNELS))
    for channel in range(CHANNELS):
        own[channel, :, FRICTION * channel : FRICTION * channel + FRICTION] = columns[channel, :, LINKS:]
    every = np.concatenate([columns[:, :, :LINKS], own], axis=2).reshape(-1, LINKS + FRICTION * CHANNELS)
    spread = np.concatenate([np.ones(LINKS), tolerated.ravel()])
    covariance = (every * spread**2) @ every.T + np.diag(np.repeat(result.sigmas**2, INSTANTS))
    expected = multivariate_normal(np.zeros(len(every)), covariance).logpdf(targets.ravel())
    assert result.log_evidence == pytest.approx(expected, abs=SETTLED * abs(expected))


def test_the_links_are_as_unsure_as_the_normal_equations_say() -> None:
    """Nothing is held: the friction is surely positive."""
    tolerated = np.full((CHANNELS, FRICTION), 2.0)
    columns, targets = drawn(0, SURE)
    sigmas = found(columns, targets, tolerated).sigmas
    precision = np.diag(np.append(np.ones(LINKS), np.full(FRICTION * CHANNELS, 0.25)))
    for channel, own in enumerate(columns / sigmas[:, None, None]):
        places = [*range(LINKS), *range(LINKS + FRICTION * channel, LINKS + FRICTION * channel + FRICTION)]
        precision[np.ix_(places, places)] += own.T @ own
    expected = np.sqrt(np.diag(np.linalg.inv(precision))[:LINKS])
    assert found(columns, targets, tolerated).deviations() == pytest.approx(expected, rel=2e-3)


def test_friction_of_the_wrong_sign_stays_at_zero() -> None:
    """The links are those of the bounded minimum, found by another solver."""
    columns, targets = drawn(1, np.array([0.5, -2.0, 1.0, 0.7, -1.0]))
    tolerated = np.full((CHANNELS, FRICTION), 2.0)
    result = found(columns, targets, tolerated)

    def cost(unknowns: FloatArray) -> float:
        links, own = unknowns[:LINKS], unknowns[LINKS:].reshape(CHANNELS, FRICTION)
        left = [targets[c] - columns[c] @ np.concatenate([links, own[c]]) for c in range(CHANNELS)]
        data = sum(np.sum(left[c] ** 2) / result.sigmas[c] ** 2 for c in range(CHANNELS))
        return float(data + np.sum(links**2) + np.sum((own / tolerated) ** 2))

    bounds = [(None, None)] * LINKS + [(None, None), *[(0.0, None)] * (FRICTION - 1)] * CHANNELS
    best = minimize(cost, np.zeros(LINKS + FRICTION * CHANNELS), bounds=bounds, options={"ftol": 1e-14, "gtol": 1e-9})
    assert result.link_errors == pytest.approx(best.x[:LINKS], abs=2e-3)


def test_what_is_always_the_same_but_for_rounding_has_no_curves() -> None:
    """A joint that stands exactly still, whose filtered velocity is some 1e-16 rad/s."""
    moving = np.sin(np.linspace(0.0, 9.0, 64))
    still, friction = np.full(64, 0.25), np.zeros((64, 2, 3))
    friction[:, 0, 1], friction[:, 1, 1:] = 2.0**-50, np.stack([moving, np.sign(moving)], axis=1)
    curves = _curves(np.stack([still, moving], 1), friction, np.stack([still, moving], 1))
    assert not np.any(np.ptp(curves[:, 0], axis=0))
    assert np.all(np.isfinite(curves))
    assert np.any(curves[:, 1])


@pytest.mark.parametrize("count", [1, 10, 1000])
def test_the_more_causes_are_tried_the_more_one_has_to_explain(count: int) -> None:
    """By Bayes' rule: n causes of equal odds, each of which is one in 2 n at first; without evidence nothing is as
    probable as all of them."""
    assert probabilities(np.zeros(count).tolist(), count)[-1] == pytest.approx(0.5)
    gain = np.log(PROBABLE / (1.0 - PROBABLE) * count) / FEWEST
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
