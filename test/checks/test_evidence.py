"""The evidence is the density of a normal distribution, and what it holds at zero wants to be less."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

from geomid_ros.checks.effort_data import _curves
from geomid_ros.checks.evidence import FRICTION, Evidence, Unknowns, evidence
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
