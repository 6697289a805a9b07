"""A remainder that is integrated out, against the Gaussian likelihood of the rows themselves."""

import weakref

import numpy as np
import pytest
from scipy.optimize import minimize

from geomid_ros.inference.design import ChannelRows, Design, RemainderFit
from geomid_ros.inference.remainder import DEFAULT_VARIANCE, Remainder
from geomid_ros.types import FloatArray

ROWS, COLUMNS = 120, 3
BLOCK = np.repeat([0, 1, 2], [4, 6, 5])
VARIANCES = np.array([0.5, 8.0, 0.02])


BEFORE = 3.0 * np.cov(np.random.default_rng(3).standard_normal((len(BLOCK), 60)))
BEFORE[:4] = BEFORE[:, :4] = 0.0  # of the first block nothing is known
"""What other recordings left unsure of the features' coefficients."""


def rows(
    seed: int, variances: FloatArray = VARIANCES, noise: float = 0.1, before: FloatArray | None = None
) -> ChannelRows:
    """Random columns and features, and what is measured of coefficients 1, 2, 3 beside a remainder of these
    ``variances`` in units of the noise's, and of what was unsure ``before``."""
    rng = np.random.default_rng(seed)
    columns, features = rng.standard_normal((ROWS, COLUMNS)), rng.standard_normal((ROWS, len(BLOCK)))
    made = ChannelRows(np.column_stack([columns, np.zeros(ROWS)]), features, BLOCK, {}, np.arange(COLUMNS))
    drawn = made.features @ (np.sqrt(variances[BLOCK]) * rng.standard_normal(len(BLOCK)))
    if before is not None:
        values, vectors = np.linalg.eigh(before)
        drawn += features @ (vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(BLOCK))))
    target = columns @ [1.0, 2.0, 3.0] + noise * (drawn + rng.standard_normal(ROWS))
    return ChannelRows(np.column_stack([columns, target]), features, BLOCK, {}, np.arange(COLUMNS), before)


def covariance(own: ChannelRows, variances: FloatArray) -> FloatArray:
    """Of the rows, in units of the noise's variance."""
    known = 0.0 if own.prior_covariance is None else own.features @ own.prior_covariance @ own.features.T
    return np.eye(ROWS) + (own.features * variances[BLOCK]) @ own.features.T + known


def test_a_block_s_draw_of_variance_one_has_a_mean_square_of_one() -> None:
    own = rows(1)
    for block in range(3):
        squares = np.sum(own.features[:, block == BLOCK] ** 2) / ROWS
        assert squares == pytest.approx(1.0)


either = pytest.mark.parametrize("before", [None, BEFORE], ids=["nothing known", "known before"])


def test_what_is_known_is_of_the_features_as_they_were_given() -> None:
    """Coefficients of the covariance BEFORE make of the given features what ``before`` makes of the scaled ones."""
    own, given = rows(1, before=BEFORE), rows(1).features / rows(1).scale
    np.testing.assert_allclose(
        own.features @ own.prior_covariance @ own.features.T, given @ BEFORE @ given.T, atol=1e-9
    )


@either
def test_products_are_those_of_generalised_least_squares(before: FloatArray | None) -> None:
    own = rows(2, before=before)
    found = own.remainder.marginalised(own.products, VARIANCES).products[:-1, :-1]
    exact = own.columns.T @ np.linalg.solve(covariance(own, VARIANCES), own.columns)
    np.testing.assert_allclose(found, exact, rtol=1e-8, atol=1e-8)


@either
def test_whitened_rows_have_these_products(before: FloatArray | None) -> None:
    own = rows(3, before=before)
    taken, vector = np.arange(COLUMNS + 1), np.array([1.0, -2.0, 0.5, -1.0])
    columns, residual = own.whitened(vector, taken, VARIANCES)
    products = own.remainder.marginalised(own.products, VARIANCES).products[:-1, :-1]
    np.testing.assert_allclose(columns.T @ columns, products, atol=1e-8)
    np.testing.assert_allclose(residual, columns @ vector, atol=1e-10)


@either
def test_the_cost_is_the_volume_of_the_covariance_and_nothing_at_the_usual_size_but_that(
    before: FloatArray | None,
) -> None:
    own, usual = rows(4, before=before), np.full(3, DEFAULT_VARIANCE)
    for variances in (VARIANCES, usual):
        prior = (
            np.sum(np.log(variances / DEFAULT_VARIANCE) + DEFAULT_VARIANCE / variances - 1.0) if before is None else 0.0
        )
        volume = np.linalg.slogdet(covariance(own, variances))[1]
        assert own.remainder.marginalised(own.products, variances).cost == pytest.approx(volume + prior)
    assert own.remainder.default_variances.tolist() == usual.tolist()


def score(remainder: Remainder, vector: FloatArray, square: float, variances: FloatArray) -> float:
    """Minus twice the log evidence, at the noise that suits."""
    marginal = remainder.marginalised(np.zeros((len(vector), len(vector))), variances)
    left = square + float(vector @ marginal.products @ vector)
    return remainder.count * float(np.log(left)) + marginal.cost


@pytest.mark.parametrize("near", [None, np.full(3, 1e3 * DEFAULT_VARIANCE)], ids=["alone", "far"])
def test_the_variances_that_are_settled_on_are_near_the_most_likely(near: FloatArray | None) -> None:
    """MacKay's fixed point leaves no more than a unit to be gained."""
    own = rows(10 + 1)
    vector = np.append([1.0, 2.0, 3.0, -1.0], 0.0)
    square = float(vector @ own.products @ vector)
    found = own.remainder.fitted_variances(vector, square, 0.0, near)
    best = minimize(
        lambda logs: score(own.remainder, vector, square, np.exp(logs)), np.log(found), method="Nelder-Mead"
    )
    assert score(own.remainder, vector, square, found) < best.fun + 1.0


def test_what_is_lacking_is_found_and_counts_as_parameters() -> None:
    """Over recordings: large blocks are told as large, and small ones as no larger than usual."""
    vector = np.append([1.0, 2.0, 3.0, -1.0], 0.0)
    found = []
    for seed in range(30):
        own = rows(100 + seed)
        found.append(own.remainder.fitted_variances(vector, float(vector @ own.products @ vector), 0.0))
    medians = np.median(found, axis=0)
    assert medians[1] == pytest.approx(VARIANCES[1], rel=0.5)
    assert medians[2] < 1.5 * DEFAULT_VARIANCE


def test_beside_other_recordings_it_changes_as_much_as_usual_and_by_a_share_of_what_is_named() -> None:
    """However much is left: what stands there is a change that has no name yet."""
    remainder, vector = rows(6, before=BEFORE).remainder, np.append([1.0, 2.0, 3.0, -1.0], 0.0)
    for square in (0.1, 1e6):
        np.testing.assert_array_equal(remainder.fitted_variances(vector, square, 0.0), remainder.default_variances)
    larger = [remainder.fitted_variances(vector, 1.0, named) - DEFAULT_VARIANCE for named in (100.0, 400.0)]
    np.testing.assert_allclose(larger[1], 4.0 * larger[0])
    assert 0.0 < larger[0][0] < 100.0


def test_of_what_hardly_occurs_features_are_not_made_large() -> None:
    own = rows(7)
    rare = ChannelRows(own.columns, own.features * np.where(BLOCK == 1, 1e-9, 1.0), BLOCK, {}, own.links)
    assert np.max(rare.features[:, BLOCK == 1] ** 2) < 1e-6
    assert np.max(rare.scale) < 1e3


def test_beside_other_recordings_a_model_lacks_what_is_new_but_no_more_than_all() -> None:
    own, parameters = rows(6, before=BEFORE), np.array([1.0, 2.0, 3.0])

    def lack(expected: FloatArray | None) -> RemainderFit:
        again = ChannelRows(own.columns, own.features / own.scale, BLOCK, {}, own.links, BEFORE, expected)
        return Design.of([again], COLUMNS).remainders((), (), parameters)[0]

    alone = lack(None)
    assert lack(np.zeros(len(BLOCK))).power == pytest.approx(alone.power)
    assert lack(5.0 * alone.coefficients).power == pytest.approx(alone.power)  # what is new
    assert lack(-0.9 * alone.coefficients).power == pytest.approx(0.01 * alone.power)  # all


def test_products_beside_other_variances_go_with_their_design() -> None:
    """A search asks for hundreds: of those that nobody holds any more, at most the last stay with the rows."""
    design = Design.of([rows(1)], COLUMNS)
    own, other = design.cost, design.given([10.0 * each for each in design.variances])
    assert other.cost > own  # the larger the remainder, the more it costs
    products = weakref.ref(other._marginalised[0])
    assert other.given(other.variances)._marginalised[0] is other._marginalised[0]  # what is at hand is taken over
    del other
    assert design.given(design.variances).cost == own
    assert products() is None


@either
@pytest.mark.parametrize("block", range(4))
def test_features_are_the_likelier_the_more_of_the_remainder_they_are(block: int, before: FloatArray | None) -> None:
    """Whatever other recordings say, and however many features the others have. Noise is none of them."""
    own, parameters = rows(7, 40.0 * (np.arange(3) == block)), np.array([1.0, 2.0, 3.0])
    own.prior_covariance = before
    design = Design.of([own], COLUMNS)
    gains = list(design.gains_of_features((), (), parameters, 0, ["few", "many", "some"]).values())
    assert int(np.argmax(gains)) == block or block == 3
    assert (max(gains) > 0.0) == (block < 3)
