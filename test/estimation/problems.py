"""Identification problems with a planted truth, from the integrals of (3) and (25), without the code under test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from geometry import bodies

from geomid_ros.estimation.objective import GeodesicObjective, ResidualObjective
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import FloatArray

LINKS = ParameterManifold(2, 0, np.zeros(0))
ALL = ParameterManifold(2, 2, np.array([0.1, 20.0]))
GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass(frozen=True, eq=False)
class Problem:
    """Rows ``(N, D)``, targets and standard deviations ``(N,)`` of a truth near a prior."""

    manifold: ParameterManifold
    prior: Point
    truth: Point
    rows: FloatArray
    targets: FloatArray
    sigmas: FloatArray

    def geodesic(self, gamma: float) -> GeodesicObjective:
        """(19)."""
        return GeodesicObjective(self.manifold, self.rows, self.targets, self.sigmas, self.prior, gamma)

    def residual(self, gamma: float) -> ResidualObjective:
        """That of Remark 3."""
        rows, targets = self.rows / self.sigmas[:, None], self.targets / self.sigmas
        return ResidualObjective.of(self.manifold, rows, targets, self.prior, gamma)

    @property
    def prior_table(self) -> FloatArray:
        """The prior's links as :func:`solve_rows` takes them, ``(links, 10)``."""
        return self.prior.parameters[self.manifold.inertial].reshape(-1, 10)


def problem(
    seed: int, manifold: ParameterManifold, count: int = 60, noise: float = 0.02, distance: float = 0.6
) -> Problem:
    """Rows to which every block contributes alike; ``noise`` in units of the rows' dual norms, which differ."""
    rng = np.random.default_rng(seed)
    prior = bodies.point(rng, manifold)
    truth = bodies.near(rng, manifold, prior, distance)
    rows = bodies.rows(rng, manifold, prior, count)
    sigmas = np.linalg.norm(manifold.whiten(prior, rows), axis=1) * max(noise, 1e-3) * rng.uniform(0.5, 2.0, count)
    targets = rows @ truth.parameters + (sigmas * rng.normal(size=count) if noise else 0.0)
    return Problem(manifold, prior, truth, rows, targets, sigmas)


def human_like(seed: int, links: int = 4, instants: int = 60, noise: float = 0.05, model_error: float = 0.1) -> Problem:
    """The moments Mx, My and the force Fz under the feet of a standing chain of bodies that move a little, (27).

    With the pose ``[R p]`` and its second derivative ``[R'' a - g]`` of a body's frame, the moment about the origin is
    made of the entries of ``[R p] P [R'' a - g]^T`` and the force is ``[R'' a - g] P (0, 0, 0, 1)``.
    ``model_error``: of the regressor, relative, which no noise model covers.
    """
    rng = np.random.default_rng(seed)
    manifold = ParameterManifold(links, 0, np.zeros(0))
    prior = bodies.point(rng, manifold)
    truth = bodies.near(rng, manifold, prior, 0.4 * np.sqrt(links))
    rows = np.array([_stance(rng, links, height=np.linspace(0.2, 1.5, links)) for _ in range(instants)])
    rows = rows.reshape(3 * instants, 10 * links)
    spread = np.std((rows @ prior.parameters).reshape(-1, 3), axis=0)
    sigmas = np.tile(noise * spread, instants)
    measured = rows * (1.0 + model_error * rng.normal(size=rows.shape))
    targets = rows @ truth.parameters + sigmas * rng.normal(size=len(rows))
    return Problem(manifold, prior, truth, measured, targets, sigmas)


def _stance(rng: np.random.Generator, links: int, height: FloatArray) -> FloatArray:
    """Rows ``(3, links, 10)`` of Mx, My, Fz at one instant."""
    rows = np.empty((3, links, 10))
    for link in range(links):
        rotation = bodies.rotation(rng)
        speed, turn = _cross(rng.normal(size=3)), _cross(rng.normal(size=3) * 3.0)
        place = np.column_stack([rotation, np.append(0.2 * rng.normal(size=2), height[link])])
        change = np.column_stack([(turn + speed @ speed) @ rotation, rng.normal(size=3) - GRAVITY])
        for k, unit in enumerate(np.eye(10)):
            pseudo = _pseudo(unit)
            moment = place @ pseudo @ change.T
            rows[:, link, k] = moment[1, 2] - moment[2, 1], moment[2, 0] - moment[0, 2], (change @ pseudo)[2, 3]
    return rows


def _cross(v: FloatArray) -> FloatArray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _pseudo(parameters: FloatArray) -> FloatArray:
    """(3) written out."""
    mass, hx, hy, hz, xx, xy, yy, xz, yz, zz = parameters
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    pseudo = np.zeros((4, 4))
    pseudo[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    pseudo[:3, 3] = pseudo[3, :3] = hx, hy, hz
    pseudo[3, 3] = mass
    return pseudo
