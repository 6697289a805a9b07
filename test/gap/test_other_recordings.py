"""What is known before, of a robot of which a link has been changed: against the marginal of a Gaussian."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from geomid_ros.gap.linearised_problem import LinearisedProblem
from geomid_ros.gap.noise import Autoregression
from geomid_ros.gap.records import Records
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.inference.design import Design
from geomid_ros.inference.fit import JointFit, fit, fit_of_prior
from geomid_ros.inference.prior import OtherRecordings, Prior

from . import planted
from .small import PRIOR, Recording, at

RANDOM = np.random.default_rng(11)
KNOWN = OtherRecordings(RANDOM.normal(scale=30.0, size=(12, 30)), RANDOM.normal(size=12))
IDENTIFIED = replace(planted.prior(spread=0.05), certainty=100.0, other_recordings=KNOWN)


def squares(prior: Prior, off: np.ndarray) -> float:
    """Minus twice the logarithm of what other recordings say of links that are ``off`` the model, and of their cost."""
    assert prior.other_recordings is not None
    return float(np.sum((prior.other_recordings.residuals + prior.other_recordings.rows @ off) ** 2)) + prior.cost


@pytest.mark.parametrize("link", range(3))
def test_what_a_changed_link_was_is_marginalised(link: int) -> None:
    """The residuals are those of unit variance and of the old link's error, of the usual spread, together."""
    changed, places = IDENTIFIED.with_changed(link), slice(10 * link, 10 * link + 10)
    manifold = ParameterManifold(3, 0, np.ones(0))
    jacobian = manifold.whiten(manifold.point(IDENTIFIED.inertias), np.eye(30))[places, places]
    old = 0.05 * KNOWN.rows[:, places] @ jacobian
    both = multivariate_normal(np.zeros(12), np.eye(12) + old @ old.T)
    others = np.ones(30)
    others[places] = 0.0
    for scale in (0.0, 0.01, 0.1):
        off = scale * RANDOM.normal(size=30)
        logarithm = both.logpdf(KNOWN.residuals + KNOWN.rows @ (others * off))
        expected = -2.0 * logarithm - 12.0 * np.log(2.0 * np.pi)
        assert squares(changed, off) == pytest.approx(expected)


def test_what_a_changed_link_costs_counts_in_the_score() -> None:
    design = Recording(3, [at("viscous_friction", 0)]).design({})
    free, costly = (fit(design, replace(PRIOR, cost=cost), []).score for cost in (0.0, 7.0))
    assert costly - free == pytest.approx(7.0)


def test_beside_no_other_recordings_no_link_has_been_changed_since() -> None:
    alone = replace(IDENTIFIED, other_recordings=None)
    assert alone.with_changed(1) is alone


def test_without_other_recordings_each_effect_is_known_as_well_as_they_said() -> None:
    """By itself, the links' errors integrated out; and it may have changed since then."""
    rows, spreads, changes = RANDOM.normal(scale=2.0, size=(12, 32)), np.array([0.3, 5.0, 7.0]), np.array([0.1, 0.2])
    known = OtherRecordings(rows, np.zeros(12), changes)
    prior = replace(IDENTIFIED, terms=("a", "b", "c"), values=np.ones(3), prior_stds=spreads, other_recordings=known)
    manifold = ParameterManifold(3, 0, np.ones(0))
    jacobian = manifold.whiten(manifold.point(IDENTIFIED.inertias), np.eye(30))
    links = 0.05**2 * jacobian @ jacobian.T
    covariance = np.zeros((32, 32))
    covariance[:30, :30], covariance[30:, 30:] = links, np.diag(spreads[:2] ** 2)
    gain = covariance @ rows.T @ np.linalg.inv(rows @ covariance @ rows.T + np.eye(12))
    then = np.diag(covariance - gain @ rows @ covariance)[30:]
    alone = prior.without_other_recordings
    assert alone.other_recordings is None
    np.testing.assert_allclose(alone.prior_stds, np.append(np.sqrt(then + changes**2), spreads[2]), rtol=1e-8)
    assert alone.without_other_recordings is alone


MODEL = planted.model()
SMALL = 0.02  # [N m s/rad] of viscous friction at the second joint


def designed(*seeds: int, friction: float = SMALL) -> Design:
    """Of recordings of one robot, whose second joint has this friction."""
    rigid = planted.rigid(planted.true_inertias(7, 0.2))
    samples = [planted.recording(lambda q, v, a: rigid(q, v, a) + [0.0, friction, 0.0] * v, seed) for seed in seeds]
    problem = LinearisedProblem.at(MODEL, Records.make(samples, planted.CUTOFF), fit_of_prior(planted.prior()))
    return problem.design({}, (Autoregression.white(),) * len(MODEL.channels))


def said(found: JointFit, design: Design) -> OtherRecordings:
    """What a recording said of the links, which were fitted alone."""
    count = len(MODEL.nominal_inertias)
    weights, vector = design.counts / found.squares, np.append(found.point.parameters, -1.0)
    products = design.gather(found.bodies, found.terms)
    weighed = products.weighed(weights)
    values, vectors = np.linalg.eigh(weighed[:count, :count])
    rows = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    slope = weighed[:count] @ vector
    residuals = vectors.T @ slope / np.sqrt(np.maximum(values, 1e-9 * values[-1]))
    return OtherRecordings(rows, residuals - rows @ (vector[:count] - MODEL.nominal_inertias))


def test_what_is_known_of_a_recording_counts_as_if_it_were_fitted_again() -> None:
    first, second, both = (fit(designed(*seeds), planted.prior(), [], prior_std=0.2) for seeds in ((7,), (8,), (7, 8)))
    again = fit(designed(8), replace(planted.prior(), other_recordings=said(first, designed(7))), [], prior_std=0.2)

    def errors(found: JointFit) -> float:
        """Mean square of the distance from the fit to both, in its standard deviations."""
        jacobian = both.manifold.whiten(both.point, np.eye(both.manifold.dimension))
        off = np.linalg.solve(jacobian, found.point.parameters - both.point.parameters)
        return float(off @ both.information @ off) / len(off)

    assert errors(again) < 0.15, "the remainder of both recordings is one, or one of each"
    assert errors(again) < 0.2 * min(errors(first), errors(second))
