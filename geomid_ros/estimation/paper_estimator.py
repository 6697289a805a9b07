"""The paper's estimator for raw rows, without robot or ROS: ``A Phi = b`` with a prior, nothing else."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.estimation.channel_products import triangular
from geomid_ros.estimation.objective import GeodesicObjective, ResidualObjective
from geomid_ros.estimation.solvers import SOLVERS, Solution, trust_region
from geomid_ros.estimation.tolerances import LEAST_GRADIENT, ROUNDING_OF_PRODUCTS
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.types import BoolArray, FloatArray, frozen

PAPER = 1e-2
"""The paper's weight of the prior, as a fraction of the rows'."""
OBJECTIVES = ("residual", "geodesic")
"""Valid objectives: Remark 3, or (19)."""
_GRID = 10.0 ** -np.arange(1.0, 7.0)
_BLOCKS = 3
_START_TOLERANCE = 1e-4
_RADIUS = 10.0  # geodesic distance: straight steps never leave the cone


@dataclass(frozen=True, eq=False)
class RowsSolution:
    """Result of :func:`solve_rows`.

    Attributes:
        parameters: ``(links, 10)``.
        gamma: Weight of the prior as a fraction of the sum of the rows' weights.
        set_aside: True for rows, the given ones ``(N,)`` or the principal ones, that are not used, because they have no
            projection from the prior.
        solution: The end of the solve.
    """

    parameters: FloatArray
    gamma: float
    set_aside: BoolArray
    solution: Solution


def solve_rows(
    rows: FloatArray,
    targets: FloatArray,
    sigmas: FloatArray,
    prior: FloatArray,
    gamma: float | None = None,
    solver: str = "trust_region",
    max_steps: int = 20000,
    tolerance: float = 1e-8,
    objective: str = "geodesic",
    *,
    exact: bool = False,
) -> RowsSolution:
    """Minimise (19), or the objective of Remark 3, for ``rows . parameters = targets``.

    If there are more rows than parameters, (19) is minimised for their :func:`principal_rows` unless ``exact``: nearly
    the same result in a fraction of the time.

    Parameters are in pinocchio's order (m, hx, hy, hz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) about each link frame's origin, in
    SI units.

    Args:
        rows: ``(N, 10 links)``.
        targets: ``(N,)``.
        sigmas: Standard deviations of the targets, ``(N,)`` or one number for all.
        prior: Parameters ``(links, 10)`` of physically consistent bodies.
        gamma: Weight of the prior as a fraction of the sum of the rows' weights; None to choose it by cross-validation,
            see :func:`choose_gamma`.
        solver: Solver of (19). ``trust_region``, which starts from the minimiser of Remark 3 where that is lower, or
            ``cyclic``, the paper's alternation.
        max_steps: Largest number of solver steps.
        tolerance: Largest geodesic distance of the result from the minimum.
        objective: ``geodesic`` for (19), ``residual`` for Remark 3.
        exact: True to minimise (19) for the given rows, however many.

    Raises:
        InputError: Shapes do not fit, numbers are not finite, the prior is not physically consistent, or there is no
            such objective or solver.

    >>> found = solve_rows(np.eye(1, 10), np.array([2.5]), 0.1, [[2, 0, 0, 0, 1, 0, 1, 0, 0, 1]])
    >>> bool(2.4 < found.parameters[0, 0] < 2.5)  # a mass of 2 kg was expected, 2.5 kg measured
    True
    """
    rows, targets = np.asarray(rows, dtype=np.float64), np.asarray(targets, dtype=np.float64)
    prior = np.atleast_2d(np.asarray(prior, dtype=np.float64))
    sigmas = np.asarray(sigmas, dtype=np.float64)
    _check(rows, targets, sigmas, prior)
    if gamma is not None and not 0.0 < gamma < np.inf:
        raise InputError(f"gamma is {gamma:g}, expected a number greater than zero")
    rows, targets = rows / np.expand_dims(np.broadcast_to(sigmas, targets.shape), 1), targets / sigmas
    for kind, name, valid in (("objective", objective, OBJECTIVES), ("solver", solver, SOLVERS)):
        if name not in valid:
            raise unknown_name(kind, name, valid)
    manifold = ParameterManifold(len(prior), 0, np.zeros(0))
    start = manifold.point(prior.ravel())
    if gamma is None:
        gamma = choose_gamma(manifold, rows, targets, start, objective, exact=exact)
    # The prior bounds the curvature from below, so that this gradient keeps the result within the tolerance.
    gradient = max(tolerance * gamma / (1.0 + gamma), LEAST_GRADIENT)
    set_aside = np.zeros(len(rows), dtype=bool)
    if objective == "residual":
        residual = ResidualObjective.of(manifold, rows, targets, start, gamma)
        solution = trust_region(residual, start, gradient, max_steps, radius=_RADIUS)
    else:
        if not exact and len(rows) > manifold.dimension:
            rows, targets = principal_rows(manifold, start, np.column_stack([rows, targets]))
        geodesic = GeodesicObjective(manifold, rows, targets, np.ones(len(rows)), start, gamma)
        set_aside = geodesic.set_aside
        solve = _from_remark_3 if solver == "trust_region" else SOLVERS[solver]
        solution = solve(geodesic, start, gradient, max_steps)
    parameters = frozen(pseudo_inertia.to_parameters(solution.point.pseudo_inertias))
    return RowsSolution(parameters, gamma, set_aside, solution)


def principal_rows(manifold: ParameterManifold, prior: Point, augmented: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compress ``augmented (N, D + 1)`` rows and targets of standard deviation 1 to at most D rows ``(n, D)`` and
    targets ``(n,)`` with the same least-squares content.

    In tangent coordinates at the prior they are orthogonal: eigenvectors of the information. So they depend neither on
    the order of the rows nor on frames and units (Proposition 1), and their weights (Remark 2) have the same sum. Rows
    as short as the rounding of the products are left out.
    """
    products = augmented.T @ augmented
    jacobian = manifold.whiten(prior, np.eye(manifold.dimension))
    values, vectors = np.linalg.eigh(jacobian.T @ products[:-1, :-1] @ jacobian)
    kept = values > ROUNDING_OF_PRODUCTS * values[-1]
    principal = (jacobian @ vectors[:, kept] / np.sqrt(values[kept])).T @ products[:-1]
    return principal[:, :-1], principal[:, -1]


def choose_gamma(
    manifold: ParameterManifold,
    rows: FloatArray,
    targets: FloatArray,
    prior: Point,
    objective: str,
    *,
    exact: bool = False,
) -> float:
    """Choose the weight of the prior that best predicts held-out rows.

    The weights of a grid are tried from strong to weak, until two in succession predict worse than the best so far:
    weak ones take longest. With fewer rows than parameters the paper's weight is used.

    Args:
        manifold: Manifold of the parameters.
        rows, targets: ``(N, D)`` and ``(N,)``, of standard deviation 1.
        prior: The point that distances are measured from.
        objective, exact: See :func:`solve_rows`.
    """
    if len(targets) < manifold.dimension:
        return PAPER
    losses: list[float] = []
    for loss in held_out_losses(manifold, rows, targets, prior, objective, exact=exact):
        losses.append(loss)
        if len(losses) > 2 + np.argmin(losses):
            break
    return best_weight(losses)


def held_out_losses(
    manifold: ParameterManifold,
    rows: FloatArray,
    targets: FloatArray,
    prior: Point,
    objective: str,
    *,
    exact: bool = False,
) -> Iterator[float]:
    """Yield the squared error of all blocks, each at the fit to the others, per weight of the grid, strong to weak.

    The rows, in the order of time, make three blocks: few, because adjacent blocks are alike. Their errors are added,
    so that a block that cannot be predicted at all counts.
    """
    blocks = np.array_split(np.column_stack([rows, targets]), _BLOCKS)
    if not exact:
        blocks = [triangular(block) for block in blocks]
    fitted = [np.concatenate([*blocks[:index], *blocks[index + 1 :]]) for index in range(_BLOCKS)]
    if objective == "geodesic" and not exact:
        fitted = [np.column_stack(principal_rows(manifold, prior, others)) for others in fitted]
    points = [prior] * _BLOCKS
    for gamma in _GRID:
        loss = 0.0
        for index, (held_out, others) in enumerate(zip(blocks, fitted, strict=True)):
            rows, targets = others[:, :-1], others[:, -1]
            minimised = (
                ResidualObjective.of(manifold, rows, targets, prior, gamma)
                if objective == "residual"
                else GeodesicObjective(manifold, rows, targets, np.ones(len(rows)), prior, gamma)
            )
            points[index] = trust_region(minimised, points[index], _START_TOLERANCE * gamma).point
            loss += float(np.sum((held_out @ np.append(points[index].parameters, -1.0)) ** 2))
        yield loss


def best_weight(losses: Sequence[float]) -> float:
    """Weight of the grid, whose first weights have these ``losses``, that predicts best.

    The minimum is that of a parabola through the best weight and its neighbours, in logarithms; the strongest weight if
    that is the best.
    """
    totals = np.log(np.array(losses) + np.finfo(float).tiny)
    best = int(np.argmin(totals))
    if best == 0:
        return float(_GRID[0])
    middle = min(best, len(totals) - 2)
    slope, bend = np.polyfit([-1.0, 0.0, 1.0], totals[middle - 1 : middle + 2], 2)[1::-1]
    offset = np.clip(-0.5 * slope / bend, -1.0, 1.0) if bend > 0.0 else best - middle
    return float(_GRID[middle] * (_GRID[1] / _GRID[0]) ** offset)


def _from_remark_3(objective: GeodesicObjective, start: Point, tolerance: float, max_steps: int) -> Solution:
    """Solve by the trust region from the minimiser of Remark 3, or from ``start``, the prior, if that is lower."""
    scaled = objective.rows / objective.sigmas[:, None], objective.targets / objective.sigmas
    residual = ResidualObjective.of(objective.manifold, *scaled, objective.prior, objective.gamma)
    direct = trust_region(residual, start, _START_TOLERANCE, radius=_RADIUS).point
    evaluation = objective.evaluate(direct)
    if evaluation.value < objective.value_at_prior:
        return trust_region(objective, direct, tolerance, max_steps, evaluation=evaluation)
    return trust_region(objective, start, tolerance, max_steps)


def _check(rows: FloatArray, targets: FloatArray, sigmas: FloatArray, prior: FloatArray) -> None:
    fitting = prior.ndim == 2 and prior.shape[1] == pseudo_inertia.SIZE and targets.ndim == 1
    if not fitting or rows.shape != (len(targets), prior.size):
        raise InputError(
            f"rows {rows.shape}, targets {targets.shape} and prior {prior.shape} do not fit: "
            "expected (N, 10 links), (N,) and (links, 10)"
        )
    if sigmas.shape not in ((), targets.shape):
        raise InputError(
            f"standard deviations {sigmas.shape} do not fit targets {targets.shape}: expected one each, or one"
        )
    for name, array in (("rows", rows), ("targets", targets), ("sigmas", sigmas), ("prior", prior)):
        if not np.all(np.isfinite(array)):
            raise InputError(f"{name} has entries that are not finite")
    if np.any(sigmas <= 0.0):
        raise InputError("standard deviations must be greater than zero")
    smallest = np.linalg.eigvalsh(pseudo_inertia.from_parameters(prior))[:, 0]
    if np.any(smallest <= 0.0):
        raise InputError(f"the prior of link {int(np.argmin(smallest))} is not physically consistent")
