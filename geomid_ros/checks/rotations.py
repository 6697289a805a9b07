"""Rotations between two sets of vectors."""

from __future__ import annotations

import numpy as np

from geomid_ros.types import FloatArray


def best_rotation(products: FloatArray) -> tuple[FloatArray, float]:
    """Rotation ``(3, 3)`` of the second vectors that makes them most like the first, from their summed products ``(3,
    3)``, and the sum of scalar products then (orthogonal Procrustes problem; Kabsch 1976)."""
    left, strengths, right = np.linalg.svd(products)
    handed = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return np.asarray(left * handed @ right), float(strengths @ handed)


def rotation_angle(rotation: FloatArray) -> float:
    """Angle of a rotation ``(3, 3)`` [rad]."""
    return float(np.arccos(np.clip(0.5 * (np.trace(rotation) - 1.0), -1.0, 1.0)))
