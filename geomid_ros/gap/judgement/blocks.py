"""Blocks of time: whether each is predicted by fits to the others, and how far what they say scatters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geomid_ros.gap.candidates import AnyCandidate
from geomid_ros.gap.evidence.design import Design
from geomid_ros.gap.fitting.fit import JointFit
from geomid_ros.gap.fitting.prior import Prior
from geomid_ros.types import FloatArray

_GAIN_PER_LOSS = 3.0
"""A name generalises if blocks in which it predicts better gain so many times what the others lose."""
_NONE = np.zeros(0)


def generalises(design: Design, found: JointFit, candidate: AnyCandidate, prior: Prior) -> bool:
    """Whether each block of time is on the whole predicted better with a candidate than without it by fits to the other
    blocks; True for a payload, without which the fit is far from quadratic."""
    if candidate.payload is not None:
        return True
    blocks = _Blocks(design, found)
    places = [found.place(term) for term in candidate.terms]
    scales = found.manifold.scales[np.array(places) - found.manifold.real.start]
    absent = np.array([prior.value(term) - found.value(term) for term in candidate.terms]) / scales
    gains = np.array([blocks.loss(block, places, absent) - blocks.loss(block) for block in range(blocks.count)])
    return float(np.sum(gains[gains > 0.0])) > -_GAIN_PER_LOSS * float(np.sum(gains[gains < 0.0]))


def scattered(design: Design, found: JointFit) -> JointFit:
    """A fit with standard deviations at least as large as the scatter of the blocks of time says.

    Where the model has errors, what it says of one block differs from what it says of the next by more than noise
    explains. The covariance of the tangent coordinates is then ``H^-1 sum_b(s_b s_b^T) H^-1`` with the slopes s_b of
    the blocks about their mean (Liang and Zeger, "Longitudinal data analysis using generalized linear models", 1986).
    """
    blocks = _Blocks(design, found)
    moved = (blocks.slopes - np.mean(blocks.slopes, axis=0)) @ found.inverse
    squares = blocks.count / (blocks.count - 1.0) * np.sum(moved**2, axis=0)
    factors = np.sqrt(np.maximum(squares / np.diag(found.inverse), 1.0))
    return replace(found, information=found.information / np.outer(factors, factors))


class _Blocks:
    """Weighted products of every block in tangent coordinates at a fit, where the whole has no slope."""

    def __init__(self, design: Design, found: JointFit) -> None:
        weights = design.counts / found.squares
        products = np.einsum("c,cbij->bij", weights, design.gather_blocks(found.bodies, found.terms), optimize=True)
        vector = np.append(found.point.parameters, -1.0)
        moved = products @ vector
        self.count = len(products)
        self.slopes = moved[:, :-1] @ found.jacobian
        self._information = np.einsum(
            "ki,bkl,lj->bij", found.jacobian, products[:, :-1, :-1], found.jacobian, optimize=True
        )
        self._values = moved @ vector
        self._whole = found.information

    def loss(self, block: int, places: Sequence[int] = (), values: FloatArray = _NONE) -> float:
        """Weighted sum of squares of a block under the fit to the others, with the tangent coordinates at ``places``
        held at ``values``."""
        hessian = self._whole - self._information[block]
        held = np.isin(np.arange(len(hessian)), places)
        free = np.flatnonzero(~held)
        step = np.zeros(len(hessian))
        step[list(places)] = values
        slope = self.slopes[block, free] - hessian[free] @ step
        step[free] = np.linalg.solve(hessian[np.ix_(free, free)], slope)
        return float(self._values[block] + 2.0 * self.slopes[block] @ step + step @ self._information[block] @ step)
