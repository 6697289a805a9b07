"""What a user may decide about the gap workflow."""

from __future__ import annotations

from dataclasses import dataclass

CUTOFF = 8.0
"""Low-pass of the samples that the workflow is given [Hz], where the recording's rate allows it."""


@dataclass(frozen=True)
class GapSettings:
    """``cutoff`` [Hz] of the pipeline that made the samples; ``spread``: usual size of the errors of link inertias, a
    geodesic distance (about the relative standard deviation of a mass); ``identified_spread``: of those of a model that
    was identified before, where nobody guesses."""

    cutoff: float = CUTOFF
    spread: float = 0.2
    identified_spread: float = 0.05
