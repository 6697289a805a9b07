"""The joint fit and its score test: against exact fits, and where they must be blind."""

from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.gap import candidates as library
from geomid_ros.gap.evidence.linearised_problem import LinearisedProblem, total_model
from geomid_ros.gap.evidence.noise import Autoregression
from geomid_ros.gap.evidence.records import Records
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.inference.design import Design
from geomid_ros.inference.fit import JointFit, fit, fit_of_prior
from geomid_ros.inference.prior import OtherRecordings

from . import planted

MODEL = planted.model()
CANDIDATES = library.candidates(MODEL)
WHITE = (Autoregression.white(),) * len(MODEL.channels)
SMALL = 0.02  # [N m s/rad] of viscous friction at the second joint


def designed(*seeds: int, friction: float = SMALL) -> Design:
    """Of recordings of one robot, whose second joint has this friction."""
    rigid = planted.rigid(planted.true_inertias(7, 0.2))
    samples = [planted.recording(lambda q, v, a: rigid(q, v, a) + [0.0, friction, 0.0] * v, seed) for seed in seeds]
    problem = LinearisedProblem(
        MODEL, Records.make(samples, planted.CUTOFF), total_model(MODEL, fit_of_prior(planted.prior()))
    )
    return problem.design(problem.columns(term for candidate in CANDIDATES for term in candidate.terms), WHITE)


@pytest.fixture(scope="module")
def design() -> Design:
    return designed(7)


@pytest.fixture(scope="module")
def bare(design: Design) -> JointFit:
    return fit(design, planted.prior(), [])


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


def test_what_is_known_is_trusted_as_far_as_it_agrees() -> None:
    """Recordings whose links seem others, by many times what their noise allows, had errors of the model."""
    first, second = designed(7, friction=0.0), designed(8, friction=0.0)
    known = said(fit(first, planted.prior(), [], prior_std=0.2), first)
    agreeing = fit(second, replace(planted.prior(), other_recordings=known), [])
    assert agreeing.inflation < 2.0
    shifted = OtherRecordings(known.rows, known.residuals + 100.0 * np.random.default_rng(5).standard_normal(30))
    contradicting = fit(second, replace(planted.prior(), other_recordings=shifted), [])
    assert contradicting.inflation > 1000.0
    alone = fit(second, planted.prior(), [])
    np.testing.assert_allclose(contradicting.squares, alone.squares, rtol=0.02)


def test_a_payload_is_reached_from_afar() -> None:
    """Its prior lies at the link's centre; the body is many times its own size away from there."""
    inertias = planted.true_inertias(7, 0.2)
    loaded, centre = inertias.copy(), np.array([0.5, -0.6, 0.4])
    ball = centre @ centre * np.eye(3) - np.outer(centre, centre) + 1e-3 * np.eye(3)
    rows, columns = pseudo_inertia.INERTIA_ENTRIES
    loaded[-1] += 0.8 * np.concatenate([[1.0], centre, ball[rows, columns]])
    problem = LinearisedProblem(
        MODEL,
        Records.make([planted.recording(planted.rigid(loaded), 9)], planted.CUTOFF),
        total_model(MODEL, fit_of_prior(planted.prior())),
    )
    precise = replace(planted.prior(), inertias=inertias[list(MODEL.identified)].ravel(), prior_std=1e-3, certainty=1e4)
    payload = next(c for c in CANDIDATES if c.payload == len(MODEL.identified) - 1)
    found = fit(problem.design(problem.columns(()), WHITE), precise, [payload])
    body = pseudo_inertia.to_parameters(found.point.pseudo_inertias)[-1]
    stds = np.sqrt(np.diag(found.covariance)[found.manifold.link(found.manifold.links - 1)])
    assert np.all(np.abs(body[:4] - 0.8 * np.array([1.0, *centre])) < 3.0 * stds[:4])


def test_the_spread_of_the_inertias_is_found(design: Design, bare: JointFit) -> None:
    """The planted errors are of the usual size; a prior that takes them for ten times smaller is corrected."""
    assert np.all((bare.prior_stds > 0.1) & (bare.prior_stds < 0.35))
    assert np.max(fit(design, planted.prior(spread=0.02), []).prior_stds) > 0.06
