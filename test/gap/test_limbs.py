"""Score tests of one limb are those beside all parameters, where limbs have no channel in common."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.inference import selection
from geomid_ros.inference.design import ChannelRows, Design
from geomid_ros.inference.fit import JointFit, fit
from geomid_ros.inference.prior import Prior
from geomid_ros.types import IntArray

from .small import LINK, ROWS, at

NAMES = tuple(at(effect, joint) for effect in ("viscous_friction", "coulomb_friction", "spring") for joint in (0, 1))
PRIOR = Prior(
    inertias=np.tile(LINK, 2), prior_std=0.2, terms=(), values=np.zeros(0), prior_stds=np.zeros(0), certainty=4.0
)


def channel(rng: np.random.Generator, link: int) -> ChannelRows:
    """Rows of a joint that carries one link alone, with viscous friction."""
    terms = [term for name in NAMES if name.terms[0].joints == (link,) for term in name.terms]
    columns = rng.normal(size=(ROWS, 11 + len(terms)))
    columns[:, -1] += columns[:, :10] @ LINK + 0.3 * columns[:, 10]
    places, links = {term: 10 + place for place, term in enumerate(terms)}, np.full(20, -1)
    links[10 * link : 10 * link + 10] = np.arange(10)
    return ChannelRows(columns, np.zeros((ROWS, 0)), np.zeros(0, dtype=np.intp), places, links)


def whole(current: JointFit) -> IntArray:
    """All parameters are one limb's."""
    return np.zeros(len(current.information), dtype=np.int64)


def test_a_limb_s_score_tests_are_those_beside_all_parameters(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    design = Design.of([channel(rng, 0), channel(rng, 1)], 20)
    current = fit(design, PRIOR, [NAMES[0]])
    assert np.unique(selection._limbs(current)).tolist() == [0, 10]
    limbs = selection.score_tests(design, current, NAMES[1:])
    monkeypatch.setattr(selection, "_limbs", whole)
    for own, dense in zip(limbs, selection.score_tests(design, current, NAMES[1:]), strict=True):
        assert own.candidate is dense.candidate
        assert own.gain == pytest.approx(dense.gain, rel=1e-8)
        assert own.separability == pytest.approx(dense.separability, rel=1e-8)
