"""The joint posterior: its coordinates, and the robots that are drawn from it."""

from __future__ import annotations

import numpy as np
import pytest
from geometry import bodies

from geomid_ros.estimation.posterior import EffectCoordinate, Posterior
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import FloatArray

from .problems import ALL

COUNT = 3000


def posterior(covariance: FloatArray, seed: int = 0) -> Posterior:
    """Of the bodies and coefficients of a random point."""
    parameters = bodies.point(np.random.default_rng(seed), ALL).parameters
    effects = [
        EffectCoordinate(name=f"effect{k}", place="joint", parameter="level", unit="N m", positive=k < ALL.positives)
        for k in range(ALL.positives + len(ALL.scales))
    ]
    return Posterior(
        links=tuple(f"link{k}" for k in range(ALL.links)),
        merged=((),) * ALL.links,
        effects=tuple(effects),
        parameters=parameters,
        covariance=covariance,
        scales=ALL.scales,
        prior=parameters,
        prior_stds=np.ones(ALL.dimension),
    )


def mixed(seed: int, stds: FloatArray) -> FloatArray:
    """A covariance with these standard deviations along random directions."""
    vectors, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(len(stds), len(stds))))
    return (vectors * stds**2) @ vectors.T


def test_the_jacobian_is_the_derivative_along_geodesics() -> None:
    found = posterior(np.eye(ALL.dimension))
    step = 1e-6
    for k in range(ALL.dimension):
        tangent = np.zeros(ALL.dimension)
        tangent[k] = step
        ahead, behind = (found.manifold.exp(found.point, sign * tangent).parameters for sign in (1.0, -1.0))
        expected = (ahead - behind) / (2.0 * step)
        np.testing.assert_allclose(found.jacobian[:, k], expected, rtol=0, atol=1e-8 * np.max(np.abs(found.parameters)))


def test_the_effects_may_come_in_another_order() -> None:
    """What is known of each of them, and of it with the others, stays."""
    found = posterior(mixed(4, np.linspace(0.1, 0.5, ALL.dimension)))
    positive = len(found.effects) - len(ALL.scales)
    order = [*reversed(range(positive)), *reversed(range(positive, len(found.effects)))]
    other = found.with_effects([found.effects[place] for place in order])
    columns = [*range(10 * ALL.links), *(10 * ALL.links + place for place in order)]
    np.testing.assert_array_equal(other.parameters, found.parameters[columns])
    expected = found.parameter_covariance[np.ix_(columns, columns)]
    np.testing.assert_allclose(other.parameter_covariance, expected, rtol=1e-12, atol=0.0)


def test_other_effects_are_refused() -> None:
    found = posterior(np.eye(ALL.dimension))
    own = found.effects[0]
    with pytest.raises(ValueError, match=f"it has a {own.name} of {own.place}"):
        found.with_effects(found.effects[1:])
    with pytest.raises(ValueError, match=f"it has no {own.name} of {own.place}"):
        found.with_effects([*found.effects, own])


def test_coordinates_are_those_of_the_documented_matrices() -> None:
    """Of another robot, whose pseudo-inertias are ``P^1/2 (1 + X) P^1/2``, written out."""
    rng, found = np.random.default_rng(3), posterior(np.eye(ALL.dimension))
    x = 0.1 * rng.normal(size=ALL.dimension)
    parts = []
    for link in range(ALL.links):
        own = x[10 * link : 10 * link + 10]
        whole = np.diag(1.0 + own[:4])
        for place, (row, column) in enumerate([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)], 4):
            whole[row, column] = whole[column, row] = own[place] / np.sqrt(2.0)
        values, vectors = np.linalg.eigh(found.point.pseudo_inertias[link])
        root = vectors @ np.diag(np.sqrt(values)) @ vectors.T
        parts.append(pseudo_inertia.to_parameters(root @ whole @ root))
    rest = x[10 * ALL.links :]
    parts.append(found.point.positives * (1.0 + rest[: ALL.positives]))
    parts.append(found.point.reals + ALL.scales * rest[ALL.positives :])
    np.testing.assert_allclose(found.coordinates(np.concatenate(parts)), x, rtol=0, atol=1e-9)


@pytest.mark.parametrize("spread", [1.0, 3.0])
def test_whatever_the_spread_every_robot_can_exist(spread: float) -> None:
    found = posterior(mixed(4, np.geomspace(1e-4, 0.6, ALL.dimension)))
    drawn = found.draw(500, np.random.default_rng(5), spread)
    links = drawn[:, : 10 * ALL.links].reshape(-1, 10)
    moments = np.linalg.eigvalsh(pseudo_inertia.central_inertia(links))
    assert np.all(links[:, 0] > 0.0)
    assert np.all(moments[:, 0] > 0.0)
    assert np.all(moments[:, 0] + moments[:, 1] > moments[:, 2])
    assert np.all(drawn[:, 10 * ALL.links : 10 * ALL.links + ALL.positives] > 0.0)


def test_wide_posteriors_are_drawn_as_by_rejection() -> None:
    """The same Gaussian, of which all that cannot exist is thrown away: moments of every direction agree, those of
    directions that the data resolve with the Gaussian's."""
    stds = np.where(np.arange(ALL.dimension) < 5, 1e-4, 0.45)
    found = posterior(mixed(6, stds))
    values, vectors = np.linalg.eigh(found.covariance)
    rng, kept, tried = np.random.default_rng(7), [], 0
    while len(kept) < COUNT:
        tried += 1
        trial = vectors @ (np.sqrt(values) * rng.normal(size=ALL.dimension))
        parameters = found.parameters + found.jacobian @ trial
        own = parameters[: 10 * ALL.links].reshape(-1, 10)
        relative = np.linalg.eigvals(
            np.linalg.solve(found.point.pseudo_inertias, pseudo_inertia.from_parameters(own))
        ).real
        coefficients = parameters[10 * ALL.links :][: ALL.positives] / found.point.positives
        if np.min(relative) > 0.05 and np.min(coefficients) > 0.05:
            kept.append(trial)
    drawn = found.draw(COUNT, np.random.default_rng(8))
    here = np.array([found.coordinates(parameters) for parameters in drawn]) @ vectors / np.sqrt(values)
    there = np.array(kept) @ vectors / np.sqrt(values)
    assert tried > 1.5 * COUNT
    np.testing.assert_allclose(np.mean(here, axis=0), np.mean(there, axis=0), rtol=0, atol=0.12)
    np.testing.assert_allclose(np.var(here, axis=0), np.var(there, axis=0), rtol=0, atol=0.15)
    np.testing.assert_allclose(np.var(here[:, :5], axis=0), 1.0, rtol=0, atol=0.15)
