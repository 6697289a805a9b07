"""Product manifold of a robot's parameters.

A point has three kinds of blocks: ``links`` pseudo-inertias in P(4), ``positives`` positive coefficients with the
metric ``dc^2/c^2`` (that is P(1)), and real lines with a given scale s and the metric ``dr^2/s^2``. Two vectors
describe it:

- *parameters* ``(D,)``: ten per link in pinocchio's order, then the positives, then the reals. Measurements are
  linear in them: a row is ``a . parameters = b``.
- *tangent coordinates* at a base point ``(D,)``: orthonormal for the metric there. A link's ten are the coordinates
  (``symmetric``) of ``P^-1/2 V P^-1/2``, a positive's is ``dc/c``, a real's is ``dr/s``.

``D = 10 links + positives + reals`` in both.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.geometry import compiled, pseudo_inertia, spd
from geomid_ros.types import FloatArray, IntArray, frozen

_STRAIGHT = 0.5  # a number or an eigenvalue that shrinks by less moves along the straight line
_SMALLEST_FACTOR = 0.05  # smallest factor by which one straight step scales a positive number or an inertia


@dataclass(frozen=True, eq=False)
class Point:
    """A point of a :class:`ParameterManifold`; its arrays are read-only.

    Attributes:
        pseudo_inertias: ``(links, 4, 4)``, SPD.
        positives: ``(m,)``, greater than zero.
        reals: ``(k,)``.
    """

    pseudo_inertias: FloatArray
    positives: FloatArray
    reals: FloatArray

    def __post_init__(self) -> None:
        for name in ("pseudo_inertias", "positives", "reals"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @cached_property
    def _decomposed(self) -> tuple[FloatArray, FloatArray]:
        return spd.spectrum(self.pseudo_inertias)

    @cached_property
    def root(self) -> FloatArray:
        """Symmetric square roots of the pseudo-inertias, ``(links, 4, 4)``."""
        values, vectors = self._decomposed
        return frozen(spd.composed(np.sqrt(values), vectors))

    @cached_property
    def inverse_root(self) -> FloatArray:
        """Inverses of the square roots, ``(links, 4, 4)``."""
        values, vectors = self._decomposed
        return frozen(spd.composed(1.0 / np.sqrt(values), vectors))

    @cached_property
    def links_jacobian(self) -> FloatArray:
        """Derivatives of each link's parameters by its tangent coordinates, ``(links, 10, 10)``."""
        return frozen(pseudo_inertia.COEFFICIENTS_TO_COORDINATES @ spd.congruence_matrix(self.root))

    @cached_property
    def to_tangent(self) -> FloatArray:
        """Matrices from the coordinates of symmetric matrices to tangent coordinates here, ``(links, 10, 10)``."""
        return frozen(spd.congruence_matrix(self.inverse_root))

    @cached_property
    def parameters(self) -> FloatArray:
        """Linear parameters ``(D,)``."""
        inertial = pseudo_inertia.to_parameters(self.pseudo_inertias).ravel()
        return frozen(np.concatenate([inertial, self.positives, self.reals]))


def _lengthened(steps: FloatArray) -> FloatArray:
    """Return ``1 + step`` where that is above one half; elsewhere, a factor that stays positive."""
    bent = np.maximum(0.5 * np.exp(2.0 * np.minimum(steps + _STRAIGHT, 0.0)), _SMALLEST_FACTOR)
    return np.where(steps > -_STRAIGHT, 1.0 + steps, bent)


@dataclass(frozen=True, eq=False)
class ParameterManifold:
    """P(4)^links x P(1)^positives x R^reals, with the scales ``(k,)`` of the real lines (greater than zero)."""

    links: int
    positives: int
    scales: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "scales", frozen(self.scales))

    @property
    def dimension(self) -> int:
        """Number D of parameters and of tangent coordinates."""
        return spd.SIZE * self.links + self.positives + len(self.scales)

    @property
    def inertial(self) -> slice:
        """Entries of the links in a vector ``(D,)``."""
        return slice(0, spd.SIZE * self.links)

    @property
    def positive(self) -> slice:
        """Entries of the positive coefficients in a vector ``(D,)``."""
        return slice(self.inertial.stop, self.inertial.stop + self.positives)

    @property
    def real(self) -> slice:
        """Entries of the real coefficients in a vector ``(D,)``."""
        return slice(self.positive.stop, self.dimension)

    def link(self, index: int) -> slice:
        """Return the entries of one link in a vector ``(D,)``."""
        return slice(spd.SIZE * index, spd.SIZE * (index + 1))

    @cached_property
    def links_blocks(self) -> tuple[IntArray, IntArray]:
        """Index of the links' blocks ``(links, 10, 10)`` on the diagonal of a matrix ``(D, D)``."""
        entries = np.arange(self.inertial.stop).reshape(self.links, spd.SIZE)
        return entries[:, :, None], entries[:, None, :]

    def point(self, parameters: FloatArray) -> Point:
        """Return the point with linear parameters ``(D,)``, which must be physically consistent (unchecked)."""
        inertial = parameters[self.inertial].reshape(self.links, spd.SIZE)
        return Point(pseudo_inertia.from_parameters(inertial), parameters[self.positive], parameters[self.real])

    def exp(self, base: Point, tangent: FloatArray) -> Point:
        """Return the end of the geodesic (7) that leaves ``base`` with tangent coordinates ``(D,)``."""
        matrices = spd.to_matrix(tangent[self.inertial].reshape(self.links, spd.SIZE))
        return Point(
            spd.congruence(base.root, spd.sym_exp(matrices)),
            base.positives * np.exp(tangent[self.positive]),
            base.reals + self.scales * tangent[self.real],
        )

    def exp_jacobian(self, base: Point, tangent: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the derivative of the parameters of ``exp(base, tangent)`` by the tangent coordinates at ``base``, in
        the blocks of :meth:`jacobian`."""
        matrices = spd.to_matrix(tangent[self.inertial].reshape(self.links, spd.SIZE))
        values, vectors = np.linalg.eigh(matrices)
        rotated = spd.congruence(np.swapaxes(vectors, -1, -2)[:, None], spd.UNITS)
        changes = spd.congruence(vectors[:, None], spd.exp_differences(values)[:, None] * rotated)
        blocks = pseudo_inertia.to_parameters(spd.congruence(base.root[:, None], changes))
        return np.swapaxes(blocks, -1, -2), np.append(base.positives * np.exp(tangent[self.positive]), self.scales)

    def straight(self, base: Point, tangent: FloatArray) -> Point:
        """Return the end of a straight line of parameters that leaves ``base`` with tangent coordinates ``(D,)``.

        Precise data confine the parameters to a thin slab between hyperplanes, which a geodesic soon leaves. Near the
        boundary of the cone, an eigenvalue shrinks by a positive factor instead.
        """
        return Point(
            self._straight_links(base, tangent[self.inertial].reshape(self.links, spd.SIZE)),
            base.positives * _lengthened(tangent[self.positive]),
            base.reals + self.scales * tangent[self.real],
        )

    def _straight_links(self, base: Point, steps: FloatArray) -> FloatArray:
        """Return pseudo-inertias ``(links, 4, 4)`` at the ends of straight lines with the tangents ``(links, 10)``."""
        if compiled.native is not None:
            ends = np.empty(base.pseudo_inertias.shape)
            compiled.native.straight_lines(base.pseudo_inertias, steps, ends)
            return ends
        matrices = spd.to_matrix(steps)
        whitened = np.eye(4) + matrices
        long = np.flatnonzero(np.sum(steps**2, axis=1) > _STRAIGHT**2)  # all other eigenvalues are above -_STRAIGHT
        if len(long):
            values, vectors = np.linalg.eigh(matrices[long])
            whitened[long] = spd.composed(_lengthened(values), vectors)
        return spd.congruence(base.root, whitened)

    def log(self, base: Point, point: Point) -> FloatArray:
        """Return tangent coordinates ``(D,)`` at ``base`` of the geodesic to ``point`` (8)."""
        return self._logarithm(base, point)[0]

    def _logarithm(self, base: Point, point: Point) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return :meth:`log`, and the eigenvalues ``(links, 4)`` and eigenvectors of the links' logarithms."""
        ratios, vectors = spd.spectrum(spd.congruence(base.inverse_root, point.pseudo_inertias))
        values = np.log(ratios)
        links = spd.to_vector(spd.composed(values, vectors)).ravel()
        positive, real = np.log(point.positives / base.positives), (point.reals - base.reals) / self.scales
        return np.concatenate([links, positive, real]), values, vectors

    def distance(self, a: Point, b: Point) -> float:
        """Compute the geodesic distance: the root of the sum of the blocks' squared distances (9)."""
        return float(np.linalg.norm(self.log(a, b)))

    def log_and_hessian(self, base: Point, point: Point) -> tuple[FloatArray, FloatArray]:
        """Return :meth:`log`, and the links' blocks ``(links, 10, 10)`` of the Hessian of ``d(base, point)^2/2`` by the
        tangent coordinates at ``base``; its other entries are those of the identity."""
        tangent, *decomposed = self._logarithm(base, point)
        return tangent, spd.half_squared_distance_hessian(*decomposed)

    def add_blocks(self, matrix: FloatArray, blocks: FloatArray, diagonal: FloatArray) -> None:
        """Add the links' ``blocks (links, 10, 10)``, and the ``diagonal (positives + reals,)`` for the coefficients, to
        a ``matrix (D, D)``."""
        matrix[self.links_blocks] += blocks
        rest = np.arange(self.inertial.stop, self.dimension)
        matrix[rest, rest] += diagonal

    def jacobian(self, base: Point) -> tuple[FloatArray, FloatArray]:
        """Return the derivative J of the parameters by the tangent coordinates at ``base``, in blocks.

        A row ``a`` has the coordinates ``a J``: those of ``X-bar = P^1/2 X P^1/2`` of Proposition 2.

        Returns:
            Blocks of the links ``(links, 10, 10)``, and the diagonal for the coefficients ``(positives + reals,)``.
        """
        return base.links_jacobian, np.concatenate([base.positives, self.scales])

    def whiten(self, base: Point, rows: FloatArray) -> FloatArray:
        """Return coordinates ``(N, D)`` of rows ``(N, D)`` at ``base``; their norm is the rows' dual norm there."""
        return self.by_blocks(rows, *self.jacobian(base))

    def offset(self, base: Point, point: Point) -> FloatArray:
        """Return the offset ``(D,)`` of ``point`` from ``base``: links' tangent coordinates along the straight line,
        and the differences of the coefficients.

        In these coordinates a link's errors have one size in all directions, however thin the link is. In parameters
        they do not: products of rows square the ratio of their sizes, and rounding loses the smallest.
        """
        links = spd.congruence(base.inverse_root, point.pseudo_inertias) - np.eye(4)
        return np.concatenate(
            [spd.to_vector(links).ravel(), point.positives - base.positives, point.reals - base.reals]
        )

    def offset_rows(self, base: Point, rows: FloatArray) -> FloatArray:
        """Convert rows ``(N, D)`` of the parameters to rows of :meth:`offset`."""
        return self.by_blocks(rows, base.links_jacobian, np.ones(self.dimension - self.inertial.stop))

    def whiten_offset_rows(self, base: Point, point: Point, rows: FloatArray) -> FloatArray:
        """Apply :meth:`whiten` at ``point`` to rows of :meth:`offset`."""
        return self.by_blocks(rows, base.to_tangent @ spd.congruence_matrix(point.root), self.jacobian(point)[1])

    def by_blocks(self, rows: FloatArray, blocks: FloatArray, diagonal: FloatArray) -> FloatArray:
        """Multiply rows ``(N, D)`` by a matrix in the blocks of :meth:`jacobian`."""
        whitened = np.empty(rows.shape)
        by_link = (rows[:, self.inertial], whitened[:, self.inertial])
        before, after = (part.reshape(len(rows), self.links, spd.SIZE).swapaxes(0, 1) for part in by_link)
        np.matmul(before, blocks, out=after)
        start = self.inertial.stop
        whitened[:, start:] = rows[:, start:] * diagonal
        return whitened


ONE_BODY = ParameterManifold(1, 0, np.zeros(0))
"""Physically consistent inertias of one body."""
