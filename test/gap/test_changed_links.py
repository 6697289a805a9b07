"""When a link has changed for sure."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geomid_ros.gap.judgement import changed_links
from geomid_ros.gap.judgement.confidence import CONFIDENT_BESIDE_UNEXPLAINED, CONFIDENT_LOSS

MASSES = np.array([3.0, 2.0])
MUCH = np.sqrt(2.0 * CONFIDENT_LOSS)  # times its standard deviation, so that the change counts as much as a loss must


def is_sure(
    times: float = 1.01 * MUCH,
    loss: float = 1.01 * CONFIDENT_BESIDE_UNEXPLAINED,
    *,
    left: bool = True,
    mass: float = 2.5,
    contested: bool = False,
    changed_link: int | None = 1,
) -> bool:
    """Of the second link."""
    analysis: Any = SimpleNamespace(
        search=SimpleNamespace(
            prior=SimpleNamespace(inertias=np.outer(MASSES, np.ones(10)).ravel(), changed_link=changed_link)
        ),
        names=SimpleNamespace(inertias=np.outer([MASSES[0], mass], np.ones(10))),
        contested=contested,
    )
    return changed_links._is_sure(analysis, 1, np.array([0.1, -times]), loss, left)


def test_a_large_change_without_which_the_fit_is_much_worse_is_sure() -> None:
    assert is_sure()
    assert not is_sure(times=0.99 * MUCH)


def test_beside_what_has_no_name_it_must_be_missed_more() -> None:
    less = 0.99 * CONFIDENT_BESIDE_UNEXPLAINED
    assert not is_sure(loss=less)
    assert is_sure(loss=less, left=False)


def test_a_link_in_whose_place_another_may_have_changed_is_not_sure() -> None:
    assert not is_sure(contested=True)
    assert is_sure(contested=True, changed_link=0)


@pytest.mark.parametrize(("mass", "expected"), [(4.99, True), (5.01, False)])
def test_no_link_outweighs_the_robot(mass: float, expected: bool) -> None:
    assert is_sure(mass=mass) is expected
