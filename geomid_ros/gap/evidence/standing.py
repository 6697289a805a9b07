"""What a model lacks on the recordings that it was identified from, and will lack on others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.gap.evidence.features import TIME, Basis, Features
from geomid_ros.types import FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class StandingRemainder:
    """The remainder of a model, whose features' coefficients are Gaussian.

    Attributes:
        joints, channels: their names, in the order of the model.
        basis: of the features.
        means: of the coefficients of each channel ``(m,)`` [N m, N]; of one that told nothing ``(0,)``.
        roots: lower triangular roots of their covariances ``(m, m)``.
    """

    joints: tuple[str, ...]
    channels: tuple[str, ...]
    basis: Basis
    means: tuple[FloatArray, ...]
    roots: tuple[FloatArray, ...]

    def beside(self, features: Sequence[Features]) -> list[Features]:
        """Features of all channels with what is known of them: of what depends on time, and of channels that told
        nothing, nothing."""
        known = []
        for own, mean, root in zip(features, self.means, self.roots, strict=True):
            if not len(mean):
                known.append(own)
                continue
            lasting = np.array([name != TIME for name in own.depends_on])[own.block]
            lasting_root = lasting[:, None] * root
            known.append(replace(own, mean=lasting * mean, unsure=lasting_root @ lasting_root.T))
        return known


def root_of(covariance: FloatArray) -> FloatArray:
    """A lower triangular L ``(m, m)`` with ``L L^T = covariance``, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(np.linalg.qr(root.T)[1].T)
