"""What other recordings said of the links, those from which a model was identified, beside the recordings at hand."""

from __future__ import annotations

import numpy as np

from geomid_ros.estimation.estimate import LinksInformation
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import FloatArray

_CERTAINTY = 4.0
"""That they are as exact as they say counts as much as so many of their rows."""


def rows(known: LinksInformation | None, dimension: int) -> FloatArray:
    """Rows for D parameters, and as the last column their residuals at the prior ``(r, D + 1)``; r is 0 without any."""
    if known is None:
        return np.zeros((0, dimension + 1))
    others = np.zeros((len(known.rows), dimension - known.rows.shape[1]))
    return np.column_stack([known.rows, others, known.residuals])


def inflation(rows: FloatArray, manifold: ParameterManifold, point: Point, prior: Point, hessian: FloatArray) -> float:
    """By how much the variances of ``rows (r, D + 1)`` are larger than they say, at least 1, as a fit with ``hessian
    (D, D)`` shows: their model had errors, too.

    MacKay's re-estimate, as of the prior's spread: mean square of the residuals, the fit's uncertainty included.
    """
    if not len(rows):
        return 1.0
    off = rows @ np.append(point.parameters - prior.parameters, 1.0)
    normals = manifold.whiten(point, rows[:, :-1])
    unsure = float(np.sum((normals @ np.linalg.inv(hessian)) * normals))
    return max(1.0, (float(off @ off) + unsure + _CERTAINTY) / (_count(rows) + _CERTAINTY))


def contradiction(rows: FloatArray, off: FloatArray) -> float:
    """The inflation, at least 1, with which the rows are as wrong as they say at parameters that are ``off (D,)`` the
    prior."""
    return max(1.0, float(np.sum((rows @ np.append(off, 1.0)) ** 2)) / max(1, _count(rows)))


def cost_of_inflation(rows: FloatArray, inflation: float) -> float:
    """Minus twice the logarithm of its probability, beside that of the rows' residuals in units of the enlarged
    standard deviations."""
    return (_count(rows) + _CERTAINTY) * float(np.log(inflation)) + _CERTAINTY * (1.0 / inflation - 1.0)


def _count(rows: FloatArray) -> int:
    """How many of the rows say something."""
    sizes = np.linalg.norm(rows[:, :-1], axis=1)
    return int(np.count_nonzero(sizes > 1e-6 * np.max(sizes, initial=0.0)))
