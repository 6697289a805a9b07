"""Rotations, and poses ``(7,)`` of position and quaternion xyzw: logarithm, exponential, composition."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from geomid_ros.types import FloatArray


def relative_log(reference: FloatArray, poses: FloatArray) -> FloatArray:
    """Compute ``log(reference^-1 pose)`` of ``poses (N, 7)``: twists ``(N, 6)`` as (linear, angular)."""
    inverse = pin.XYZQUATToSE3(reference).inverse()
    return np.array([pin.log6(inverse * pin.XYZQUATToSE3(pose)).vector for pose in poses])


def compose_exp(reference: FloatArray, twist: FloatArray) -> FloatArray:
    """Compute the pose ``reference exp(twist)`` ``(7,)``, for a twist ``(6,)``."""
    return np.array(pin.SE3ToXYZQUAT(pin.XYZQUATToSE3(reference) * pin.exp6(twist)))


def rotations(vectors: FloatArray) -> FloatArray:
    """Return rotation matrices ``(N, 3, 3)`` of rotation vectors ``(N, 3)`` [rad]."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 of floating bases alone

    return np.asarray(Rotation.from_rotvec(vectors).as_matrix())


def rotate_inverse(quaternions: FloatArray, vector: FloatArray) -> FloatArray:
    """Rotate a ``vector (3,)`` by the inverses of quaternions ``(N, 4)``, xyzw: into the rotated axes, ``(N, 3)``."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 of floating bases alone

    return np.asarray(Rotation.from_quat(quaternions).inv().as_matrix() @ vector)


def shortest_rotation(vectors: FloatArray, onto: FloatArray) -> FloatArray:
    """Return unit quaternions ``(N, 4)``, xyzw, of the smallest rotations from unit ``vectors (N, 3)`` to the unit
    vector ``onto (3,)``; if they are opposite, about any perpendicular axis."""
    return np.array([pin.Quaternion.FromTwoVectors(vector, onto).coeffs() for vector in vectors]).reshape(-1, 4)


def quaternion(axes: FloatArray) -> FloatArray:
    """Return the quaternion xyzw ``(4,)`` of a rotation matrix ``axes (3, 3)``, with the axes as columns."""
    return np.array(pin.Quaternion(axes).coeffs())


def best_rotation(products: FloatArray) -> tuple[FloatArray, float]:
    """Rotation ``(3, 3)`` of the second vectors that makes them most like the first, from their summed products ``(3,
    3)``, and the sum of scalar products then (orthogonal Procrustes problem; Kabsch 1976)."""
    left, strengths, right = np.linalg.svd(products)
    handed = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return np.asarray(left * handed @ right), float(strengths @ handed)


def rotation_angle(rotation: FloatArray) -> float:
    """Angle of a rotation ``(3, 3)`` [rad]."""
    return float(np.arccos(np.clip(0.5 * (np.trace(rotation) - 1.0), -1.0, 1.0)))
