"""From coefficients to parameters with units and standard deviations; and recordings that settle an ambiguity."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from geomid_ros.estimation.uncertainty import physical_sensitivity
from geomid_ros.gap.candidates import Candidate, EffectsFit, EffectsPrior
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.inference.prior import GAIN
from geomid_ros.model.effects import AtSensor, Effect, Quantity, Values
from geomid_ros.model.effects.parameters import quantities
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.types import FloatArray


def parameters(
    model: MeasurementModel, found: EffectsFit, candidate: Candidate, log_std: float = 0.0, usual_load: float = 0.0
) -> dict[str, Quantity]:
    """Parameters of a candidate with their standard deviations. ``log_std``: that of the logarithm of the grid
    constant. ``usual_load``: standard deviation of the joint's rigid-body load [N m or N]."""
    if candidate.payload is not None:
        body, spread = _payload(found, candidate.payload)
        stds = np.sqrt(np.maximum(np.diag(spread), 0.0))
        return quantities(candidate.effect.parameters, zip(body, stds, strict=True))
    values = np.array([found.value(term) for term in candidate.terms])
    places = [found.place(term) for term in candidate.terms]
    covariance = found.covariance[np.ix_(places, places)]
    return _quantities(model, candidate, values, covariance, log_std, usual_load)


def known_before(model: MeasurementModel, prior: EffectsPrior, candidate: Candidate, usual_load: float = 0.0) -> Values:
    """Parameters of a candidate in the given model; empty if it had no such effect."""
    if not candidate.terms or not set(candidate.terms) <= set(prior.terms):
        return {}
    values = np.array([prior.value(term) for term in candidate.terms])
    before = _quantities(model, candidate, values, np.zeros((len(values), len(values))), 0.0, usual_load)
    return {name: quantity.value for name, quantity in before.items()}


def _payload(fit: EffectsFit, link: int) -> tuple[FloatArray, FloatArray]:
    """Mass, centre of mass and inertia of a link's payload ``(10,)``, and their covariance ``(10, 10)``, including the
    unknown common gain of the efforts, which scales mass and inertia."""
    place = fit.manifold.links - len(fit.bodies) + fit.bodies.index(link)
    rows = fit.manifold.link(place)
    values = pseudo_inertia.quantities_of(pseudo_inertia.to_parameters(fit.point.pseudo_inertias[place]))
    derivative = physical_sensitivity(fit.point)[place]
    by_gain = GAIN * np.concatenate([values[:1], np.zeros(3), values[4:]])
    return values, derivative @ fit.inverse[rows, rows] @ derivative.T + np.outer(by_gain, by_gain)


def first_moment(found: EffectsFit, candidate: Candidate) -> dict[str, Quantity]:
    """Mass times centre of mass of a payload, about the origin of its link; empty for other candidates.

    Gravity identifies it even if the mass is not identifiable: where the joints do not move the body up and down, or
    about a centre that stays where it is.
    """
    if candidate.payload is None:
        return {}
    values, covariance = _payload(found, candidate.payload)
    derivative = np.column_stack([values[1:4], values[0] * np.eye(3)])
    stds = np.sqrt(np.diag(derivative @ covariance[:4, :4] @ derivative.T))
    return moment_of(values[0] * values[1:4], stds)


def moment_of(values: FloatArray, stds: FloatArray) -> dict[str, Quantity]:
    """First moment ``(3,)`` [kg m] with its standard deviations, by axis."""
    sizes = zip("xyz", values.tolist(), stds.tolist(), strict=True)
    return {f"m {axis}": Quantity(value, std, "kg m") for axis, value, std in sizes}


def _quantities(
    model: MeasurementModel,
    candidate: Candidate,
    values: FloatArray,
    covariance: FloatArray,
    unsure: float,
    usual_load: float,
) -> dict[str, Quantity]:
    """Parameters for these values of the coefficients; for a sensor one for each axis that it measures."""
    effect, place = candidate.effect, candidate.place
    if not isinstance(place, AtSensor):
        sliding = model.places.slides(place)
        return effect.quantities(values, covariance, sliding=sliding, log_std=unsure, usual_load=usual_load)
    forms = {form.name: form for form in effect.column_parameters}
    measured = [forms[model.channels[channel].axis] for channel in place.channels]
    return quantities(measured, zip(values, np.sqrt(np.diag(covariance)), strict=True))


def settled_by(effect: Effect, joint: str, rivals: Collection[tuple[Effect, str]]) -> str:
    """Recording that would distinguish an effect from its rivals, each with the joint at which it acts."""
    same = [other for rival, other in rivals if type(rival) is type(effect)]
    if effect.place == "link" and same:
        return f"a motion that turns {', '.join(repr(name) for name in (joint, *same))} through their ranges"
    return effect.settled_by
