"""True inertias: the URDF's, moved at random within the bodies that can exist, and as MuJoCo takes them."""

from __future__ import annotations

from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.simulation.description import LinkInertia
from geomid_ros.types import FloatArray, frozen


def perturbed(nominal: LinkInertia, size: float, rng: np.random.Generator) -> LinkInertia:
    """A random body near ``nominal``, by congruence of its 4x4 pseudo-inertia: ``L exp(E) L^T`` where ``P = L L^T``.

    ``E`` is symmetric with Gaussian entries of standard deviation ``size`` (``size / sqrt 2`` off the diagonal). Its
    distribution does not change under rotations, so neither the choice of L nor the link's frame matters. The result
    is symmetric positive definite for every E, and its geodesic distance to the nominal body is E's Frobenius norm.
    """
    root = np.linalg.cholesky(pseudo_inertia(nominal))
    draw = size * rng.standard_normal((4, 4))
    values, vectors = np.linalg.eigh(0.5 * (draw + draw.T))
    return body_of(nominal.name, root @ (vectors * np.exp(values)) @ vectors.T @ root.T)


def pseudo_inertia(body: LinkInertia) -> FloatArray:
    """``P (4, 4) = [[S, h], [h^T, m]]`` in the link frame, with the second moment S [kg m^2] and h = m com [kg m]."""
    pseudo = np.empty((4, 4))
    pseudo[:3, :3] = _swap_moments(body.inertia, 0.5) + body.mass * np.outer(body.com, body.com)
    pseudo[:3, 3] = pseudo[3, :3] = body.mass * body.com
    pseudo[3, 3] = body.mass
    if np.linalg.eigvalsh(pseudo)[0] <= 0.0:
        raise InputError(f"link '{body.name}' has an inertia that no body can have; correct it in the URDF.")
    return pseudo


def body_of(name: str, pseudo: FloatArray) -> LinkInertia:
    """The body that has a pseudo-inertia ``(4, 4)``."""
    mass = float(pseudo[3, 3])
    com = pseudo[:3, 3] / mass
    inertia = _swap_moments(pseudo[:3, :3] - mass * np.outer(com, com), 1.0)
    return LinkInertia(name, mass, frozen(com), frozen(0.5 * (inertia + inertia.T)))


def _swap_moments(matrix: FloatArray, share: float) -> FloatArray:
    """Second moment from rotational inertia (``share`` 1/2) and back (``share`` 1)."""
    return np.asarray(share * np.trace(matrix) * np.eye(3) - matrix)


def set_inertia(mujoco: Any, element: Any, body: LinkInertia) -> None:
    """Give a body of an MjSpec the inertia of ``body``, in the frame of that body."""
    moments, axes = np.linalg.eigh(body.inertia)
    axes[:, 2] *= np.linalg.det(axes)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    element.mass = body.mass
    element.ipos = body.com
    element.iquat = quaternion
    element.inertia = moments
    element.explicitinertial = True
