"""What one candidate more would bring, without a fit: Rao's score test."""

from __future__ import annotations

import numpy as np

from geomid_ros.gap.candidates import AnyCandidate
from geomid_ros.gap.evidence.design import Design
from geomid_ros.gap.fitting.fit import JointFit


def improvement(design: Design, current: JointFit, candidate: AnyCandidate) -> tuple[float, float]:
    """The score test: by how much a candidate would improve the current fit, to second order, less its penalty; and its
    separability, the share of its columns that the other parameters, within their prior, cannot imitate.

    For fixed weights the step and the gain are those of the Gaussian model (Rao's score test); the gain is then taken
    from the sums of squares that the step leads to.
    """
    counts = design.counts
    weights = counts / current.squares
    vector = np.append(current.point.parameters, -1.0)
    reached = design.reached(candidate)
    if not reached:
        return -np.inf, 0.0
    cross, own = design.cross(current.bodies, current.terms, candidate)
    jacobian = current.jacobian
    slope = weights[reached] @ (cross @ vector)
    mixed = np.tensordot(weights[reached], cross[:, :, :-1], axes=1) @ jacobian
    squared = np.tensordot(weights[reached], own, axes=1)
    solved = current.inverse @ mixed.T
    left = squared - mixed @ solved
    size = np.sqrt(np.maximum(np.diag(squared), 1e-300))
    values, vectors = np.linalg.eigh(left / np.outer(size, size))
    good = values > 1e-7
    if not np.any(good):
        return -np.inf, 0.0
    step = -(vectors[:, good] @ ((vectors[:, good].T @ (slope / size)) / values[good])) / size
    before = [current.value(term) if term in current.terms else 0.0 for term in candidate.terms[: candidate.positives]]
    if np.any(before + step[: candidate.positives] < 0.0):
        return -np.inf, float(np.max(values))
    tangent = -solved @ step
    longer = np.append(jacobian @ tangent, 0.0)
    moved = current.products @ longer
    squares = current.squares + 2.0 * moved @ vector + moved @ longer
    squares[reached] += 2.0 * (cross @ (vector + longer)) @ step + np.einsum("ckl,k,l->c", own, step, step)
    gain = float(counts @ np.log(current.squares / np.maximum(squares, 1e-3 * current.squares)))
    # At the minimum the prior's slope is the opposite of the data's.
    gain += 2.0 * float(weights @ (moved @ vector))
    gain -= float(tangent @ (current.information @ tangent)) - float(weights @ (moved @ longer))
    energy = float(step @ squared @ step)
    separability = float(step @ left @ step) / energy if energy > 0.0 else 0.0
    return gain - candidate.penalty * float(np.log(np.max(counts))), separability
