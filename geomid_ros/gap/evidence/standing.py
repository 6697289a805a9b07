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
        triangles: upper ones ``(m, m)``, the T of which ``T'T`` is their covariance.
    """

    joints: tuple[str, ...]
    channels: tuple[str, ...]
    basis: Basis
    means: tuple[FloatArray, ...]
    triangles: tuple[FloatArray, ...]

    def beside(self, features: Sequence[Features]) -> list[Features]:
        """Features of all channels with what is known of them: of what depends on time, and of channels that told
        nothing, nothing."""
        known = []
        for own, mean, triangle in zip(features, self.means, self.triangles, strict=True):
            if not len(mean):
                known.append(own)
                continue
            lasting = np.array([name != TIME for name in own.depends_on])[own.block]
            unsure = triangle * lasting
            known.append(replace(own, mean=lasting * mean, unsure=unsure.T @ unsure))
        return known
