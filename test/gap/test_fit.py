"""The joint fit and its score test: against exact fits, and where they must be blind."""

from dataclasses import replace

import numpy as np

from geomid_ros.gap import candidates as library
from geomid_ros.gap.linearised_problem import LinearisedProblem
from geomid_ros.gap.noise import Autoregression
from geomid_ros.gap.records import Records
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
    problem = LinearisedProblem.at(MODEL, Records.make(samples, planted.CUTOFF), fit_of_prior(planted.prior()))
    return problem.design(problem.columns(term for candidate in CANDIDATES for term in candidate.terms), WHITE)


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
    shifted = OtherRecordings(known.rows, known.residuals + 400.0 * np.random.default_rng(5).standard_normal(30))
    contradicting = fit(second, replace(planted.prior(), other_recordings=shifted), [])
    assert contradicting.inflation > 1000.0
    alone = fit(second, planted.prior(), [])
    np.testing.assert_allclose(contradicting.squares, alone.squares, rtol=0.02)
