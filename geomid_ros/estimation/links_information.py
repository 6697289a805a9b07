"""What the rows of an estimate say of the inertias of all links together, whatever the effects are."""

from __future__ import annotations

import numpy as np

from geomid_ros.estimation.estimate import FINEST, LinksInformation
from geomid_ros.estimation.summary import triangular
from geomid_ros.estimation.uncertainty import Uncertainty
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.model.known import KnownRows
from geomid_ros.types import FloatArray, frozen


def links_information(
    manifold: ParameterManifold,
    prior: Point,
    point: Point,
    measured: tuple[FloatArray, FloatArray],
    known: KnownRows,
    sure: Uncertainty,
) -> LinksInformation:
    """Of ``measured`` rows ``(N, D)`` and targets ``(N,)`` of standard deviation 1, and of what is ``known``.

    The effects are eliminated, within their prior, by a QR decomposition in which their columns come first. Data
    without any noise count as if they had a little.
    """
    size, first = manifold.dimension, manifold.inertial.stop
    _, diagonal = manifold.jacobian(point)
    of_effects = np.zeros((size - first, size + 1))
    of_effects[:, first:size] = np.diag(1.0 / (diagonal * sure.prior_spreads[first:]))
    of_effects[:, size] = -manifold.log(point, prior)[first:] / sure.prior_spreads[first:]
    of_data = [
        factor * np.column_stack([rows, rows @ point.parameters - targets])
        for factor, rows, targets in ((np.sqrt(sure.share), *measured), (1.0, known.rows, known.targets))
    ]
    stacked = np.concatenate([*of_data, of_effects, np.zeros((first, size + 1))])
    order = [*range(first, size), *range(first), size]
    left = triangular(stacked[:, order])[size - first : size, size - first :]
    whitened = manifold.whiten(point, np.column_stack([left[:, :-1], np.zeros((first, size - first))]))
    left = left / max(1.0, float(np.max(np.abs(whitened), initial=0.0)) / FINEST)
    return LinksInformation(frozen(left[:, :-1]), frozen(left[:, -1]))
