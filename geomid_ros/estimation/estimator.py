"""Compute an estimate from summarised rows: starting point, prior weight, solve, uncertainty."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.estimation import estimate_parts, uncertainty
from geomid_ros.estimation.coefficient_fit import CoefficientRows
from geomid_ros.estimation.drive_gains import fit_drive_gains
from geomid_ros.estimation.effect_selection import Choice, choose, file_fit, fit_files
from geomid_ros.estimation.estimate import (
    SIGNIFICANT_STDS,
    STDS_OF_95,
    WITHIN,
    EffectEstimate,
    Estimate,
    LinksInformation,
    Predictor,
)
from geomid_ros.estimation.fit import INDEPENDENT_ROWS_PER_PERIOD, Fit, fit, with_second_start
from geomid_ros.estimation.link_priors import AlikePrior, CoupledPrior, PopulationPrior, fit_with_coupled_prior
from geomid_ros.estimation.objective import GeodesicObjective, row_weights
from geomid_ros.estimation.paper_estimator import OBJECTIVES
from geomid_ros.estimation.population import Population
from geomid_ros.estimation.posterior import effect_columns
from geomid_ros.estimation.problem import Problem, required_columns, subproblem
from geomid_ros.estimation.solvers import SOLVERS, Solution
from geomid_ros.estimation.starting_point import channel_sizes
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.estimation.tolerances import ROUNDING
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.geometry.spd import SIZE
from geomid_ros.model.alike_parts import AlikeParts
from geomid_ros.model.coefficients import Coefficient, Mechanism
from geomid_ros.model.effects import Effect, Place
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import REGIMES
from geomid_ros.model.weighed_masses import WeighedMass, WeighedRows, weighed_rows
from geomid_ros.types import BoolArray, FloatArray, IntArray, frozen

_FAR = 2.0  # default prior std: a link with a larger fitted prior std is an outlier; one farther away has a warning
_SPENT = (
    "the solver ran out of steps before the prior stds of the links converged; masses are those of the last step: "
    "more informative motion or a better URDF lets them converge"
)
WHITE_ROWS_PER_PERIOD = 1.79
"""Independent rows per period of the filter's cutoff if the noise is white and columns vary slowly: twice the filter's
noise bandwidth over the cutoff."""


@dataclass(frozen=True)
class EstimatorSettings:
    """Settings of :func:`estimate`. Raises InputError for invalid values.

    Attributes:
        gamma: Weight of the prior as a fraction of the rows' weight (the paper's is 0.01), the same for all links; None
            to estimate it for each link from the data.
        sigma: Known standard deviations by channel name; the others are estimated from the residuals.
        objective: ``residual`` (Remark 3) or ``geodesic`` (19).
        solver: Solver of the geodesic objective: ``trust_region`` or ``cyclic``.
        tolerance: Largest geodesic distance of the result from the minimum.
        max_steps: Largest number of solver steps.
        known: Weighed masses.
        cutoff: Cutoff of the low-pass filter that made the rows [Hz]; it determines how many rows are independent.
        population: Population of the robot's type; the prior instead of the URDF.
        alike: Links whose URDF errors are mostly common to them.
        relative_mass_std: Standard deviation of a common relative error of all masses: that of gravity as measured.
        files: Elements of a file, by its reader (:meth:`~geomid_ros.model.effects.ParameterForm.said_by`). For each
            file the parameters are also fitted with only the effects that it can hold.
    """

    gamma: float | None = None
    sigma: dict[str, float] | None = None
    objective: str = "residual"
    solver: str = "trust_region"
    tolerance: float = 1e-10
    max_steps: int = 300
    known: tuple[WeighedMass, ...] = ()
    cutoff: float = np.inf
    population: Population | None = None
    alike: tuple[AlikeParts, ...] = ()
    relative_mass_std: float = 0.0
    files: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.objective not in OBJECTIVES:
            raise unknown_name("objective", self.objective, OBJECTIVES)
        if self.solver not in SOLVERS:
            raise unknown_name("solver", self.solver, SOLVERS)
        numbers = {f"sigma of '{name}'": value for name, value in (self.sigma or {}).items()}
        if self.gamma is not None:
            numbers["gamma"] = self.gamma
        for name, value in numbers.items():
            if not 0.0 < value < np.inf:
                raise InputError(f"{name} is {value:g}, expected a number greater than zero")


@dataclass(frozen=True, eq=False)
class WarmStart:
    """Start of a solve from the end ``parameters (D,)`` of the last one; coefficients that are zero stay left out. They
    were chosen for so many ``rows``. ``spreads (links,)``: the prior std that it found; the default ones unless given.

    ``effects_alone``: take over only its effects, then drop those that the rows no longer support and add others."""

    parameters: FloatArray
    rows: int = 0
    spreads: FloatArray | None = None
    effects_alone: bool = False


def estimate(
    model: MeasurementModel,
    summary: RowSummary,
    settings: EstimatorSettings = EstimatorSettings(),
    prior: FloatArray | None = None,
    warm: WarmStart | None = None,
    prior_stds: FloatArray | None = None,
    known: WeighedRows | None = None,
    passing: Callable[[Estimate], bool] = lambda _: False,
) -> Estimate:
    """Choose the optional effects, and solve for all parameters from the summarised rows.

    Minimises :class:`ResidualObjective` on the summarised rows, with the noise and the prior weight that
    :func:`fit` finds. If requested, minimises (19) from there, with the same noise and prior weight.

    Args:
        model: Measurement model of the rows.
        summary: The rows.
        settings: How to solve.
        prior: Parameters ``(D,)`` instead of the URDF's inertias and the effects' fitted start; NaN if unknown.
        warm: Where to start; without it the result depends on nothing but the rows.
        prior_stds: Default prior std ``(links,)`` of the links, geodesic distances; that of a CAD file unless given.
        known: Rows in addition to those of the weighed masses: results of other data.
        passing: True for an estimate by which rows will be made anew: no files are fitted to it.

    Raises:
        InputError: Nothing was measured, or settings or prior do not fit the model.
    """
    begin = time.perf_counter()
    if summary.rows == 0:
        raise InputError("no usable rows: nothing was measured, or the robot never moved")
    whole = Problem(
        model,
        _pooled(model, summary),
        given_parameters=prior,
        known=weighed_rows(model, settings.known).plus(known),
        sigmas=_known_sigmas(model, settings, summary),
        gamma=settings.gamma,
        independent_fraction=filtered_fraction(summary, settings.cutoff),
        given_stds=prior_stds,
    )
    # Repeats of a motion count when effects are chosen; for the uncertainty of the parameters they hardly do.
    independent = whole.independent_fraction * subproblem(whole, required_columns(model)).distinct
    fits = _Fits(settings, whole, independent)
    start = None if warm is None or warm.effects_alone else warm
    if start is None:
        choice = fits.choice(whole, None if warm is None else _kept_columns(model, warm))
        found = _significant(partial(fits.solved, alternative=choice), choice.columns, _optional(model))
    else:
        found = fits.solved(_kept_columns(model, start), start=start)
    result = _estimate(found, whole)
    # A link that left its prior may have become heavy only to move its centre of mass; held, its neighbour may.
    while new := dict(_uncontradicted_masses(result, found.fitted)):
        fits = replace(fits, whole=replace(whole, masses_held={**new, **fits.whole.masses_held}))
        end = Choice(found.columns, result.parameters, result.prior_stds)
        found = fits.solved(found.columns, alternative=end)
        result = _estimate(found, whole)
    if passing(result):
        return replace(result, seconds=time.perf_counter() - begin)
    first = model.dimension - len(model.coefficients)
    expected_zero = [c.effect.is_sensor_error or bool(c.effect.default_prior_std) for c in model.coefficients]
    about_zero = {c.mechanism for c, is_expected in zip(model.coefficients, expected_zero, strict=True) if is_expected}
    sure = np.setdiff1d(found.columns, [*_insignificant(found, about_zero)])
    unsure = np.setdiff1d(first + np.flatnonzero(expected_zero), sure)
    own_fits = replace(fits, settings=replace(settings, objective="residual"))

    def of_file(held: IntArray, lacks_like_mass: bool) -> FloatArray:
        masses = _masses(result) if lacks_like_mass else None
        own = _significant(partial(own_fits.solved, weights=found.weights, masses=masses), held, about_zero)
        parameters = np.zeros(model.dimension)
        parameters[own.columns] = file_fit(own.fitted, found.fitted)
        return parameters

    within = fit_files(model, found.columns, settings.files, unsure, fits.among, of_file)
    return replace(result, within=within, seconds=time.perf_counter() - begin)


@dataclass(frozen=True, eq=False)
class _Fits:
    """Fits of some parameters of the ``whole`` problem. Of all rows, an ``independent`` fraction counts."""

    settings: EstimatorSettings
    whole: Problem
    independent: float

    def choice(self, problem: Problem, start: IntArray | None) -> Choice:
        """Choose the parameters of a problem, see :func:`choose`."""
        return choose(problem, start, partial(_at_prior, self.settings))

    def among(self, held: IntArray, start: IntArray) -> IntArray:
        """Choose among the columns that are ``held``, from a ``start``."""
        return held[self.choice(subproblem(self.whole, held), np.searchsorted(held, start)).columns]

    def solved(
        self,
        columns: IntArray,
        *,
        start: WarmStart | None = None,
        alternative: Choice | None = None,
        weights: Mapping[str, float] | None = None,
        masses: WeighedRows | None = None,
    ) -> _Solved:
        """Fit some columns: from a ``start``, or also from an ``alternative`` one. A coupled prior's ``weights`` and
        ``masses`` may be known."""
        whole = self.whole if masses is None else self.whole.with_known_rows(masses)
        problem = replace(subproblem(whole, columns), independent_fraction=self.independent)
        prior = _coupled_prior(self.settings, problem)
        problem = problem if prior is None else prior.problem
        solve: Callable[..., Fit] = partial(fit, tolerance=self.settings.tolerance, max_steps=self.settings.max_steps)
        if start is not None:
            solve = partial(solve, start=problem.manifold.point(start.parameters[columns]), prior_stds=start.spreads)
        elif alternative is not None and alternative.parameters is not None:
            solve = with_second_start(solve, problem.point_at(alternative.parameters[columns]), alternative.prior_stds)
        if prior is None:
            return _solved(solve(problem), self.settings, columns, self.whole)
        found, weights = fit_with_coupled_prior(prior, solve, weights)
        end = _solved(found, self.settings, columns, self.whole)
        return replace(end, weights=weights, notes=tuple(prior.release_warnings(weights)))


def _uncontradicted_masses(found: Estimate, fitted: Fit) -> Iterator[tuple[int, float]]:
    """Yield each link that left its prior, though the interval of its mass contains that of the prior, with its prior
    std; not those whose mass is held, and none of a fit that did not settle."""
    problem = fitted.problem
    for index, (link, mass) in enumerate(zip(found.links, problem.prior_inertias[::SIZE], strict=True)):
        is_free = link.outlier and index not in problem.masses_held and not fitted.budget_exhausted
        if is_free and link.may_weigh(mass):
            yield index, float(found.prior_stds[index])


def _significant(solve: Callable[[IntArray], _Solved], columns: IntArray, may_go: Collection[Mechanism]) -> _Solved:
    """Fit ``columns``, without those of the effects that ``may_go`` that are not significant."""
    while True:
        solved = solve(columns)  # anew, not from the last result: a dropped effect may have led it to another minimum
        sizes = _insignificant(solved, may_go)
        if not sizes:
            return solved
        least = min(sizes.values())  # without it, the others may be significant
        columns = np.setdiff1d(columns, [column for column, size in sizes.items() if size == least])
        del solved  # large


def _masses(found: Estimate) -> WeighedRows:
    """Return the masses of an estimate's links as known rows with their covariance: a sum may be known much better than
    its parts."""
    rows = np.zeros((len(found.links), len(found.parameters)))
    masses = slice(0, 10 * len(rows), 10)
    covariance = found.posterior.parameter_covariance[masses, masses].copy()
    variances = np.array([link.std_mass for link in found.links]) ** 2  # larger for links far from their priors
    np.fill_diagonal(covariance, np.maximum(np.diag(covariance), variances))
    stds = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(stds, stds))
    rows[:, masses] = (vectors / np.sqrt(np.maximum(values, ROUNDING))).T / stds
    return WeighedRows(rows, rows @ found.parameters)


def _coupled_prior(settings: EstimatorSettings, problem: Problem) -> CoupledPrior | None:
    """Prior that couples parameters, or None: the population's, else that of parts that are alike in the URDF."""
    if settings.population is not None:
        return PopulationPrior.of(settings.population, problem)
    return AlikePrior.of(settings.alike, problem) if settings.alike and problem.given_parameters is None else None


def _at_prior(settings: EstimatorSettings, problem: Problem) -> Problem:
    """Return the problem with the rows of its coupled prior, if it has one, linearised at the prior."""
    coupled = _coupled_prior(settings, problem)
    if coupled is None:
        return problem
    rows = coupled.rows_at(coupled.mean, coupled.trusted)
    # Not with_known_rows, which fits the coefficients' prior: a choice among many needs none.
    return replace(coupled.problem, known=coupled.problem.known.plus(rows))


def _kept_columns(model: MeasurementModel, warm: WarmStart) -> IntArray:
    """Columns of the parameters that are not left out."""
    first = model.dimension - len(model.coefficients)
    has_value = [(c, value != 0.0) for c, value in zip(model.coefficients, warm.parameters[first:], strict=True)]
    present = {c.mechanism for c, nonzero in has_value if nonzero}
    is_kept = [nonzero or not (c.optional or c.mechanism in present) for c, nonzero in has_value]
    return np.flatnonzero(np.append(np.full(first, True), np.array(is_kept, dtype=bool)))


def _optional(model: MeasurementModel) -> set[Mechanism]:
    """Mechanisms that no coefficient requires."""
    required = {c.mechanism for c in model.coefficients if not c.optional}
    return {c.mechanism for c in model.coefficients} - required


def _insignificant(solved: _Solved, among: Collection[Mechanism]) -> dict[int, float]:
    """Columns of those ``among`` the effects that are not significant, with their sizes in standard deviations, at most
    the sizes of the effects that they need: zero if one of these is left out."""
    problem = solved.fitted.problem
    coefficients = problem.model.coefficients
    sizes = [_size(c, effect) for c, effect in zip(coefficients, solved.effects, strict=True)]
    by_effect: dict[tuple[Place, Effect], float] = {
        (c.place, c.effect): size for c, size in zip(coefficients, sizes, strict=True)
    }
    least = [
        min([size, *(by_effect.get((c.place, effect), 0.0) for effect in c.effect.needs)])
        if c.mechanism in among
        else np.inf
        for c, size in zip(coefficients, sizes, strict=True)
    ]
    columns = solved.columns[problem.manifold.inertial.stop :]
    return {column: size for column, size in zip(columns.tolist(), least, strict=True) if size < STDS_OF_95}


def _size(coefficient: Coefficient, effect: EffectEstimate) -> float:
    """Size of a coefficient in its standard deviations. If it is expected to be zero on any robot, with a default prior
    std, it is the size of the posterior's mean: the noise is larger than the fit, which has this value, assumed. It is
    zero if the value is hardly possible: then it stands for something else."""
    size = abs(effect.value) / max(effect.std, np.finfo(float).tiny)
    if not coefficient.effect.default_prior_std:
        return size
    expected = coefficient.effect.default_prior_std[coefficient.index]
    return 0.0 if abs(effect.value) > SIGNIFICANT_STDS * expected else effect.from_data * size


def filtered_fraction(
    summary: RowSummary, cutoff: float, rows_per_period: float = INDEPENDENT_ROWS_PER_PERIOD
) -> float:
    """Fraction of the rows that are independent after the filter: ``rows_per_period`` per period of its ``cutoff``
    [Hz]; 1 for rows without times or without a filter."""
    if not (np.isfinite(cutoff) and summary.period > 0.0):
        return 1.0
    return min(rows_per_period * cutoff * summary.period, 1.0)


def _pooled(model: MeasurementModel, summary: RowSummary) -> RowSummary:
    """Pool slow and fast rows of each channel that has no more fast rows than slow ones, or than unknowns."""
    required = required_columns(model)
    unknowns = [np.count_nonzero(np.isin(channel.columns, required)) for channel in model.channels]
    fast, slow, _ = summary.counts().reshape(REGIMES, -1)
    return summary.pooled(fast <= np.maximum(slow, unknowns))


@dataclass(frozen=True, eq=False, kw_only=True)
class _Solved:
    """End of a solve for the ``columns`` of a problem: the fit, the minimum of the chosen objective, how many rows that
    one leaves out, the errors of the parameters if the constants of effects are exact, the steps of these constants'
    grids, and the effects with the errors of both. ``errors_for`` returns the former for other standard deviations
    ``(D,)`` of the prior's error. ``weights``: of the blocks of a coupled prior, with ``notes`` on these."""

    columns: IntArray
    fitted: Fit
    solution: Solution
    set_aside: int
    errors: uncertainty.Uncertainty
    grid_steps: uncertainty.GridSteps
    effects: tuple[EffectEstimate, ...]
    errors_for: Callable[[FloatArray], uncertainty.Uncertainty]
    weights: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @cached_property
    def link_errors(self) -> uncertainty.Uncertainty:
        """Errors of the links: a positive coefficient near zero is no better known than a real one of its channel, and
        neither is a link that the data cannot tell from it."""
        return self.errors_for(self.link_prior_stds)

    @property
    def link_prior_stds(self) -> FloatArray:
        """Prior std ``(D,)`` of :attr:`link_errors`."""
        problem, assumed = self.fitted.problem, self.fitted.assumed_prior_stds
        wider = np.append(assumed[problem.manifold.inertial], problem.default_coefficient_stds(self.solution.point))
        return np.maximum(wider, assumed)

    def stated_errors(self, prior_stds: FloatArray) -> uncertainty.Uncertainty:
        """Errors for such a prior ``(D,)``, but with real coefficients known to the size of their first fit at best:
        where the data cannot tell an offset from a link, it may be all that the link's prior leaves."""
        problem, wider = self.fitted.problem, prior_stds.copy()
        wider[problem.manifold.real] = np.maximum(wider[problem.manifold.real], problem.first_fit_sizes)
        return self.errors_for(wider)


def _solved(fitted: Fit, settings: EstimatorSettings, columns: IntArray, whole: Problem) -> _Solved:
    """Return the minimum that a fit of the ``columns`` of the ``whole`` problem leads to, and its errors."""
    problem, solution = fitted.problem, fitted.solution
    manifold, summary, known = problem.manifold, problem.summary, problem.known
    prior_weights, set_aside = fitted.objective.prior_weights, 0
    if settings.objective == "geodesic":
        geodesic = _geodesic_objective(fitted)
        set_aside = int(np.count_nonzero(geodesic.set_aside))
        prior_weights = geodesic.prior_weights
        tolerance = max(settings.tolerance * float(np.min(prior_weights)) / geodesic.scale, np.finfo(float).eps)
        solution = SOLVERS[settings.solver](geodesic, solution.point, tolerance, settings.max_steps)
    white, independent = (
        filtered_fraction(summary, settings.cutoff, per_period)
        for per_period in (WHITE_ROWS_PER_PERIOD, INDEPENDENT_ROWS_PER_PERIOD)
    )
    folds = uncertainty.Folds([uncertainty.fold_at(manifold, solution.point, each) for each in fitted.fold_products])
    known_fold = _known_at(manifold, solution.point, known)
    expected = _information_at(manifold, solution.point, known.rows[len(known.masses) :])
    assumed = fitted.assumed_prior_stds
    # To that of gravity, rows and the masses that they determine are in proportion.
    scale = folds.total.information[:, manifold.inertial] @ _common_scale(solution.point, settings.relative_mass_std)

    def errors_for(prior_stds: FloatArray) -> uncertainty.Uncertainty:
        errors = uncertainty.estimate_uncertainty(
            folds,
            known_fold,
            1.0 / problem.independent_fraction,
            prior_weights * (assumed / prior_stds) ** 2,
            manifold.log(solution.point, problem.prior_point),
            _parameter_groups(problem),
            least_inflation=1.0 / white * independent / problem.independent_fraction,
            assumed_prior_stds=prior_stds,
            expected=expected,
        )
        return errors.with_unknown_scale(errors.response @ scale)

    errors, steps = errors_for(assumed), _grid_steps(columns, whole, fitted, solution.point)
    return _Solved(
        columns=columns,
        fitted=fitted,
        solution=solution,
        set_aside=set_aside,
        errors=errors,
        grid_steps=steps,
        effects=estimate_parts.effects(problem, solution.point, errors.with_unknown_constants(steps)),
        errors_for=errors_for,
    )


def _common_scale(point: Point, relative: float) -> FloatArray:
    """Tangent coordinates ``(10 links,)`` of a ``relative`` increase of all weights."""
    increase = relative * pseudo_inertia.weights_of(pseudo_inertia.to_parameters(point.pseudo_inertias))
    return np.asarray(np.linalg.solve(point.links_jacobian, increase[:, :, None]).ravel(), dtype=np.float64)


def _estimate(found: _Solved, whole: Problem) -> Estimate:
    """Assemble the estimate from a fit of the ``whole`` problem."""
    columns, fitted, solution = found.columns, found.fitted, found.solution
    problem, point = fitted.problem, solution.point
    model, manifold, summary, known = problem.model, problem.manifold, problem.summary, problem.known
    steps = found.grid_steps
    errors = found.errors.with_unknown_constants(steps)
    link_errors, effect_errors = (
        found.stated_errors(stds).with_unknown_constants(steps)
        for stds in (found.link_prior_stds, fitted.assumed_prior_stds)
    )
    gains = fit_drive_gains(fitted, point, errors)
    parameters, beside_gains = np.zeros((2, whole.model.dimension))
    parameters[columns], beside_gains[columns] = point.parameters, gains.point.parameters
    predictor = Predictor(frozen(beside_gains), frozen(gains.of_channels(model)))
    factor = np.sqrt(min(errors.independent_fraction, problem.independent_fraction))
    information = uncertainty.links_information(
        manifold, problem.prior_point, point, fitted.rows, known.weighed, errors
    )
    return Estimate(
        converged=solution.converged,
        reason=solution.reason,
        steps=solution.steps,
        gamma=fitted.gamma,
        rows_accepted=summary.rows,
        rows_set_aside=found.set_aside,
        links=estimate_parts.links(
            problem, point, link_errors, _outliers(fitted), _stds_of_far_links(fitted, point, information, link_errors)
        ),
        effects=(*estimate_parts.effects(problem, point, effect_errors), *gains.effects(model)),
        parameters=frozen(parameters),
        predictor=predictor,
        channels=tuple(channel.name for channel in model.channels),
        sigmas=frozen(fitted.sigmas[: len(model.channels)]),
        prior_stds=frozen(fitted.prior_stds),
        rms_nominal=frozen(whole.summary.rms(whole.model.described_parameters)),
        rms=frozen(summary.with_drive_gains(predictor.drive_gains, manifold.inertial.stop).rms(gains.point.parameters)),
        information=information,
        posterior=estimate_parts.posterior(problem, point, found.link_errors),
        rows=frozen(factor * fitted.rows[0]),
        targets=frozen(factor * fitted.rows[1]),
        known=estimate_parts.weighed(problem, point, errors),
        warnings=(
            *_still_warnings(model, summary),
            *_far_warnings(model, fitted, point),
            *([_SPENT] if fitted.budget_exhausted else []),
            *found.notes,
        ),
    )


def _grid_steps(columns: IntArray, whole: Problem, fitted: Fit, point: Point) -> uncertainty.GridSteps:
    """Steps of the grids from which the ``whole`` problem offers the constants of the effects among ``columns``: half
    the change between the constants to either side, or at an end the change to the only one."""
    rows = CoefficientRows(whole)
    changes = np.zeros((0, whole.model.dimension))
    places = []
    for place, column in enumerate(columns.tolist()):
        if column < rows.first_column:
            continue
        effect, shapes = rows.coefficient(column).effect, rows.shapes[rows.mechanism(column)]
        if len(shapes) > 1 and (effect.constant or effect.default_constant):  # the ratio of a coupled motor is exact
            at = shapes.index(column)
            nearby = shapes[max(at - 1, 0) : at + 2]
            change = np.zeros(whole.model.dimension)
            change[nearby[-1]], change[nearby[0]] = 1.0, -1.0
            changes = np.vstack([changes, point.parameters[place] / (len(nearby) - 1) * change])
            places.append(place)
    changed = np.flatnonzero(np.any(changes, axis=0))
    products = changes[:, changed] @ whole.products.some(changed, fitted.sigmas**-2.0)
    return uncertainty.GridSteps(
        np.array(places, dtype=np.int64),
        fitted.problem.manifold.whiten(point, products[:, columns]),
        np.sum(products[:, :-1] * changes, axis=1),
    )


def _outliers(fitted: Fit) -> BoolArray:
    """True for each link whose fitted prior std is far above the default ``(links,)``."""
    return np.asarray(fitted.prior_stds > _FAR * fitted.problem.default_stds)


def _stds_of_far_links(
    fitted: Fit, point: Point, information: LinksInformation, errors: uncertainty.Uncertainty
) -> FloatArray:
    """Standard deviations ``(links, 13)`` of the numbers of links whose prior's errors may be large; zero of others.
    That a mass was held is no reason to be surer of the link than before."""
    problem = fitted.problem
    links = problem.manifold.inertial
    prior_stds = errors.prior_stds[links].reshape(-1, SIZE).copy()
    for index, std in problem.masses_held.items():
        prior_stds[index] = max(std, fitted.prior_stds[index])
    is_far = prior_stds[:, 0] > _FAR * problem.default_stds
    if not np.any(is_far):
        return np.zeros((len(is_far), 1))
    prior, estimated = (Point(p.pseudo_inertias, np.zeros(0), np.zeros(0)) for p in (problem.prior_point, point))
    stds = uncertainty.stds_along_geodesics(prior, estimated, information, prior_stds.ravel())
    return np.where(is_far[:, None], stds, 0.0)


def _far_warnings(model: MeasurementModel, fitted: Fit, point: Point) -> Iterator[str]:
    """Yield a warning with all links that are far from their priors, if any: beyond :data:`_FAR` times what is expected
    of all their coordinates together, even if they moved in one direction only."""
    pairs = zip(fitted.problem.prior_point.pseudo_inertias, point.pseudo_inertias, strict=True)
    off = fitted.problem.manifold.log(fitted.problem.prior_point, point)[fitted.problem.manifold.inertial]
    distances = np.linalg.norm(off.reshape(-1, spd.SIZE), axis=1) / fitted.problem.default_stds
    changes = list[str]()
    for name, distance, (before, after) in zip(model.body_names, distances, pairs, strict=True):
        if distance > _FAR * np.sqrt(spd.SIZE):
            moved = f"from {before[3, 3]:.3g} to {after[3, 3]:.3g} kg"
            if abs(np.log(after[3, 3] / before[3, 3])) < WITHIN:
                moved = "in centre of mass or inertia"
            changes.append(f"'{name}' {moved} ({distance:.0f} default prior std)")
    if changes:
        yield (
            f"links far from the URDF: {', '.join(changes)}; its inertias are wrong or placeholders, or these links "
            "absorb an unmodelled effect (a spring, a payload, other friction); check the URDF, or run 'geomid gap'"
        )


def _configured_sigmas(model: MeasurementModel, settings: EstimatorSettings) -> FloatArray:
    configured, names = settings.sigma or {}, [channel.name for channel in model.channels]
    for name in configured:
        if name not in names:
            raise unknown_name("channel with a configured standard deviation", name, names)
    return np.array([configured.get(name, np.nan) for name in names])


def _known_sigmas(model: MeasurementModel, settings: EstimatorSettings, summary: RowSummary) -> FloatArray:
    """Standard deviations ``(channels,)`` that are not estimated, NaN elsewhere: the configured ones, and those of
    joints that never moved. Their dry friction keeps one unknown value, as large as the effort at most, so all of their
    rows together count as one row of that standard deviation."""
    rest = summary.counts().reshape(REGIMES, -1)[-1]
    common = channel_sizes(summary, model.dimension) * np.sqrt(filtered_fraction(summary, settings.cutoff) * rest)
    configured = _configured_sigmas(model, settings)
    return np.where(summary.never_moved & np.isnan(configured), common, configured)


def _still_warnings(model: MeasurementModel, summary: RowSummary) -> Iterator[str]:
    """Yield a warning with all joints that were measured at rest alone, beside others, if any."""
    still = summary.never_moved
    names = ", ".join(repr(channel.name) for channel, each in zip(model.channels, still, strict=True) if each)
    if names and not np.all(still):
        yield f"never measured in motion: {names}; friction and rotor inertia are unknown there; record them in motion"


def _geodesic_objective(fitted: Fit) -> GeodesicObjective:
    """Build (19) for the rows of a fit, combined orthogonally so that each has a similar fraction of their information.

    Least squares does not depend on how rows are combined, but distances to hyperplanes do. A row with little
    information and as much noise as the others has no projection. The combination starts from the principal directions
    at the prior, in the metric there. The residuals fix their signs, so that no choice of frames or units matters.
    """
    from scipy.fft import dct  # noqa: PLC0415 of this objective alone

    problem, weights = fitted.problem, fitted.objective.prior_weights
    manifold, prior, factor = problem.manifold, problem.prior_point, np.sqrt(1.0 / problem.independent_fraction)
    rows, targets = (
        np.concatenate([measured, factor * known])
        for measured, known in zip(fitted.rows, (problem.known.rows, problem.known.targets), strict=True)
    )
    link_weight = float(np.exp(np.mean(np.log(weights[manifold.inertial]))))
    gamma = link_weight / float(np.sum(row_weights(manifold, prior, rows)))
    directions, values, _ = np.linalg.svd(manifold.whiten(prior, rows), full_matrices=False)
    directions = directions.T[values >= ROUNDING * values[0]]  # others are parts that no parameters change
    residuals = directions @ (rows @ prior.parameters - targets)
    signs = np.where(residuals < 0.0, -1.0, 1.0) * np.random.default_rng(0).choice((-1.0, 1.0), len(directions))
    mixing = dct(signs[:, None] * directions, axis=0, norm="ortho")
    ones, confidence = np.ones(len(directions)), weights / link_weight
    return GeodesicObjective(manifold, mixing @ rows, mixing @ targets, ones, prior, gamma, confidence=confidence)


def _known_at(manifold: ParameterManifold, point: Point, known: WeighedRows) -> uncertainty.Fold:
    """Build a fold from the known rows."""
    slope = (known.rows @ point.parameters - known.targets) @ known.rows
    return uncertainty.Fold(manifold.whiten(point, slope[None])[0], _information_at(manifold, point, known.rows))


def _information_at(manifold: ParameterManifold, point: Point, rows: FloatArray) -> FloatArray:
    """Information ``(D, D)`` of rows ``(N, D)`` of standard deviation 1, in tangent coordinates at ``point``."""
    normals = manifold.whiten(point, rows)
    return np.asarray(normals.T @ normals)


def _parameter_groups(problem: Problem) -> list[uncertainty.ParameterGroup]:
    """Parameter groups: the coordinates of all links, and those of each effect at all joints."""
    first, prior_std = problem.manifold.inertial.stop, problem.prior_stds
    effects = effect_columns((c.effect.name for c in problem.model.coefficients), first)
    groups = (np.arange(first), *effects.values())
    return [uncertainty.ParameterGroup(columns, float(prior_std[columns[0]])) for columns in groups]
