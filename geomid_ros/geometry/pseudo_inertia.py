"""Linear map (3) between ten inertial parameters and the 4x4 pseudo-inertia.

Parameters are in pinocchio's order ``(m, hx, hy, hz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz)`` in kg, kg m and kg m^2, with
the first moment ``h = m c`` and the inertia about the link frame's origin, in the link frame's axes. The
pseudo-inertia is ``P = [[S, h], [h^T, m]]`` with the second moment ``S = tr(I)/2 1 - I``. A body with a non-negative
density exists exactly when P is positive semi-definite.
"""

from __future__ import annotations

import numpy as np

from geomid_ros.geometry import spd
from geomid_ros.types import FloatArray, frozen

SIZE = spd.SIZE
INERTIA_NAMES = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")
"""Names of the six entries of an inertia, in the order of the parameters."""
INERTIA_ENTRIES = (np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2]))
"""Row and column indices of these entries in the matrix."""
_STEEL = 7850.0  # [kg/m^3]
# Least ratio of a body's central second moments, because a flat body has no finite distance to others.
_FLATTEST = 1e-10


def inertia_matrix(entries: FloatArray) -> FloatArray:
    """Return symmetric matrices ``(..., 3, 3)`` of six entries ``(..., 6)`` in the order :data:`INERTIA_NAMES`."""
    rows, columns = INERTIA_ENTRIES
    matrix = np.empty((*entries.shape[:-1], 3, 3))
    matrix[..., rows, columns] = matrix[..., columns, rows] = entries
    return matrix


def inertia_entries(matrix: FloatArray) -> FloatArray:
    """Return the six entries ``(..., 6)`` of symmetric matrices ``(..., 3, 3)``: inverse of :func:`inertia_matrix`."""
    return matrix[(..., *INERTIA_ENTRIES)]


def rotational_inertia(parameters: FloatArray) -> FloatArray:
    """Inertia matrices ``(..., 3, 3)`` about the frame's origin, of parameters ``(..., 10)``."""
    return inertia_matrix(parameters[..., 4:])


def _trace_complement(matrix: FloatArray, factor: float) -> FloatArray:
    trace = np.trace(matrix, axis1=-2, axis2=-1)[..., None, None]
    return np.asarray(factor * trace * np.eye(3) - matrix)


def from_parameters(parameters: FloatArray) -> FloatArray:
    """Pseudo-inertias ``(..., 4, 4)`` of parameters ``(..., 10)``: the map f of (3)."""
    pseudo = np.empty((*parameters.shape[:-1], 4, 4))
    pseudo[..., :3, :3] = _trace_complement(rotational_inertia(parameters), 0.5)
    pseudo[..., :3, 3] = pseudo[..., 3, :3] = parameters[..., 1:4]
    pseudo[..., 3, 3] = parameters[..., 0]
    return pseudo


def to_parameters(pseudo: FloatArray) -> FloatArray:
    """Parameters ``(..., 10)`` of pseudo-inertias ``(..., 4, 4)``: the inverse of :func:`from_parameters`."""
    inertia = _trace_complement(pseudo[..., :3, :3], 1.0)
    parameters = np.empty((*pseudo.shape[:-2], SIZE))
    parameters[..., 0] = pseudo[..., 3, 3]
    parameters[..., 1:4] = pseudo[..., :3, 3]
    parameters[..., 4:] = inertia_entries(inertia)
    return parameters


# Row k is the coordinate vector of the pseudo-inertia of the k-th unit parameter vector.
_PARAMETERS_TO_COORDINATES = spd.to_vector(from_parameters(np.eye(SIZE)))
COEFFICIENTS_TO_COORDINATES = frozen(np.linalg.inv(_PARAMETERS_TO_COORDINATES).T)
"""Coordinates ``(10, 10)``, one matrix per row, of the matrices ``X_k`` with ``tr((sum a_k X_k) P) = a . parameters``
for every body and row a: (18) and (20)."""


def change_of_frame(rotation: FloatArray, translation: FloatArray) -> FloatArray:
    """Return the matrix G ``(4, 4)`` of (13), with ``P_a = G P_b G^T``; ``rotation (3, 3)`` and ``translation (3,)``
    are the pose of frame b in frame a: ``r_a = R r_b + t``."""
    factor = np.eye(4)
    factor[:3, :3], factor[:3, 3] = rotation, translation
    return factor


def parameter_transform(rotation: FloatArray, translation: FloatArray) -> FloatArray:
    """Return the matrix ``(10, 10)`` that transforms parameters from frame b to frame a; ``rotation (3, 3)`` and
    ``translation (3,)`` are the pose of b in a."""
    factor = change_of_frame(rotation, translation)
    return to_parameters(factor @ from_parameters(np.eye(SIZE)) @ factor.T).T


def moved(parameters: FloatArray, placement: FloatArray) -> FloatArray:
    """Return parameters ``(10,)`` in another frame; ``placement (4, 4)`` is the homogeneous matrix to it."""
    return to_parameters(spd.congruence(placement, from_parameters(parameters)))


def weights_of(parameters: FloatArray) -> FloatArray:
    """Return parameters ``(..., 10)`` without moments of inertia: gravity acts on masses and first moments."""
    return np.asarray(parameters * ([1.0] * 4 + [0.0] * 6))


def centre_of_mass(parameters: FloatArray) -> FloatArray:
    """Centre of mass ``(..., 3)`` in the link frame [m], of parameters ``(..., 10)``."""
    return parameters[..., 1:4] / parameters[..., :1]


def central_inertia(parameters: FloatArray) -> FloatArray:
    """Inertia ``(..., 3, 3)`` about the centre of mass in the link frame's axes [kg m^2]."""
    mass = parameters[..., :1, None]
    centre = centre_of_mass(parameters)
    outer = centre[..., :, None] * centre[..., None, :]
    return rotational_inertia(parameters) - mass * _trace_complement(outer, 1.0)


def is_body(parameters: FloatArray) -> bool:
    """True if parameters ``(10,)`` are physically consistent, and the body is not flat.

    The ratio of the central second moments is checked. Unlike ratios of the pseudo-inertia's eigenvalues, it depends
    neither on units nor on the frame.
    """
    if parameters[0] <= 0.0:
        return False
    moments = np.linalg.eigvalsh(_trace_complement(central_inertia(parameters), 0.5))
    return bool(moments[0] > _FLATTEST * abs(moments[-1]))


def nearest_body(parameters: FloatArray) -> FloatArray:
    """Return parameters ``(10,)`` of a body unchanged, or else those of one with the same mass (above zero) and centre
    of mass. Its central second moments are raised to at least those of a steel ball of this mass, because nothing in a
    robot is denser."""
    if is_body(parameters):
        return parameters
    mass = parameters[0]
    values, axes = np.linalg.eigh(_trace_complement(central_inertia(parameters), 0.5))
    least_moment = mass * least_gyration(mass) ** 2
    second_moments = (axes * np.maximum(values, least_moment)) @ axes.T
    return assemble(np.array(mass), centre_of_mass(parameters), _trace_complement(second_moments, 1.0))


def least_gyration(mass: float) -> float:
    """Radius of gyration about a central plane of a steel ball of this mass [m]."""
    return float(np.sqrt(0.2) * np.cbrt(3.0 * mass / (4.0 * np.pi * _STEEL)))


def assemble(mass: FloatArray, centre: FloatArray, central: FloatArray) -> FloatArray:
    """Parameters ``(..., 10)`` from mass ``(...)``, centre of mass ``(..., 3)`` and central inertia ``(..., 3, 3)``."""
    mass = np.asarray(mass, dtype=np.float64)[..., None]
    outer = centre[..., :, None] * centre[..., None, :]
    inertia = central + mass[..., None] * _trace_complement(outer, 1.0)
    return np.concatenate([mass, mass * centre, inertia_entries(inertia)], axis=-1)


def quantities_of(parameters: FloatArray) -> FloatArray:
    """Convert parameters ``(..., 10)`` to physical quantities ``(..., 10)``: mass [kg], centre of mass (x, y, z) [m],
    and central inertia [kg m^2] in the order :data:`INERTIA_NAMES`, in the link's axes."""
    central = inertia_entries(central_inertia(parameters))
    return np.concatenate([parameters[..., :1], centre_of_mass(parameters), central], axis=-1)


def parameters_of(quantities: FloatArray) -> FloatArray:
    """Convert physical quantities ``(..., 10)`` to parameters ``(..., 10)``: the inverse of :func:`quantities_of`."""
    return assemble(quantities[..., 0], quantities[..., 1:4], inertia_matrix(quantities[..., 4:]))


def equivalent_ellipsoid(parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the uniform solid ellipsoid of the same mass and inertia: semi-axes ``(..., 3)`` [m], and axes ``(..., 3,
    3)`` as columns in the link's frame.

    A uniform ellipsoid with semi-axes s has central second moment ``m diag(s^2)/5``.
    """
    central = central_inertia(parameters)
    covariance = _trace_complement(central, 0.5) / parameters[..., :1, None]
    values, axes = np.linalg.eigh(covariance)
    return np.sqrt(5.0 * np.clip(values, 0.0, None)), axes
