"""The compiled functions beside those of numpy that stand in for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from geometry import bodies
from numpy.linalg import LinAlgError

from geomid_ros.estimation.channel_products import ChannelProducts
from geomid_ros.estimation.objective import Evaluation, ResidualObjective
from geomid_ros.estimation.profile_objective import Profile, ProfileObjective, minimum
from geomid_ros.geometry import compiled
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import FloatArray

# Fewer links than the compiled code takes at once, as many, and more; with and without coefficients of each kind.
MANIFOLDS = pytest.mark.parametrize(
    "manifold",
    [
        ParameterManifold(1, 0, np.zeros(0)),
        ParameterManifold(3, 2, np.array([0.1, 20.0])),
        ParameterManifold(8, 0, np.array([2.0])),
        ParameterManifold(17, 3, np.zeros(0)),
        ParameterManifold(0, 1, np.array([0.5])),
    ],
    ids=str,
)
needs_compiled = pytest.mark.skipif(compiled.native is None, reason="built without a compiler")
ROUNDING = 1e-9  # of the largest entry; bodies are as much as 1e5 times as large in one direction as in another


def sparse(rng: np.random.Generator, manifold: ParameterManifold, point: Point, channels: int = 4) -> Profile:
    """Channels that have fewer and fewer of the columns, as efforts along an arm."""
    size = manifold.dimension
    own = []
    for channel in range(channels):
        rows = bodies.rows(rng, manifold, point, 2 * size + 3)
        rows[:, channel * size // channels :: 2] = 0.0
        columns = np.column_stack([rows, rows @ point.parameters * (1.0 + 0.1 * rng.normal(size=len(rows)))])
        products = columns.T @ columns
        places = np.flatnonzero(np.diag(products))
        own.append((places, products[places[:, None], places]))
    prior = bodies.point(rng, manifold)
    return Profile(manifold, ChannelProducts.of(size + 1, iter(own)), 100.0 + np.arange(channels), prior)


def without(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "native", None)


def assert_same(one: Evaluation, other: Evaluation) -> None:
    for name in ("value", "gradient", "information", "hessian"):
        expected = np.asarray(getattr(other, name))
        largest = max(np.max(np.abs(expected)), abs(other.value))  # slopes of it are small differences at a minimum
        np.testing.assert_allclose(getattr(one, name), expected, rtol=0.0, atol=ROUNDING * largest)


def weights(rng: np.random.Generator, manifold: ParameterManifold) -> FloatArray:
    """Equal within a link."""
    each = rng.uniform(0.1, 10.0, size=manifold.dimension)
    each[manifold.inertial] = np.repeat(each[: manifold.links], 10)
    return each


@needs_compiled
@MANIFOLDS
def test_objectives_of_channels_and_of_products_are_the_same(
    manifold: ParameterManifold, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(1)
    point = bodies.point(rng, manifold)
    profile = sparse(rng, manifold, point)
    known = rng.normal(size=(2, manifold.dimension + 1))
    own, products = known.T @ known, profile.products.weighed([1.0, 0.0, 0.0, 0.0])
    objectives = (
        ProfileObjective(profile, weights(rng, manifold), own),
        ResidualObjective(manifold, products, bodies.point(rng, manifold), weights(rng, manifold), 1.0, own),
    )
    evaluations, squares = [objective.evaluate(point) for objective in objectives], profile.squares(point)
    without(monkeypatch)
    for evaluation, objective in zip(evaluations, objectives, strict=True):
        assert_same(evaluation, objective.evaluate(point))
    np.testing.assert_allclose(squares, profile.squares(point), rtol=ROUNDING)


@pytest.mark.usefixtures("either")
def test_a_channel_below_its_floor_is_one_of_known_noise() -> None:
    """Its value is that of a normal density with the floor as standard deviation, and the gradient is its slope."""
    rng = np.random.default_rng(1)
    manifold = ParameterManifold(1, 0, np.array([0.1, 20.0]))
    point = bodies.point(rng, manifold)
    free = sparse(rng, manifold, point)
    floors = np.where(np.arange(4) == 1, 2.0, 0.5) * np.sqrt(free.squares(point) / free.counts)
    profile = replace(free, floors=floors)
    objective = ProfileObjective(profile, weights(rng, manifold), np.zeros(2 * (manifold.dimension + 1,)))
    unbound, bound = replace(objective, profile=free).evaluate(point), objective.evaluate(point)
    (count, square), variance = (free.counts[1], free.squares(point)[1]), floors[1] ** 2
    change = count * np.log(count * variance) + square / variance - count - count * np.log(square)
    assert bound.value - unbound.value == pytest.approx(0.5 * change, rel=1e-9)
    for direction in np.eye(manifold.dimension):
        ahead, behind = (objective.evaluate(objective.step(point, size * direction)).value for size in (1e-5, -1e-5))
        slope, largest = (ahead - behind) / 2e-5, float(np.max(np.abs(bound.gradient)))
        assert bound.gradient @ direction == pytest.approx(slope, abs=1e-4 * largest)


@needs_compiled
@MANIFOLDS
@pytest.mark.parametrize("length", [0.01, 30.0])
def test_a_straight_step_ends_in_the_same_place(
    manifold: ParameterManifold, length: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(1)
    base = bodies.point(rng, manifold)
    step = length / np.sqrt(manifold.dimension) * rng.normal(size=manifold.dimension)
    end = manifold.straight(base, step)
    without(monkeypatch)
    expected = manifold.straight(base, step)
    largest = np.max(np.abs(expected.pseudo_inertias), axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(end.pseudo_inertias / largest, expected.pseudo_inertias / largest, rtol=0.0, atol=1e-12)


@pytest.mark.usefixtures("either")
def test_what_is_no_number_is_no_sum_of_squares() -> None:
    manifold = ParameterManifold(1, 0, np.array([1.0]))
    rng = np.random.default_rng(0)
    profile = sparse(rng, manifold, bodies.point(rng, manifold))
    nowhere = replace(bodies.point(rng, manifold), reals=np.full(1, np.nan))
    has_it = [10 in places for places in profile.products.places]
    assert any(has_it)
    assert np.isnan(profile.squares(nowhere)).tolist() == has_it


@needs_compiled
@pytest.mark.parametrize("known", [0, 3])
def test_the_minimum_of_channels_is_the_same(known: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the prior and from far away, where steps are shortened and taken back."""
    rng = np.random.default_rng(1)
    manifold = ParameterManifold(3, 0, rng.uniform(0.1, 10.0, size=4))
    profile = sparse(rng, manifold, bodies.point(rng, manifold), 3)
    rows = rng.normal(size=(known, manifold.dimension + 1))
    rows[:, :-1] = manifold.offset_rows(profile.prior, rows[:, :-1])
    objective = ProfileObjective(profile, weights(rng, manifold), rows.T @ rows)
    for start in (profile.prior, bodies.point(rng, manifold)):
        own = minimum(objective, start)
        with monkeypatch.context() as context:
            without(context)
            expected = minimum(objective, start)
            assert_same(own.evaluation, objective.evaluate(own.point))
        assert (own.reason, own.steps) == (expected.reason, expected.steps)
        np.testing.assert_allclose(own.values, expected.values, rtol=1e-6)
        np.testing.assert_allclose(own.point.parameters, expected.point.parameters, rtol=1e-4, atol=1e-6)


def test_a_minimum_is_not_looked_for_from_nowhere() -> None:
    rng = np.random.default_rng(0)
    manifold = ParameterManifold(1, 0, np.array([1.0]))
    profile = sparse(rng, manifold, bodies.point(rng, manifold))
    nowhere = replace(profile.prior, reals=np.full(1, np.nan))
    with pytest.raises(LinAlgError, match="not finite"):
        minimum(ProfileObjective(profile, weights(rng, manifold), np.zeros((12, 12))), nowhere)


# --- Products of channels in their own columns, beside the same in all columns ---

SIZE, CHANNELS = 14, 5


def channel_rows(rng: np.random.Generator) -> FloatArray:
    """Of each channel ``(C, N, size)``, with columns that it does not have, next to each other and apart."""
    every = rng.normal(size=(CHANNELS, 30, SIZE))
    for channel in range(CHANNELS):
        every[channel][:, rng.random(SIZE) < 0.4] = 0.0
        every[channel][:, 2 * channel : 2 * channel + 3] = 0.0
        every[channel][:, -1] = rng.normal(size=30)
    return every


def own_columns(every: FloatArray) -> ChannelProducts:
    places = [np.flatnonzero(np.any(each, axis=0)) for each in every]
    return ChannelProducts.of(
        SIZE, ((place, each[:, place].T @ each[:, place]) for place, each in zip(places, every, strict=True))
    )


@pytest.mark.usefixtures("either")
def test_they_are_those_of_all_columns() -> None:
    """Sums of squares, and weighted sums of products, of some columns, by the rows themselves."""
    rng = np.random.default_rng(1)
    every = channel_rows(rng)
    columns = np.flatnonzero(rng.random(SIZE - 1) < 0.7)
    whole, weights = own_columns(every), rng.uniform(0.5, 2.0, CHANNELS)
    np.testing.assert_allclose(whole.weighed(weights), np.einsum("c,cni,cnj->ij", weights, every, every), atol=1e-12)
    for products, left in ((whole, every), (whole.select(columns), every[:, :, [*columns, SIZE - 1]])):
        vector = rng.normal(size=left.shape[2])
        squares = np.sum((left @ vector) ** 2, axis=1)
        np.testing.assert_allclose(products.squares(vector), squares)
        least = np.where(np.arange(CHANNELS) == 1, 2.0 * squares, 0.0)
        found, total = products.weighed_by_squares(vector, weights, least)
        np.testing.assert_allclose(found, squares)
        expected = weights / np.maximum(squares, least)
        np.testing.assert_allclose(total, np.einsum("c,cni,cnj->ij", expected, left, left), atol=1e-12)
        np.testing.assert_allclose(products.targets, np.sum(left[:, :, -1] ** 2, axis=1))
    for channel, measured in enumerate(every):
        np.testing.assert_allclose(whole.weighed(np.arange(len(whole)) == channel), measured.T @ measured, atol=1e-12)
