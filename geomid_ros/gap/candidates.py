"""Candidates of the gap: effects at places of a robot, their columns and coefficients, and what these mean."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from geomid_ros.estimation.uncertainty import physical_sensitivity
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.inference.candidates import Candidate, EffectTerm
from geomid_ros.inference.fit import JointFit
from geomid_ros.inference.prior import GAIN, Prior
from geomid_ros.model.effects import (
    DEFAULT_EFFECTS,
    EFFECTS,
    AtSensor,
    Effect,
    IdentifiedEffect,
    LoadEffect,
    MotionEffect,
    Place,
    Quantity,
    SituationEffect,
    Values,
)
from geomid_ros.model.effects.parameters import quantities
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import REST, SIGN, SMOOTH_SIGN, Column, column_of
from geomid_ros.types import FloatArray

CLEARLY = 12.0
"""Difference of minus twice a logarithm that occurs by chance once in four hundred."""


EffectsByPlace: TypeAlias = Mapping[tuple[str, Place], IdentifiedEffect]
"""Effects with their constants, by name and place."""


def library_columns(model: MeasurementModel) -> tuple[Column, ...]:
    """Columns of samples for the gap workflow: of all effects of joints' motion, with all constants, and of the
    model."""
    columns = [
        column_of(effect, place)
        for cls in EFFECTS.values()
        for effect in cls.grid()
        if isinstance(effect, MotionEffect)
        for place in model.places.of(effect)
    ]
    return tuple(dict.fromkeys([*columns, SIGN, SMOOTH_SIGN, REST, *model.columns]))


def candidates(
    model: MeasurementModel,
    known: Collection[EffectTerm] = (),
    *,
    unknown_joints: bool = True,
    ordinary: EffectsByPlace = MappingProxyType({}),
) -> list[Candidate]:
    """Return all candidates for a robot with its sensors, and the changes of ``known`` effects, which keep their
    constants, as do default effects among the ``ordinary`` ones. ``unknown_joints``: True if nothing is known of its
    joints, so that they may well have default effects.
    The ground loads the joints of a legged robot, too: effects that depend on more than the load are omitted there."""
    has = {(term.effect.name, term.place) for term in known}
    changes = [
        Candidate.of(*pair, in_model=True) for pair in dict.fromkeys((term.effect, term.place) for term in known)
    ]
    result = [c for c in changes if set(c.terms) <= set(known)]
    result += [
        Candidate.of(effect, place, ordinary=unknown_joints and effect.name in DEFAULT_EFFECTS)
        for cls in EFFECTS.values()
        for effect in cls.grid()
        for place in model.places.of(effect)
        if effect.has_columns and (effect.name, place) not in has
        if effect.name not in DEFAULT_EFFECTS or ordinary.get((effect.name, place), effect) == effect
    ]
    if model.legs:
        result = [c for c in result if isinstance(c.effect, LoadEffect) or not isinstance(c.effect, SituationEffect)]
    return sorted(result, key=_order)


def _order(candidate: Candidate) -> tuple[int, int]:
    """Sort key: joint by joint; then the whole robot, payloads, sensors."""
    kind = ("joint", "joints", "robot", "commands", "link", "sensor", "base").index(candidate.effect.place)
    return kind, candidate.joint or 0 if kind == 0 else 0


def parameters(
    model: MeasurementModel, found: JointFit, candidate: Candidate, log_std: float = 0.0, usual_load: float = 0.0
) -> dict[str, Quantity]:
    """Parameters of a candidate with their standard deviations. ``log_std``: that of the logarithm of the grid
    constant. ``usual_load``: standard deviation of the joint's rigid-body load [N m or N]."""
    if candidate.payload is not None:
        body, spread = _payload(found, candidate.payload)
        stds = np.sqrt(np.maximum(np.diag(spread), 0.0))
        return quantities(candidate.effect.parameters, zip(body, stds, strict=True))
    values = np.array([found.value(term) for term in candidate.terms])
    return _quantities(model, candidate, values, found.covariance_of(candidate.terms), log_std, usual_load)


def known_before(model: MeasurementModel, prior: Prior, candidate: Candidate, usual_load: float = 0.0) -> Values:
    """Parameters of a candidate in the given model; empty if it had no such effect."""
    if not candidate.terms or not set(candidate.terms) <= set(prior.terms):
        return {}
    values = np.array([prior.value(term) for term in candidate.terms])
    before = _quantities(model, candidate, values, np.zeros((len(values), len(values))), 0.0, usual_load)
    return {name: quantity.value for name, quantity in before.items()}


def _payload(fit: JointFit, link: int) -> tuple[FloatArray, FloatArray]:
    """Mass, centre of mass and inertia of a link's payload ``(10,)``, and their covariance ``(10, 10)``, including the
    unknown common gain of the efforts, which scales mass and inertia."""
    place = fit.manifold.links - len(fit.bodies) + fit.bodies.index(link)
    rows = fit.manifold.link(place)
    values = pseudo_inertia.quantities_of(pseudo_inertia.to_parameters(fit.point.pseudo_inertias[place]))
    derivative = physical_sensitivity(fit.point)[place]
    by_gain = GAIN * np.concatenate([values[:1], np.zeros(3), values[4:]])
    return values, derivative @ fit.inverse_from_data[rows, rows] @ derivative.T + np.outer(by_gain, by_gain)


def first_moment(found: JointFit, candidate: Candidate) -> dict[str, Quantity]:
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
