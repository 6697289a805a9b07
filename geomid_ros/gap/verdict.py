"""Conclusions from an analysis: its findings, the links that changed, and the gap that stays in unseen data."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from geomid_ros.estimation.estimate import is_significant
from geomid_ros.gap import candidates as library
from geomid_ros.gap.analysis import Analysis
from geomid_ros.gap.features import hats, knots
from geomid_ros.gap.linearised_problem import LinearisedProblem, root_mean_square
from geomid_ros.gap.records import Records
from geomid_ros.gap.result import (
    LIKELY,
    Finding,
    GapErrors,
    LinkChange,
    Ranked,
    ResidualDependence,
    Rival,
    Trace,
    Unexplained,
    Verdict,
    confidence_of,
)
from geomid_ros.inference.candidates import ODDS, Candidate
from geomid_ros.inference.fit import JointFit, fit, fit_of_prior, scattered
from geomid_ros.inference.prior import GAIN, Prior
from geomid_ros.inference.probability import probability_of_square, relative_std_from_remainder, separability
from geomid_ros.inference.remainder import DEFAULT_VARIANCE
from geomid_ros.model.effects import EFFECTS, Quantity, Values
from geomid_ros.model.effects.situation import OnLink
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.types import BoolArray, FloatArray

GAP_ABOVE = 1.15
"""In noise floors: a larger remainder is a gap, a smaller one has reached the floor."""
_KNOTS = 12  # per curve that explains a remainder


class HeldOut:
    """Residuals of an ``analysis``'s fits on held-out ``records``, at samples at which the last fit may be blamed."""

    def __init__(self, model: MeasurementModel, records: Records, analysis: Analysis) -> None:
        self._model, self._records, self._analysis = model, records, analysis
        self._last = self._problem(analysis.effects)

    def _problem(self, fit: JointFit) -> LinearisedProblem:
        known_remainder = self._analysis.problem.known_remainder
        return LinearisedProblem.at(self._model, self._records, fit, self._analysis.floor, known_remainder)

    @cached_property
    def _residuals(self) -> list[FloatArray]:
        """Residuals ``(N, C)`` of the given model, of the one with fitted inertias only, and of the last fit."""
        names = self._analysis.effects
        fits = (fit_of_prior(self._analysis.search.prior), self._analysis.inertias_only)
        return [*(self._problem(fit).residual(fit) for fit in fits), self._last.residual(names)]

    @cached_property
    def gap(self) -> GapErrors:
        """Residuals of all channels, in units of the floor, at the samples used for evaluation.

        The known remainder of the model is uncertain, most where its recordings did not move; and it may differ now by
        the default std. Neither is a gap.
        """
        uncertainty = self._times_floor(np.sqrt(self._last.variance(self._analysis.effects)))
        before, bare, after = map(self._times_floor, self._residuals)
        blocks = (len(rows.depends_on) if rows.mean is not None else 0 for rows in self._analysis.problem.features)
        return GapErrors(before, bare, after, np.sqrt(1.0 + uncertainty**2 + DEFAULT_VARIANCE * np.array([*blocks])))

    @cached_property
    def on_all(self) -> GapErrors:
        """Residuals at all samples, those at rest and near reversals included, in units of the floor."""
        before, bare, after = (root_mean_square(residual) / self._analysis.floor for residual in self._residuals)
        return GapErrors(before, bare, after, self.gap.expected)

    @property
    def fitted_gap(self) -> FloatArray:
        """RMS residual ``(C,)`` of the last fit on the data that were fitted, in units of the floor."""
        problem = self._analysis.problem
        return problem.valid_rms(problem.residual(self._analysis.effects)) / self._analysis.floor

    @cached_property
    def is_open(self) -> BoolArray:
        """True for the channels ``(C,)`` whose gap exceeds noise and the uncertainty of the fit, both with the known
        remainder and without: it may not hold for another motion."""
        # A standard deviation from n values is itself uncertain by 1 / sqrt(2 n), relative.
        counts = np.maximum(np.count_nonzero(self._last.valid, axis=0), 1)
        limit = GAP_ABOVE * (1.0 + 2.0 / np.sqrt(2.0 * counts)) * self.gap.expected
        without_standing = self._times_floor(self._residuals[-1] - self._last.expected_remainder)
        after = np.minimum(self.gap.after, without_standing)
        return np.asarray(np.nan_to_num(after) >= np.nan_to_num(limit, nan=np.inf))

    @cached_property
    def unjudged(self) -> BoolArray:
        """True for channels ``(C,)`` that are measured in motion, but at no sample at which the model can be blamed."""
        measured = np.any(self._last.records.usable(self._model, self._last.rows.targets), axis=0)
        return np.asarray(measured & np.isnan(self.gap.after))

    @cached_property
    def trace(self) -> Trace:
        """Measured values and predictions."""
        samples, measured = self._records.samples, self._records.rows(self._model).targets
        before, middle, after = (measured - residual for residual in self._residuals)
        return Trace(
            stamps=samples.stamps,
            position=samples.position,
            velocity=samples.velocity,
            load=np.abs(after),
            measured=measured,
            before=before,
            inertias_only=middle,
            after=after,
        )

    @cached_property
    def residual_dependences(self) -> tuple[ResidualDependence, ...]:
        """Variables that explain each channel's remainder."""
        residual = np.where(self._last.valid, self._residuals[-1], np.nan)
        return locate_residuals(self._model, self._records, residual, self.trace.load)

    def _times_floor(self, residual: FloatArray) -> FloatArray:
        """RMS of a ``residual (N, C)`` in units of the floor ``(C,)``; NaN where nothing is measured."""
        return self._last.valid_rms(residual) / self._analysis.floor


def locate_residuals(
    model: MeasurementModel, records: Records, residual: FloatArray, load: FloatArray
) -> tuple[ResidualDependence, ...]:
    """Locate the ``residual (N, C)`` of each channel; a wrench channel has no joint, only load and time."""
    samples = records.samples
    result = []
    for index, channel in enumerate(model.channels):
        values = residual[:, index]
        has_joint = channel.joint is not None
        velocity = samples.velocity[:, index] if has_joint else np.zeros(len(values))
        position = samples.position[:, index] if has_joint else np.zeros(len(values))
        reversals = np.tanh(velocity / max(0.05 * float(np.std(velocity)), 1e-9))
        variables = (velocity, position, load[:, index], samples.seconds, reversals)
        result.append(ResidualDependence(channel.name, *(share(values, variable) for variable in variables)))
    return tuple(result)


def strongest(found: ResidualDependence) -> str:
    """Variable that explains most of a channel's remainder, ``unknown`` if none explains any of it."""
    shares = {name: float(getattr(found, name)) for name in ("velocity", "position", "load", "time", "reversals")}
    best = max(shares, key=lambda name: shares[name])
    return best if shares[best] > 0.0 else "unknown"


def share(values: FloatArray, variable: FloatArray) -> float:
    """Fraction of the mean square of ``values (N,)``, 0 to 1, that a piecewise linear curve of a variable explains,
    less what it would explain of noise."""
    usable = np.isfinite(values)
    values, variable = values[usable], variable[usable]
    if len(values) <= _KNOTS or np.ptp(variable) == 0.0:
        return 0.0
    curves = hats(variable, knots(variable), _KNOTS)
    solution, _, rank, _ = np.linalg.lstsq(curves, values, rcond=1e-9)
    variance = float(np.sum((values - curves @ solution) ** 2)) / (len(values) - int(rank))
    return float(np.clip(1.0 - variance / max(float(np.mean(values**2)), 1e-300), 0.0, 1.0))


_NEAR = 20.0  # in minus twice a logarithm: rivals less likely than one in twenty thousand are not reported
_MOST_OF_IT = 0.5  # fraction of a channel's squares, or gap


def findings(model: MeasurementModel, analysis: Analysis) -> list[tuple[Candidate, Finding]]:
    """Return the named effects, the one that matters most first."""
    sized = scattered(analysis.search.design, analysis.effects)
    result = [(candidate, _finding(model, analysis, candidate, sized)) for candidate in analysis.supports]
    return sorted(result, key=lambda named: -named[1].loss)


def _finding(model: MeasurementModel, analysis: Analysis, candidate: Candidate, sized: JointFit) -> Finding:
    search, names, support = analysis.search, analysis.effects, analysis.supports[candidate]
    rivals = [Rival(c.name, model.places.name(c.place), loss) for c, loss in support.rivals if loss < _NEAR]
    joint, link = model.places.name(candidate.place), model.places.link(candidate.place)
    load = analysis.usual_load(candidate)
    parameters = library.parameters(model, sized, candidate, _scanned_std(analysis, candidate), load)
    was = library.known_before(model, search.prior, candidate, load)
    separable = separability(search.design, names, candidate)
    parameters = widened_by_remainder(analysis, candidate, parameters, was, separable)
    unsure = confidence_of(support.probability) != "confident"
    close = [(EFFECTS[rival.effect](), rival.joint) for rival in rivals]
    return Finding(
        effect=candidate.name,
        joint=joint,
        link=link,
        parameters=parameters,
        probability=support.probability,
        rivals=tuple(rivals),
        separability=separable,
        loss=support.loss,
        share=_share(analysis, candidate),
        was=was,
        settled_by=library.settled_by(candidate.effect, joint, close) if unsure else "",
        moment=moment_without_mass(sized, candidate, parameters),
    )


def moment_without_mass(
    found: JointFit, candidate: Candidate, parameters: Mapping[str, Quantity]
) -> dict[str, Quantity]:
    """First moment of a payload whose mass may be nothing, by its ``parameters``, if the moment is not; else empty."""
    moment = library.first_moment(found, candidate)
    stands_in = any(map(_is_significant, moment.values())) and not _is_significant(parameters["mass"])
    return moment if stands_in else {}


def widened_by_remainder(
    analysis: Analysis, candidate: Candidate, parameters: dict[str, Quantity], was: Values, separable: float
) -> dict[str, Quantity]:
    """Widen the parameters' standard deviations by the effect of the remainder, and by their drift between motions.

    Only the separable part of the columns determines a size, so the remainder changes it by more, at most by all of it.
    A gain in addition to a URDF is relative to the other joints' gains, which are as uncertain as a common one.
    """
    effect, of_remainder = candidate.effect, analysis.supports[candidate].relative_std
    of_remainder /= max(float(np.sqrt(separable)), of_remainder, 1e-300)
    doubt = np.hypot(of_remainder, effect.drift)
    gain = GAIN if effect.scales_measurement and not analysis.search.prior.identified else 0.0
    sizes = effect.sizes(parameters).items()
    changes = {name: abs(size.value - was.get(name, effect.absent_value)) for name, size in sizes}
    stds = {n: float(np.linalg.norm([q.std, doubt * changes[n], gain * q.value])) for n, q in sizes}
    return parameters | {n: replace(q, std=stds[n]) for n, q in sizes}


def probability_by_size(candidate: Candidate, parameters: Mapping[str, Quantity], was: Values) -> float:
    """Largest probability of a named effect with these sizes, against being unchanged, or nothing."""
    sizes, nothing = candidate.effect.sizes(parameters), candidate.effect.absent_value
    main = {"mass": sizes["mass"]} if "mass" in sizes else sizes
    squares = [((size.value - was.get(name, nothing)) / size.std) ** 2 for name, size in main.items() if size.std > 0.0]
    return probability_of_square(max(squares, default=np.inf))


def _is_significant(quantity: Quantity) -> bool:
    return is_significant(quantity.value, quantity.std)


def _share(analysis: Analysis, candidate: Candidate) -> float:
    """Fraction of the gap left by the inertias, over the channels that a named effect affects, that it closes in
    addition to the others. The links keep the fit's prior std: otherwise they would be freed to explain it."""
    search, names = analysis.search, analysis.effects
    reached = search.design.affected_channels(candidate)

    def gap(*chosen: Candidate) -> float:
        squares = fit(search.design, search.prior, chosen, names, names.prior_stds).squares
        return float(np.sum((squares / names.squares - 1.0)[reached]))

    without = gap(*(c for c in names.chosen if c is not candidate))
    return float(np.clip(without / max(gap(), 1e-300), 0.0, 1.0))


def _scanned_std(analysis: Analysis, candidate: Candidate) -> float:
    """Standard deviation of the logarithm of a grid constant, from the curvature of the score over its neighbours; 1
    where that is not informative, 0 for an effect without one."""
    if not candidate.effect.grid_value or candidate.in_model:
        return 0.0
    search, names = analysis.search, analysis.effects
    grid = sorted((c for c in search.hypotheses if c.group == candidate.group), key=lambda c: c.effect.grid_value)
    place = grid.index(candidate)
    if not 0 < place < len(grid) - 1:
        return 1.0
    neighbours = grid[place - 1 : place + 2]
    rest = [c for c in names.chosen if c is not candidate]
    logs = np.log([c.effect.grid_value for c in neighbours])
    scores = [search.fit([*rest, c], names).score for c in neighbours]
    curvature = 2.0 * float(np.polyfit(logs - logs[1], scores, 2)[0])  # the score is minus twice a log likelihood
    step = 0.5 * float(logs[2] - logs[0])
    return min(1.0, float(np.sqrt(2.0 / curvature + step**2 / 12.0))) if curvature > 0.0 else 1.0


def unexplained(model: MeasurementModel, analysis: Analysis, unseen: HeldOut) -> tuple[Unexplained, ...]:
    """Return the channels whose gap on unseen data stays open, and the variable on which the remainder depends: that
    whose features alone are its most likely explanation in the fitted data, or that of a curve of the unseen data if
    most of the gap is in these only."""
    design, result = analysis.search.design, []
    fitted = unseen.fitted_gap
    for channel in map(int, np.flatnonzero(unseen.is_open)):
        gap, names = float(unseen.gap.after[channel]), analysis.problem.features[channel].depends_on
        gains = analysis.effects.gains_of_features(design, channel, names)
        likely = max(gains, key=lambda name: gains[name])
        known = gains[likely] > 0.0 and fitted[channel] > _MOST_OF_IT * gap
        variable = likely if known else strongest(unseen.residual_dependences[channel])
        result.append(Unexplained(model.channels[channel].name, variable, gap))
    return tuple(result)


def verdict(analysis: Analysis, unseen: HeldOut, *, named: bool) -> Verdict:
    """Verdict of the whole run, in which something was ``named`` or not: unexplained if features explain most of a gap
    that stays open. Channels that were not evaluated may have a gap."""
    if np.any(unseen.is_open):
        lacks = analysis.effects.remainders(analysis.search.design)
        explained = np.array([lack.explained for lack in lacks])
        return "unexplained" if np.any(explained[unseen.is_open] > _MOST_OF_IT) else "incomplete"
    return "named" if named else "incomplete" if np.any(unseen.unjudged) else "no gap"


def ranking(
    model: MeasurementModel,
    analysis: Analysis,
    named: Sequence[tuple[Candidate, Finding]],
    confirmed: Collection[Finding],
) -> tuple[Ranked, ...]:
    """Rank the named effects as they were found, of which those are chosen that were ``confirmed``, then the others by
    the score test."""
    places = {(f.effect, f.joint, f.link) for f in confirmed}
    chosen = [
        Ranked(f.effect, f.joint, f.loss, f.separability, (f.effect, f.joint, f.link) in places) for _, f in named
    ]
    others = [
        Ranked(t.candidate.name, model.places.name(t.candidate.place), t.gain, t.separability, False)
        for t in analysis.search.ranked(analysis.likely)
        if np.isfinite(t.gain)
    ]
    return (*chosen, *others[:20])


_LEAST = 0.05  # fraction of the mass
_HELD = 0.1  # of the default prior std: an unchanged link may change only so much


def changed_links(model: MeasurementModel, analysis: Analysis) -> tuple[LinkChange, ...]:
    """Return the links whose mass has changed, without payloads, the one that matters most first; and the link that
    best explains a contradiction with other recordings, if its first moment has changed.

    A change that another link can absorb, such as that of a link which hardly moves alone, is not reported.
    """
    return tuple(sorted(_changes(model, analysis), key=lambda change: -change.loss))


def _changes(model: MeasurementModel, analysis: Analysis) -> Iterator[LinkChange]:
    names, search = analysis.effects, analysis.search
    sized, nominal = scattered(search.design, names), search.prior.inertias.reshape(-1, 10)
    prior = with_given_stds(search.prior, names.inflation)
    free = fit(search.design, prior, names.chosen, names, names.prior_stds).score
    for link, was in enumerate(nominal):
        change, is_changed_link = names.inertias[link] - was, link == search.prior.changed_link
        if not np.any(change[:4]) or (abs(change[0]) < _LEAST * was[0] and not is_changed_link):
            continue
        if names.inertias[link, 0] > np.sum(nominal[:, 0]):  # no link has more mass than the robot, nor has a payload
            continue
        doubt, covariance = relative_std_from_remainder(search.design, names, link, change), sized.body_covariance(link)
        std = np.hypot(np.sqrt(np.diag(covariance)), doubt * change)
        deviations, moment, centre = (change / std)[:1], {}, {}
        if is_changed_link and abs(deviations[0]) < np.max(np.abs(change / std)[1:4]):
            deviations, moment = (change / std)[1:4], library.moment_of(change[1:4], std[1:4])
        if search.prior.identified and not moment:
            centre = _centre(change, covariance[:4, :4])
        prior_stds = names.prior_stds.copy()
        prior_stds[link] = _HELD * search.prior.prior_std
        loss = fit(search.design, prior, names.chosen, names, prior_stds).score - free
        # The link may have changed without its mass.
        odds_against = np.exp(-0.5 * np.clip(min(loss, float(np.max(deviations**2))), 0.0, 1e3)) / ODDS
        odds_against += analysis.contested if is_changed_link else 0.0
        probability = float(1.0 / (1.0 + odds_against))
        if probability >= LIKELY:
            body = model.robot.bodies[model.identified[link]]
            yield LinkChange(
                link=body.name,
                joint=model.places.name(OnLink(link, model.places.mover(body.name))),
                mass=Quantity(float(change[0]), float(std[0]), "kg"),
                was=float(was[0]),
                loss=loss,
                probability=probability,
                moment=moment,
                centre=centre,
            )


def _centre(change: FloatArray, covariance: FloatArray) -> dict[str, Quantity]:
    """Centre of the added mass, from the ``change (10,)`` of a link's parameters and the ``covariance (4, 4)`` of mass
    and first moment."""
    centre = change[1:4] / change[0]
    derivative = np.column_stack([-centre, np.eye(3)]) / change[0]
    stds = np.sqrt(np.diag(derivative @ covariance @ derivative.T))
    return {axis: Quantity(float(value), float(std), "m") for axis, value, std in zip("xyz", centre, stds, strict=True)}


def with_given_stds(prior: Prior, inflation: float) -> Prior:
    """Return a prior for comparing the scores of fits with given prior std: these cost nothing, and other recordings
    keep the trust that the fit found."""
    return replace(
        prior, certainty=0.0, other_recordings=prior.other_recordings and prior.other_recordings.inflated(inflation)
    )
