"""The model that is written for a reader: what its files hold of an estimate."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.files.models.effect_forms import combined, continued
from geomid_ros.files.models.estimate_file import EstimateFile, inertias_of, link_entry
from geomid_ros.files.models.readers import ELEMENTS
from geomid_ros.files.models.sidecar import effect_entry
from geomid_ros.files.models.urdf import inertia_of
from geomid_ros.model.effects import Effect, KnownEffect, Place, effect_class
from geomid_ros.model.measurement import Coefficient, MeasurementModel
from geomid_ros.types import FloatArray

_There: TypeAlias = dict[tuple[Place, Effect, int], tuple[Coefficient, float]]


@dataclass(frozen=True, eq=False)
class WrittenModel:
    """The model that a file holds.

    Attributes:
        inertias: parameters ``(10,)`` in pinocchio's order, by link.
        effects: what the file says, and errors of sensors, which stand beside it.
    """

    inertias: Mapping[str, FloatArray]
    effects: tuple[KnownEffect, ...]

    @property
    def of_robot(self) -> list[KnownEffect]:
        """The effects without errors of sensors."""
        return [effect for effect in self.effects if not effect_class(effect.effect).of_sensor]


def written_model(
    model: MeasurementModel, estimate: Estimate, reader: str, known: Sequence[KnownEffect] = ()
) -> WrittenModel:
    """The model that is written for a ``reader``.

    Args:
        model: that was identified.
        estimate: what was found; where nothing was fitted for this reader, that is taken as it is.
        reader: one of :data:`ELEMENTS`.
        known: the effects of the model that the estimation began with.
    """
    parameters = estimate.within.get(reader, estimate.parameters)
    first = len(model.nominal_inertias)
    inertias = dict(zip(model.body_names, parameters[:first].reshape(-1, 10), strict=True))
    pairs = zip(model.coefficients, parameters[first:].tolist(), strict=True)
    there: _There = {(c.place, c.effect, c.index): (c, value) for c, value in pairs if value}
    wholes = [whole for key in list(there) if (whole := _whole(there, key, ELEMENTS[reader])) is not None]
    stds = {(effect.name, effect.joint, effect.parameter): effect.std for effect in estimate.effects}
    found = [
        KnownEffect(c.effect.name, c.place_name, "", c.parameters(value, stds.get(_name(c), math.nan)))
        for c, value in there.values()
    ]
    return WrittenModel(inertias, tuple(continued(combined([*found, *wholes]), known)))


def _name(coefficient: Coefficient) -> tuple[str, str, str]:
    return coefficient.effect.name, coefficient.place_name, coefficient.parameter


def _whole(there: _There, key: tuple[Place, Effect, int], elements: Collection[str]) -> KnownEffect | None:
    """The effect of several parts, all of which are there, whose parameters a file says: a spring's offset is in its
    rest. Its parts are there no longer. None for others."""
    place, effect, _ = key
    parts = [(place, part, 0) for part in effect.parts]
    said = all(form.said_by(elements) for form in effect.parameters[: len(parts)])
    if len(parts) < 2 or not said or not all(part in there for part in parts):
        return None
    name = there[key][0].place_name
    values = np.array([there.pop(part)[1] for part in parts])
    quantities = effect.quantities(values, np.full((len(parts), len(parts)), math.nan))
    return KnownEffect(effect.name, name, "", quantities)


def handover_entry(model: WrittenModel, merged: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """What ``estimate.json`` says of the model that a file holds."""
    links = [link_entry(name, merged[name], inertia_of(own)) for name, own in model.inertias.items()]
    return {"links": links, "effects": [effect_entry(effect) for effect in model.effects]}


def written_for(file: EstimateFile, reader: str) -> WrittenModel | None:
    """The model that was fitted for a ``reader``; None if the file has none. Raises InputError for what cannot be."""
    alike = (name for name, elements in ELEMENTS.items() if elements == ELEMENTS.get(reader))
    found = next((file.handover[name] for name in alike if name in file.handover), None)
    if found is None:
        return None
    where = f"{file.source}: handover for {reader}"
    effects = [each.known(f"{where}: effects[{index}]") for index, each in enumerate(found.effects)]
    return WrittenModel(inertias_of(found.links, where), tuple(effects))
