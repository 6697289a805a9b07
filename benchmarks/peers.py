"""The methods that are compared: rows in, parameters out.

Each peer gets its best preparation. Those whose objective is least squares see the rows compressed by QR, which loses
nothing; those with conic constraints are solved by Clarabel through CVXPY. Weights of priors are shares of the sum of
the rows' weights (Remark 2) in the metric of the method's own prior term.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import clarabel
import cvxpy
import numpy as np
from scipy import sparse
from scipy.optimize import least_squares

from benchmarks.problem import Problem
from geomid_ros.estimation.objective import GeodesicObjective, ResidualObjective
from geomid_ros.estimation.paper_estimator import PAPER, solve_rows
from geomid_ros.estimation.solvers import cyclic, trust_region
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.types import FloatArray

_TOLERANCE = 1e-8  # of the gradient, relative to the sum of the weights
_TANGENT_UNITS = spd.to_matrix(np.eye(spd.SIZE))
_UNITS = pseudo_inertia.from_parameters(np.eye(spd.SIZE))

Fit = Callable[[Problem, float], FloatArray]


class NoSolutionError(Exception):
    """A peer's solver gave up on these rows with this weight."""


@dataclass(frozen=True)
class Method:
    """A way to find parameters ``(D,)`` from the rows to train on, given the weight of the prior.

    ``weight`` is the weight to use, or None if it is to be chosen on held-out blocks.
    """

    name: str
    fit: Fit
    weight: float | None = None


def prior(problem: Problem, _: float) -> FloatArray:
    """Nothing is learnt."""
    return problem.prior


def least_squares_fit(problem: Problem, weight: float) -> FloatArray:
    """(4): the Euclidean distance to the prior, no constraints."""
    rows, targets = _with_prior(problem, np.eye(problem.manifold.dimension), weight)
    solution: FloatArray = np.linalg.lstsq(rows, targets, rcond=None)[0]
    return solution


def euclidean_lmi(problem: Problem, weight: float) -> FloatArray:
    """(4) among bodies that can exist."""
    rows, targets = _with_prior(problem, np.eye(problem.manifold.dimension), weight)
    unknown = cvxpy.Variable(problem.manifold.dimension)
    _solve(cvxpy.sum_squares(rows @ unknown - targets), possible(problem.manifold, unknown))
    return np.asarray(unknown.value)


def direct_lmi(problem: Problem, weight: float) -> FloatArray:
    """:func:`euclidean_lmi` by Clarabel itself, on the Gram matrix: the fastest way to its solution."""
    rows, targets = problem.train.whitened
    gram, slope, size = rows.T @ rows, rows.T @ targets, problem.manifold.dimension
    scale = np.trace(gram)
    quadratic = gram / scale + weight * np.eye(size)
    upper = np.triu_indices(4)  # by columns of the lower triangle, which are those of the upper by rows
    units = np.where(upper[0] == upper[1], 1.0, np.sqrt(2.0))[:, None] * _UNITS[:, upper[1], upper[0]].T
    order = np.lexsort((upper[0], upper[1]))
    links = problem.manifold.links
    cone = sparse.block_diag([*[-units[order]] * links], format="csc")
    cone.resize((cone.shape[0], size))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(quadratic)),
        -(slope / scale + weight * problem.prior),
        cone,
        np.zeros(cone.shape[0]),
        [clarabel.PSDTriangleConeT(4)] * links,
        settings,
    )
    return np.asarray(solver.solve().x)


def constant_pullback(problem: Problem, weight: float) -> FloatArray:
    """The quadratic form of the metric at the prior as prior term, among bodies that can exist (T-RO 2020)."""
    to_parameters = _tangent_basis(problem)
    rows, targets = _with_prior(problem, np.linalg.inv(to_parameters), weight)
    unknown = cvxpy.Variable(problem.manifold.dimension)
    _solve(cvxpy.sum_squares(rows @ unknown - targets), possible(problem.manifold, unknown))
    return np.asarray(unknown.value)


def entropic(problem: Problem, weight: float) -> FloatArray:
    """The Bregman divergence of ``-log det`` from the prior as prior term (T-RO 2020).

    Of a link's ``P = P0^1/2 (1 + Y) P0^1/2`` it is ``tr Y - log det(1 + Y)``; twice that is the squared distance to
    second order.
    """
    manifold, to_parameters = problem.manifold, _tangent_basis(problem)
    rows, targets, scale = _whitened(problem, to_parameters)
    unknown = cvxpy.Variable(manifold.dimension)
    divergence = 0.5 * cvxpy.sum_squares(unknown[manifold.real])
    for link in range(manifold.links):
        change = _matrix(unknown[manifold.link(link)], _TANGENT_UNITS)
        divergence += cvxpy.trace(change) - cvxpy.log_det(np.eye(4) + change)
    if manifold.positives:
        change = unknown[manifold.positive]
        divergence += cvxpy.sum(change) - cvxpy.sum(cvxpy.log(1.0 + change))
    residual = cvxpy.sum_squares(rows @ unknown - targets) / scale
    _solve(residual + 2.0 * weight * divergence, [])
    return problem.prior + to_parameters @ np.asarray(unknown.value)


def log_cholesky(problem: Problem, weight: float) -> FloatArray:
    """Least squares without constraints in log-Cholesky parameters (Rucker & Wensing, RA-L 2022), prior term included.

    ``P = U U^T`` with U upper triangular, its diagonal ``exp(alpha) (exp d1, exp d2, exp d3, 1)``.
    """
    rows, targets = _compressed(problem)
    chart = _LogCholesky(problem)
    start = chart.coordinates
    share = np.sqrt(weight * np.sum((rows @ chart.jacobian(start)) ** 2))

    def residuals(x: FloatArray) -> FloatArray:
        return np.concatenate([rows @ chart.parameters(x) - targets, share * (x - start)])

    def jacobian(x: FloatArray) -> FloatArray:
        return np.concatenate([rows @ chart.jacobian(x), share * np.eye(len(x))])

    found = least_squares(residuals, start, jacobian, method="lm", xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=500)
    return chart.parameters(found.x)


def paper_cyclic(problem: Problem, weight: float) -> FloatArray:
    """(19) by the paper's alternation."""
    return cyclic(geodesic_objective(problem, weight), problem.prior_point, _TOLERANCE).point.parameters


def geodesic(problem: Problem, weight: float, *, exact: bool = True) -> FloatArray:
    """(19) by the trust region, as the package offers it for raw rows."""
    if problem.manifold.dimension == 10 * problem.manifold.links:
        rows = problem.train
        bodies = problem.prior.reshape(-1, 10)
        tolerance = _TOLERANCE / min(weight, 1.0)  # as a distance from the minimum
        options = {"tolerance": tolerance, "exact": exact}
        found = solve_rows(rows.coefficients, rows.targets, rows.sigmas, bodies, weight, **options)
        return found.parameters.ravel()
    if not exact:
        problem = problem.with_train(problem.train.compressed())
    start = problem.manifold.point(residual(problem, weight))
    return trust_region(geodesic_objective(problem, weight), start, _TOLERANCE).point.parameters


def compressed_geodesic(problem: Problem, weight: float) -> FloatArray:
    """(19) for the principal rows; compressed by QR where there are coefficients beside the links."""
    return geodesic(problem, weight, exact=False)


def residual(problem: Problem, weight: float) -> FloatArray:
    """Remark 3: squared residuals and the squared geodesic distance to the prior."""
    rows, targets = _compressed(problem)
    start = problem.prior_point
    objective = ResidualObjective.of(problem.manifold, rows, targets, start, weight)
    return trust_region(objective, start, _TOLERANCE, max_steps=300).point.parameters


def geodesic_objective(problem: Problem, weight: float) -> GeodesicObjective:
    """(19) for the rows to train on."""
    rows = problem.train
    return GeodesicObjective(
        problem.manifold, rows.coefficients, rows.targets, rows.sigmas, problem.prior_point, weight
    )


def possible(manifold: ParameterManifold, unknown: cvxpy.Variable) -> list[cvxpy.Constraint]:
    """Constraints under which the ``unknown`` parameters ``(D,)`` belong to bodies, or to their limits."""
    constraints = [_matrix(unknown[manifold.link(link)], _UNITS) >> 0 for link in range(manifold.links)]
    return constraints + ([unknown[manifold.positive] >= 0] if manifold.positives else [])


METHODS = (
    Method("prior", prior, 0.0),
    Method("least squares", least_squares_fit),
    Method("Euclidean + LMI", euclidean_lmi),
    Method("constant pullback + LMI", constant_pullback),
    Method("entropic", entropic),
    Method("log-Cholesky", log_cholesky),
    Method("cyclic (19)", paper_cyclic, PAPER),
    Method("trust_region (19)", geodesic, PAPER),
    Method("trust_region (19), rows compressed", compressed_geodesic, PAPER),
    Method("trust_region (19), own weight", geodesic),
    Method("residual (Remark 3)", residual),
)


def method(name: str) -> Method:
    """The method of this name."""
    return next(m for m in METHODS if m.name == name)


def _compressed(problem: Problem) -> tuple[FloatArray, FloatArray]:
    compressed = problem.train.compressed()
    return compressed.coefficients, compressed.targets


def _with_prior(problem: Problem, metric_root: FloatArray, weight: float) -> tuple[FloatArray, FloatArray]:
    """Rows whose squared residuals are those of the data plus ``weight sum(w) |G (x - x0)|^2``, compressed.

    All are divided by the root of the sum of the weights, which conic solvers like better than large numbers.
    """
    rows, targets = _compressed(problem)
    scale = np.sqrt(np.sum((rows @ np.linalg.inv(metric_root)) ** 2))
    root = np.sqrt(weight) * metric_root
    stacked = np.column_stack([np.vstack([rows / scale, root]), np.append(targets / scale, root @ problem.prior)])
    factor = np.linalg.qr(stacked, mode="r")[: rows.shape[1]]
    return factor[:, :-1], factor[:, -1]


def _tangent_basis(problem: Problem) -> FloatArray:
    """The matrix from tangent coordinates at the prior to parameters."""
    manifold = problem.manifold
    blocks, diagonal = manifold.jacobian(problem.prior_point)
    basis = np.zeros((manifold.dimension, manifold.dimension))
    for link in range(manifold.links):
        basis[manifold.link(link), manifold.link(link)] = blocks[link]
    rest = np.arange(manifold.inertial.stop, manifold.dimension)
    basis[rest, rest] = diagonal
    return basis


def _whitened(problem: Problem, to_parameters: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Compressed rows and targets for tangent coordinates at the prior, and the sum of their weights."""
    rows, targets = _compressed(problem)
    whitened = rows @ to_parameters
    return whitened, targets - rows @ problem.prior, float(np.sum(whitened**2))


def _matrix(coordinates: cvxpy.Expression, units: FloatArray) -> cvxpy.Expression:
    return cvxpy.reshape(units.reshape(len(units), -1).T @ coordinates, (4, 4), order="F")


def _solve(objective: cvxpy.Expression, constraints: list[cvxpy.Constraint]) -> None:
    """Solve for the variables. Raises NoSolutionError when the solver ends without a solution."""
    problem = cvxpy.Problem(cvxpy.Minimize(objective), constraints)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a solution of less accuracy than asked for is one
        try:
            problem.solve(solver="CLARABEL")
        except cvxpy.SolverError as error:
            raise NoSolutionError(str(error)) from error


class _LogCholesky:
    """The chart of log-Cholesky parameters, positives by their logarithm and reals in units of their scale."""

    _OFF = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))

    def __init__(self, problem: Problem) -> None:
        self._manifold = problem.manifold
        point = problem.prior_point
        flipped = np.linalg.cholesky(point.pseudo_inertias[:, ::-1, ::-1])
        factors = flipped[:, ::-1, ::-1]
        alpha = np.log(factors[:, 3, 3])
        scaled = factors / factors[:, 3:, 3:]
        diagonal = np.log(scaled[:, [0, 1, 2], [0, 1, 2]])
        off = np.array([scaled[:, i, j] for i, j in self._OFF]).T
        links = np.column_stack([alpha, diagonal, off])
        reals = point.reals / problem.manifold.scales
        self.coordinates = np.concatenate([links.ravel(), np.log(point.positives), reals])

    def _factors(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        links = x[self._manifold.inertial].reshape(-1, 10)
        unit = np.zeros((len(links), 4, 4))
        unit[:, [0, 1, 2], [0, 1, 2]] = np.exp(links[:, 1:4])
        unit[:, 3, 3] = 1.0
        for k, (i, j) in enumerate(self._OFF):
            unit[:, i, j] = links[:, 4 + k]
        return np.exp(links[:, 0])[:, None, None], unit

    def parameters(self, x: FloatArray) -> FloatArray:
        """Parameters ``(D,)`` of coordinates ``(D,)``."""
        size, unit = self._factors(x)
        factor = size * unit
        links = pseudo_inertia.to_parameters(factor @ factor.transpose(0, 2, 1))
        manifold = self._manifold
        return np.concatenate([links.ravel(), np.exp(x[manifold.positive]), manifold.scales * x[manifold.real]])

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Derivative ``(D, D)`` of the parameters by the coordinates."""
        size, unit = self._factors(x)
        change = np.zeros((len(unit), 10, 4, 4))
        change[:, 0] = size * unit
        for k in range(3):
            change[:, 1 + k, k, k] = size[:, 0, 0] * unit[:, k, k]
        for k, (i, j) in enumerate(self._OFF):
            change[:, 4 + k, i, j] = size[:, 0, 0]
        half = change @ (size * unit).transpose(0, 2, 1)[:, None]
        links = pseudo_inertia.to_parameters(half + half.transpose(0, 1, 3, 2))
        manifold = self._manifold
        jacobian = np.zeros((len(x), len(x)))
        for index in range(manifold.links):
            jacobian[manifold.link(index), manifold.link(index)] = links[index].T
        rest = np.arange(manifold.inertial.stop, len(x))
        jacobian[rest, rest] = np.concatenate([np.exp(x[manifold.positive]), manifold.scales])
        return jacobian
