"""Whether a name predicts what it was not fitted to: blocks of time left out, to second order about the joint fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomid_ros.gap.candidates import AnyCandidate
from geomid_ros.gap.evidence.design import Design
from geomid_ros.gap.fitting.fit import JointFit
from geomid_ros.types import FloatArray

_GAIN_PER_LOSS = 3.0
"""A name generalises if blocks in which it predicts better gain so many times what the others lose."""
_NONE = np.zeros(0)


def generalises(design: Design, found: JointFit, candidate: AnyCandidate) -> bool:
    """Whether each block of time is on the whole predicted better with a candidate than without it by fits to the other
    blocks; True for a payload, without which the fit is far from quadratic."""
    if candidate.payload is not None:
        return True
    blocks = _Blocks(design, found)
    places = [found.place(term) for term in candidate.terms]
    scales = found.manifold.scales[np.array(places) - found.manifold.real.start]
    absent = -np.array([found.value(term) for term in candidate.terms]) / scales
    gains = np.array([blocks.loss(block, places, absent) - blocks.loss(block) for block in range(blocks.count)])
    return float(np.sum(gains[gains > 0.0])) > -_GAIN_PER_LOSS * float(np.sum(gains[gains < 0.0]))


class _Blocks:
    """Weighted products of every block in tangent coordinates at a fit, where the whole has no slope."""

    def __init__(self, design: Design, found: JointFit) -> None:
        weights = design.counts / found.squares
        products = np.einsum("c,cbij->bij", weights, design.gather_blocks(found.bodies, found.terms), optimize=True)
        vector = np.append(found.point.parameters, -1.0)
        moved = products @ vector
        self.count = len(products)
        self._slopes = moved[:, :-1] @ found.jacobian
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
        slope = self._slopes[block, free] - hessian[free] @ step
        step[free] = np.linalg.solve(hessian[np.ix_(free, free)], slope)
        return float(self._values[block] + 2.0 * self._slopes[block] @ step + step @ self._information[block] @ step)
