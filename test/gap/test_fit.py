"""The joint fit and its score test: against exact fits, and where they must be blind."""

from collections.abc import Mapping

import numpy as np
import pytest

from geomid_ros.gap import library
from geomid_ros.gap.design import Design
from geomid_ros.gap.fit import JointFit, Prior, fit, unfitted
from geomid_ros.gap.library import Candidate
from geomid_ros.gap.noise import Autoregression
from geomid_ros.gap.record import Records
from geomid_ros.gap.score_test import improvement
from geomid_ros.gap.stage import Stage, TotalModel

from . import planted

MODEL = planted.model()
CANDIDATES = library.candidates(MODEL)
WHITE = (Autoregression.white(),) * len(MODEL.channels)
SMALL = 0.02  # [N m s/rad] of viscous friction at the second joint


def prior(spread: float = 0.2) -> Prior:
    return Prior(MODEL.nominal_inertias, spread, (), np.zeros(0), np.zeros(0))


@pytest.fixture(scope="module")
def design() -> Design:
    rigid = planted.rigid(planted.true_inertias(7, 0.2))
    samples = planted.recording(lambda q, v, a: rigid(q, v, a) + [0.0, SMALL, 0.0] * v, 7)
    stage = Stage(MODEL, Records.make([samples], planted.CUTOFF), TotalModel.of(MODEL, unfitted(prior())))
    return stage.design(stage.columns(CANDIDATES, ()), WHITE)


@pytest.fixture(scope="module")
def bare(design: Design) -> JointFit:
    return fit(design, prior(), [])


def named(effect: str, joint: int) -> Candidate:
    return next(c for c in CANDIDATES if c.effect == effect and c.joint == joint)


def test_the_fit_is_a_minimum(design: Design) -> None:
    """Steps away from it, with the spread that it found, raise the score."""
    found = fit(design, prior(), [named("viscous_friction", 1)], spread=0.2)
    rng = np.random.default_rng(0)
    for _ in range(5):
        direction = rng.standard_normal(found.manifold.dimension)
        direction *= 0.3 / np.sqrt(direction @ found.information @ direction)
        for sign in (1.0, -1.0):
            assert objective(design, found, sign * direction) > objective(design, found, 0.0 * direction)


def objective(design: Design, found: JointFit, tangent: np.ndarray) -> float:
    """The posterior without the spread's own terms, from its definition."""
    point = found.manifold.exp(found.point, tangent)
    vector = np.append(point.parameters, -1.0)
    squares = [vector @ products @ vector for products in found.products]
    links = found.manifold.log(found.manifold.point(np.append(MODEL.nominal_inertias, point.reals)), point)[:-1]
    return float(design.counts @ np.log(squares) + links @ links / found.spread**2)


@pytest.mark.parametrize(("effect", "joint"), [("viscous_friction", 1), ("coulomb_friction", 1), ("effort_offset", 2)])
def test_the_score_test_foretells_the_exact_fit(design: Design, bare: JointFit, effect: str, joint: int) -> None:
    candidate = named(effect, joint)
    gain, _ = improvement(design, bare, candidate)
    exact = bare.score - fit(design, prior(), [candidate], bare, bare.spread).score
    assert abs(gain - exact) < 0.02 * abs(exact) + 0.5


def test_separability_is_one_beside_the_inertias_and_none_within(design: Design) -> None:
    """No inertia imitates viscous friction; the rotor of the first, upright joint is an inertia of its link."""
    free = fit(design, prior(), [], spread=2.0)
    separable: Mapping[tuple[str, int], float] = {
        (effect, joint): improvement(design, free, named(effect, joint))[1]
        for effect, joint in (("viscous_friction", 0), ("viscous_friction", 1), ("rotor_inertia", 0))
    }
    assert separable["viscous_friction", 0] > 0.9
    assert separable["viscous_friction", 1] > 0.9
    assert separable["rotor_inertia", 0] < 1e-3


def test_the_spread_of_the_inertias_is_found(design: Design, bare: JointFit) -> None:
    """The planted errors are of the usual size; a prior that takes them for ten times smaller is corrected."""
    assert 0.1 < bare.spread < 0.35
    assert 0.06 < fit(design, prior(0.02), []).spread < 0.35
