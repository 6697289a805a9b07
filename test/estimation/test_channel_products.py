"""Products of channels in their own columns, beside the same in all columns."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.estimation.channel_products import ChannelProducts
from geomid_ros.types import FloatArray

SIZE, CHANNELS = 14, 5


def rows(rng: np.random.Generator) -> FloatArray:
    """Of each channel ``(C, N, size)``, with columns that it does not have, next to each other and apart."""
    every = rng.normal(size=(CHANNELS, 30, SIZE))
    for channel in range(CHANNELS):
        every[channel][:, rng.random(SIZE) < 0.4] = 0.0
        every[channel][:, 2 * channel : 2 * channel + 3] = 0.0
        every[channel][:, -1] = rng.normal(size=30)
    return every


def own(every: FloatArray) -> ChannelProducts:
    places = [np.flatnonzero(np.any(each, axis=0)) for each in every]
    return ChannelProducts.of(
        SIZE, ((place, each[:, place].T @ each[:, place]) for place, each in zip(places, every, strict=True))
    )


@pytest.mark.usefixtures("either")
def test_they_are_those_of_all_columns() -> None:
    """Sums of squares, and weighted sums of products, of some columns, by the rows themselves."""
    rng = np.random.default_rng(1)
    every = rows(rng)
    columns = np.flatnonzero(rng.random(SIZE - 1) < 0.7)
    whole, weights = own(every), rng.uniform(0.5, 2.0, CHANNELS)
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


def test_a_channel_has_no_room_for_what_it_does_not_have() -> None:
    """So that a robot of many limbs takes little: blocks of the columns that are there."""
    products = own(rows(np.random.default_rng(0)))
    assert all(
        block.shape == (len(place), len(place)) for place, block in zip(products.places, products.blocks, strict=True)
    )
    assert products.packed.blocks.size == sum(len(place) ** 2 for place in products.places) < CHANNELS * SIZE**2
