"""From the summarised rows to an estimate: starting point, prior's weight, solve, uncertainty."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeAlias

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.estimation import estimate_parts, uncertainty
from geomid_ros.estimation.choice import Choice, choose
from geomid_ros.estimation.coupled_prior import CoupledPrior, fit_beside
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.file_fits import fit_files
from geomid_ros.estimation.fit import INDEPENDENT, Fit, fit, likelier
from geomid_ros.estimation.link_priors import AlikePrior, PopulationPrior
from geomid_ros.estimation.objective import GeodesicObjective, ResidualObjective
from geomid_ros.estimation.paper_estimator import OBJECTIVES
from geomid_ros.estimation.population import Population
from geomid_ros.estimation.posterior import effect_columns
from geomid_ros.estimation.problem import Problem, subproblem
from geomid_ros.estimation.solvers import SOLVERS
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.estimation.tolerances import ROUNDING
from geomid_ros.estimation.uncertain_inertia import WITHIN
from geomid_ros.geometry.manifold import ParameterManifold, Point
from geomid_ros.model.alike_parts import AlikeParts
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import REGIMES
from geomid_ros.model.weighed_masses import WeighedMass, WeighedRows, weighed_rows
from geomid_ros.types import BoolArray, FloatArray, IntArray, frozen

_FAR = 2.0  # times the usual distance
_TAKEN = 2.0  # of its own standard deviations: an effect that is smaller may as well be nothing
_SPENT = (
    "the solver's budget of steps was spent before the spreads of the links had settled: masses are those of the last "
    "step; is the URDF this robot's, in SI units, and do efforts have the signs of its joints?"
)
_Solved: TypeAlias = tuple[Fit, Mapping[str, float], Iterable[str]]
_OF_WHITE_NOISE = 1.79  # independent rows per period of the filter's cutoff: twice its noise bandwidth in cutoffs


@dataclass(frozen=True)
class EstimatorSettings:
    """How to solve. Raises InputError for values that cannot be.

    Attributes:
        gamma: Weight of the prior as a share of the rows' (the paper's is 0.01), the same for all links; None to find
            that of each link from the data.
        sigma: Standard deviations by channel name where they are known; others are estimated from the residuals.
        objective: ``residual`` (Remark 3) or ``geodesic`` (19).
        solver: Of the geodesic objective: ``trust_region`` or ``cyclic``.
        tolerance: Largest geodesic distance of the result from the minimum.
        max_steps: Of the solver.
        known: Weighed masses.
        cutoff: Of the filter that made the rows [Hz], which says how many of them are independent.
        population: Of the robot's type, in place of the URDF as the prior.
        alike: Links whose errors in the URDF are mostly the same ones.
        files: By who reads it, the file's elements (:meth:`~geomid_ros.model.effects.ParameterForm.said_by`): the
            parameters are also fitted as far as such a file can hold them.
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
    """Where the last solve ended: the next one begins at these ``parameters (D,)``, in which the coefficients are zero
    that were left out, and leaves out the same. They were chosen for so many ``rows``. ``spreads (links,)``: those of
    the priors that it found; the usual ones unless given.

    ``effects_alone``: the next one begins with nothing but the same effects, and chooses anew: it looks for more beside
    them, if all of them are asked for still."""

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
    spreads: FloatArray | None = None,
    known: WeighedRows | None = None,
) -> Estimate:
    """Choose which optional effects there are, and solve for all parameters from the summarised rows.

    Minimises :class:`ResidualObjective` on the compressed rows, at most D of them, with the noise and the prior's
    weight as :func:`fit` finds them, and from there, if that is asked for, (19) with the same.

    Args:
        model: What the rows mean.
        summary: The rows.
        settings: How to solve.
        prior: ``(D,)``, instead of the URDF's inertias and the fitted start of the effects; NaN for not known.
        warm: Where to start; without it the result depends on nothing but the rows.
        spreads: Usual spreads ``(links,)`` of the links' priors, geodesic distances; those of a CAD file unless given.
        known: Rows beside those of the weighed masses: what other data said.

    Raises:
        InputError: Nothing was measured, or settings or prior do not fit the model.
    """
    begin = time.perf_counter()
    if summary.rows == 0:
        raise InputError("no usable rows: nothing was measured, or the robot never moved")
    whole = Problem(
        model,
        _pooled(model, summary),
        given=prior,
        known=weighed_rows(model, settings.known).plus(known),
        sigmas=_configured_sigmas(model, settings),
        gamma=settings.gamma,
        independent=_filtered(summary, settings.cutoff),
        given_spreads=spreads,
    )
    # Effects are chosen by what repeats; how sure all parameters are is another question.
    independent = whole.independent * subproblem(whole, _standing(model)).distinct

    def fitted(
        columns: IntArray,
        begun: WarmStart | None = None,
        other: Choice | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> _Solved:
        problem = replace(subproblem(whole, columns), independent=independent)
        solve: Callable[..., Fit] = partial(fit, tolerance=settings.tolerance, max_steps=settings.max_steps)
        if begun is not None:
            solve = partial(solve, start=problem.manifold.point(begun.parameters[columns]), spreads=begun.spreads)
        elif other is not None and other.parameters is not None:
            solve = likelier(solve, problem.place(other.parameters[columns]), other.spreads)
        return _beside(_coupled(settings, problem), problem, solve, weights)

    kept = None if warm is None else _kept(model, warm)
    if warm is None or kept is None or warm.effects_alone:
        choice = choose(whole, kept, partial(_at_prior, settings))
        columns = choice.columns
        result = _estimate(columns, model, solved := fitted(columns, other=choice), settings)
        while len(unsure := _unsure(model, result, columns)):
            columns = np.setdiff1d(columns, unsure)
            # What goes leaves no trace: there may be another minimum where it led.
            result = _estimate(columns, model, solved := fitted(columns, other=choice), settings)
    else:
        columns = kept
        result = _estimate(columns, model, solved := fitted(columns, warm), settings)

    def chosen(held: IntArray, begun: IntArray) -> IntArray:
        choice = choose(subproblem(whole, held), np.searchsorted(held, begun), partial(_at_prior, settings))
        return np.asarray(held[choice.columns])

    untold, (_, weights, _) = _untold_errors(model, result, columns), solved
    within = fit_files(model, columns, settings.files, untold, chosen, lambda held: fitted(held, weights=weights)[0])
    return replace(result, within=within, seconds=time.perf_counter() - begin)


def _coupled(settings: EstimatorSettings, problem: Problem) -> CoupledPrior | None:
    """What couples parameters of the prior: the robot's population; else parts of a URDF that are alike, if any are."""
    if settings.population is not None:
        return PopulationPrior.of(settings.population, problem)
    return AlikePrior.of(settings.alike, problem) if settings.alike and problem.given is None else None


def _at_prior(settings: EstimatorSettings, problem: Problem) -> Problem:
    """The problem beside what couples its prior, there."""
    coupled = _coupled(settings, problem)
    return problem if coupled is None else coupled.problem_at(coupled.problem.prior_point, coupled.trusted)


def _beside(
    prior: CoupledPrior | None, problem: Problem, solve: Callable[..., Fit], weights: Mapping[str, float] | None
) -> _Solved:
    """A fit, beside a coupled prior if there is one, the weights of its blocks, and warnings in sentences."""
    if prior is None:
        return solve(problem), {}, ()
    found, weights = fit_beside(prior, solve, weights)
    return found, weights, prior.unlike(weights)


def _kept(model: MeasurementModel, warm: WarmStart) -> IntArray:
    """The parameters that are not left out, by their columns."""
    first = model.dimension - len(model.coefficients)
    there = [(c, value != 0.0) for c, value in zip(model.coefficients, warm.parameters[first:], strict=True)]
    present = {c.mechanism for c, is_there in there if is_there}
    kept = [is_there or not (c.optional or c.mechanism in present) for c, is_there in there]
    return np.flatnonzero(np.append(np.full(first, True), np.array(kept, dtype=bool)))


def _unsure(model: MeasurementModel, result: Estimate, columns: IntArray) -> IntArray:
    """The column of the optional effect that may as well be nothing, the least one: others are surer without it."""
    first = model.dimension - len(model.coefficients)
    own = columns[columns >= first]
    always = {c.mechanism for c in model.coefficients if not c.optional}
    sizes = _sizes(result)
    sizes[[model.coefficients[column - first].mechanism in always for column in own]] = np.inf
    least = float(np.min(sizes, initial=np.inf))
    return np.asarray(own[(sizes < _TAKEN) & (sizes <= least)])


def _untold_errors(model: MeasurementModel, result: Estimate, columns: IntArray) -> IntArray:
    """The columns of the errors of sensors that may as well be nothing."""
    first = model.dimension - len(model.coefficients)
    own = columns[columns >= first]
    of_sensor = np.array([model.coefficients[column - first].effect.of_sensor for column in own], dtype=bool)
    return np.asarray(own[of_sensor & (_sizes(result) < _TAKEN)])


def _sizes(result: Estimate) -> FloatArray:
    """How many of its own standard deviations each effect is."""
    return np.array([abs(e.value) / max(e.std, np.finfo(float).tiny) for e in result.effects])


def _filtered(summary: RowSummary, cutoff: float) -> float:
    """The share of the rows that a filter leaves independent; all of rows that have no times, or that none made."""
    if not (np.isfinite(cutoff) and summary.period > 0.0):
        return 1.0
    return min(INDEPENDENT * cutoff * summary.period, 1.0)


def _standing(model: MeasurementModel) -> IntArray:
    """The columns of the parameters that are not optional."""
    first = model.dimension - len(model.coefficients)
    return np.array([k for k in range(model.dimension) if k < first or not model.coefficients[k - first].optional])


def _pooled(model: MeasurementModel, summary: RowSummary) -> RowSummary:
    """The rows, those of slow motion among those of fast motion where these are fewer, or no more than unknowns."""
    standing = _standing(model)
    unknowns = [np.count_nonzero(np.isin(channel.columns, standing)) for channel in model.channels]
    fast, slow, _ = summary.counts().reshape(REGIMES, -1)
    return summary.pooled(fast <= np.maximum(slow, unknowns))


def least_inflation(summary: RowSummary, cutoff: float) -> float:
    """How many rows there are for each that white noise leaves independent, seen by what moves slowly."""
    if not (np.isfinite(cutoff) and summary.period > 0.0):
        return 1.0
    return max(1.0 / (_OF_WHITE_NOISE * cutoff * summary.period), 1.0)


def _estimate(columns: IntArray, whole: MeasurementModel, solved: _Solved, settings: EstimatorSettings) -> Estimate:
    """All that is said of a fit."""
    fitted, _, unlike = solved
    problem = fitted.problem
    model, manifold, summary, known = problem.model, problem.manifold, problem.summary, problem.known
    objective, solution = fitted.objective, fitted.solution
    prior_point, prior_weights = problem.prior_point, objective.prior_weights
    set_aside = 0
    if settings.objective == "geodesic":
        geodesic = _geodesic_objective(objective)
        set_aside = int(np.count_nonzero(geodesic.set_aside))
        prior_weights = geodesic.prior_weights
        tolerance = max(settings.tolerance * float(np.min(prior_weights)) / geodesic.scale, np.finfo(float).eps)
        solution = SOLVERS[settings.solver](geodesic, solution.point, tolerance, settings.max_steps)
    contents = summary.products(fitted.sigmas, manifold.dimension)
    least = least_inflation(summary, settings.cutoff) * _filtered(summary, settings.cutoff) / problem.independent
    found = uncertainty.estimate_uncertainty(
        [_fold_at(manifold, solution.point, products) for products in contents],
        _known_at(manifold, solution.point, known),
        1.0 / problem.independent,
        prior_weights,
        manifold.log(solution.point, prior_point),
        _parameter_groups(problem),
        least_inflation=least,
        assumed_spreads=fitted.assumed_spreads,
        expected=_information_at(manifold, solution.point, known.prior_rows),
    )
    parameters = np.zeros(whole.dimension)
    parameters[columns] = solution.point.parameters
    independent = np.sqrt(min(found.share, problem.independent))
    return Estimate(
        converged=solution.converged,
        reason=solution.reason,
        steps=solution.steps,
        gamma=fitted.gamma,
        rows_accepted=summary.rows,
        rows_set_aside=set_aside,
        links=estimate_parts.links(problem, solution.point, found, _outliers(fitted)),
        effects=estimate_parts.effects(problem, solution.point, found),
        parameters=frozen(parameters),
        channels=tuple(channel.name for channel in model.channels),
        sigmas=frozen(fitted.sigmas[: len(model.channels)]),
        spreads=frozen(fitted.spreads),
        rms_nominal=frozen(summary.rms(model.nominal_parameters)),
        rms=frozen(summary.rms(solution.point.parameters)),
        information=uncertainty.links_information(
            manifold, prior_point, solution.point, fitted.rows, known.weighed, found
        ),
        posterior=estimate_parts.posterior(problem, solution.point, found),
        rows=frozen(independent * fitted.rows[0]),
        targets=frozen(independent * fitted.rows[1]),
        known=estimate_parts.weighed(problem, solution.point, found),
        warnings=(*_run_away(model, fitted, solution.point), *([_SPENT] if fitted.spent else []), *unlike),
    )


def _outliers(fitted: Fit) -> BoolArray:
    """Whether each link left its prior by far more than links usually do ``(links,)``."""
    return np.asarray(fitted.spreads > _FAR * fitted.problem.usual)


def _run_away(model: MeasurementModel, fitted: Fit, point: Point) -> Iterator[str]:
    """A sentence for each link that left its prior."""
    pairs = zip(fitted.problem.prior_point.pseudo_inertias, point.pseudo_inertias, strict=True)
    times = fitted.spreads / fitted.problem.usual
    for name, outlier, far, (prior, found) in zip(model.body_names, _outliers(fitted), times, pairs, strict=True):
        if outlier:
            what = f"moved from {prior[3, 3]:.3g} to {found[3, 3]:.3g} kg"
            if abs(np.log(found[3, 3] / prior[3, 3])) < WITHIN:
                what = "changed its centre of mass or its inertia"
            yield (
                f"link '{name}' {what} ({far:.1f} default prior std); it probably absorbs an unmodelled "
                "effect, such as a spring, a payload or other friction; run 'geomid gap'"
            )


def _configured_sigmas(model: MeasurementModel, settings: EstimatorSettings) -> FloatArray:
    configured, names = settings.sigma or {}, [channel.name for channel in model.channels]
    for name in configured:
        if name not in names:
            raise unknown_name("channel with a configured standard deviation", name, names)
    return np.array([configured.get(name, np.nan) for name in names])


def _geodesic_objective(objective: ResidualObjective) -> GeodesicObjective:
    """(19) for the same rows, combined orthogonally so that each carries a like share of their information.

    Least squares does not care how rows are combined, distances to hyperplanes do: a row with little information and as
    much noise as the others has no projection. The combination starts from the principal directions at the prior, in
    the metric there, and fixes their signs by the residuals, so that it depends on no choice of frames or units.
    """
    from scipy.fft import dct  # noqa: PLC0415 of this objective alone

    manifold, prior = objective.manifold, objective.prior
    left, values, _ = np.linalg.svd(manifold.whiten(prior, objective.rows), full_matrices=False)
    left = left.T[values >= ROUNDING * values[0]]  # what no parameters can change has no directions of its own
    residuals = left @ (objective.rows @ prior.parameters - objective.targets)
    signs = np.where(residuals < 0.0, -1.0, 1.0) * np.random.default_rng(0).choice((-1.0, 1.0), len(left))
    mixing = dct(signs[:, None] * left, axis=0, norm="ortho")
    rows, targets = mixing @ objective.rows, mixing @ objective.targets
    return GeodesicObjective(
        manifold, rows, targets, np.ones(len(rows)), prior, objective.gamma, confidence=objective.confidence
    )


def _fold_at(manifold: ParameterManifold, point: Point, products: FloatArray) -> uncertainty.Fold:
    """Rows of standard deviation 1, of which these are the ``products (D + 1, D + 1)`` of all columns ``[A b]``."""
    slope = products[:-1] @ np.append(point.parameters, -1.0)
    half = manifold.whiten(point, products[:-1, :-1])
    return uncertainty.Fold(manifold.whiten(point, slope[None])[0], manifold.whiten(point, half.T))


def _known_at(manifold: ParameterManifold, point: Point, known: WeighedRows) -> uncertainty.Fold:
    """The same of rows."""
    slope = (known.rows @ point.parameters - known.targets) @ known.rows
    return uncertainty.Fold(manifold.whiten(point, slope[None])[0], _information_at(manifold, point, known.rows))


def _information_at(manifold: ParameterManifold, point: Point, rows: FloatArray) -> FloatArray:
    """Of rows ``(N, D)`` of standard deviation 1."""
    normals = manifold.whiten(point, rows)
    return np.asarray(normals.T @ normals)


def _parameter_groups(problem: Problem) -> list[uncertainty.ParameterGroup]:
    """The links' coordinates, and each effect's at all joints."""
    first, usual = problem.manifold.inertial.stop, problem.prior_spreads
    effects = effect_columns((c.effect.name for c in problem.model.coefficients), first)
    groups = (np.arange(first), *effects.values())
    return [uncertainty.ParameterGroup(columns, float(usual[columns[0]])) for columns in groups]
