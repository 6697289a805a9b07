"""The model with what the gap workflow found, as files: ``estimate.json``, URDF, MJCF and the sidecar of effects.

``estimate.json`` is an :class:`~geomid_ros.files.models.estimate_file.EstimateFile` like any other, with less in it (no
standard deviations of links); and the ``floor``, the standard deviation of each channel's noise [N m, N] below the
``cutoff`` [Hz], in which ``geomid verify`` judges it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from geomid_ros.checks.causes import Finding
from geomid_ros.checks.verdict import recording_verdict
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.files.disk import write_json, write_text
from geomid_ros.files.models.effects_file import (
    combined,
    continued,
    effects_entries,
    is_body,
    payload_parameters,
    write_sidecar,
)
from geomid_ros.files.models.estimate_file import EstimateFile, inertias_of, link_entry, verdict_entry
from geomid_ros.files.models.mjcf import mjcf
from geomid_ros.files.models.readers import ELEMENTS, READERS, URDF
from geomid_ros.files.models.urdf import with_effects, with_inertials
from geomid_ros.files.schema import FORMAT, plain
from geomid_ros.model.coefficients import Coefficient
from geomid_ros.model.effects import Effect, KnownEffect, Place, effect_class, values_of
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray

ESTIMATE, IDENTIFIED, MJCF, EFFECTS_FILE = "estimate.json", "identified.urdf", "identified.xml", "effects.yaml"


@dataclass(frozen=True)
class ModelFiles:
    """An MJCF and its sidecar of effects."""

    mjcf: Path
    effects: Path

    @staticmethod
    def of(folder: Path) -> ModelFiles:
        """Those of :func:`write_model` in a folder."""
        return ModelFiles(folder / MJCF, folder / EFFECTS_FILE)


def write_model(
    folder: Path,
    model: MeasurementModel,
    urdf: str,
    inertias: Mapping[str, FloatArray],
    effects: Iterable[KnownEffect],
    gravity: FloatArray,
    findings: Sequence[Finding] = (),
    noise: Mapping[str, Any] = MappingProxyType({}),
    folded: Mapping[tuple[str, str], float] = MappingProxyType({}),
    fitted: Mapping[str, WrittenModel] = MappingProxyType({}),
    reader: str = URDF,
) -> list[Path]:
    """Write the model with ``inertias (10,)`` of identified bodies by name and all of its ``effects`` into ``folder``;
    returns the files. ``fitted`` are the models that descriptions hold instead, by their readers; the sidecar is that
    of one ``reader``.

    ``gravity (3,)`` is that of a base which stands straight; ``findings`` are what seems to be wrong with the recording
    that the model is from, ``noise`` its floor by channel and its cutoff, if known; ``folded`` is the model's, see
    :class:`WrittenModel`. Of effects that are there twice, see :func:`~geomid_ros.files.models.effects_file.combined`.
    """
    effects = combined(effects)
    whole = WrittenModel(inertias, tuple(effects), folded)
    held = {name: fitted.get(name, whole) for name in READERS}
    alone = {name: replace(own, effects=tuple(_with_folded(own.effects, own.folded))) for name, own in held.items()}
    merged = {body.name: body.merged for body in model.robot.bodies if body.name in inertias}
    removed = [name for names in merged.values() for name in names]
    document = {
        "format": FORMAT,
        "links": [link_entry(name, merged[name], own) for name, own in inertias.items()],
        **effects_entries(effects),
        "handover": {name: handover_entry(own.said_by(ELEMENTS[name]), merged) for name, own in alone.items()},
        "robot": model.robot.name,
        "gravity": gravity.tolist(),
        "verdict": verdict_entry(recording_verdict(findings), findings),
    }
    write_json(folder / ESTIMATE, document | dict(noise))
    of_urdf, of_mjcf = alone[URDF], alone["mujoco"]
    write_text(folder / IDENTIFIED, with_effects(with_inertials(urdf, of_urdf.inertias, removed), of_urdf.effects))
    write_text(folder / MJCF, mjcf(model.robot, of_mjcf.inertias, of_mjcf.effects, model.sensors, gravity))
    of_sidecar = reader if reader in held else URDF
    write_sidecar(folder / EFFECTS_FILE, model.robot.name, held[of_sidecar].effects, alone[of_sidecar].effects)
    return [folder / name for name in (ESTIMATE, IDENTIFIED, MJCF, EFFECTS_FILE)]


def _with_folded(effects: Sequence[KnownEffect], folded: Mapping[tuple[str, str], float]) -> list[KnownEffect]:
    """Effects as the files have them: of those that say an attribute the first has its change."""
    left = dict(folded)
    found = []
    for effect in effects:
        changes = {
            form.name: left.pop((effect.joint, form.urdf))
            for form in effect_class(effect.effect).parameters
            if (effect.joint, form.urdf) in left and form.name in effect.parameters
        }
        found.append(moved(effect, changes))
    return found


def moved(effect: KnownEffect, changes: Mapping[str, float]) -> KnownEffect:
    """An effect with parameters changed by so much, but to none that cannot be."""
    forms = {form.name: form for form in effect_class(effect.effect).parameters}
    values = {
        name: min(max(q.value + changes.get(name, 0.0), forms[name].above), forms[name].below)
        for name, q in effect.parameters.items()
    }
    return replace(effect, parameters={name: replace(q, value=values[name]) for name, q in effect.parameters.items()})


_There: TypeAlias = dict[tuple[Place, Effect, int], tuple[Coefficient, float]]


@dataclass(frozen=True, eq=False)
class WrittenModel:
    """The model that a file holds.

    Attributes:
        inertias: parameters ``(10,)`` in pinocchio's order, by link.
        effects: what the file says, and errors of sensors, which stand beside it.
        folded: by how much attributes of joints differ from these effects in a URDF and an MJCF, which cannot say all
            friction; by joint and attribute.
    """

    inertias: Mapping[str, FloatArray]
    effects: tuple[KnownEffect, ...]
    folded: Mapping[tuple[str, str], float] = field(default_factory=dict)

    @property
    def with_payloads_in_links(self) -> WrittenModel:
        """The same with payloads in the inertias of the links that carry them."""
        inertias = dict(self.inertias)
        for effect in self.effects:
            if is_body(effect):
                inertias[effect.link] = inertias[effect.link] + payload_parameters(values_of(effect))
        return WrittenModel(inertias, tuple(effect for effect in self.effects if not is_body(effect)))

    def said_by(self, elements: Collection[str]) -> WrittenModel:
        """The same without the effects of which a file with these ``elements`` says nothing, or only that they are
        nothing."""
        return replace(self, effects=tuple(effect for effect in self.effects if _is_said(effect, elements)))


def _is_said(effect: KnownEffect, elements: Collection[str]) -> bool:
    cls = effect_class(effect.effect)
    forms = [form for form in cls.parameters if form.name in effect.parameters]
    there = all(form.above < effect.parameters[form.name].value for form in forms)
    return there and (cls.of_sensor or any(form.said_by(elements) for form in forms))


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
    found = []
    for c, value in there.values():
        std = stds.get((c.effect.name, c.place_name, c.parameter), math.nan)
        found.append(KnownEffect(c.effect.name, c.place_name, "", c.parameters(value, std)))
    return WrittenModel(inertias, tuple(continued(combined([*found, *wholes]), known)))


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
    links = [link_entry(name, merged[name], own) for name, own in model.inertias.items()]
    return {"links": links, "effects": plain(model.effects)}


def written_for(file: EstimateFile, reader: str) -> WrittenModel | None:
    """The model that was fitted for a ``reader``; None if the file has none. Raises InputError for what cannot be."""
    alike = (name for name, elements in ELEMENTS.items() if elements == ELEMENTS.get(reader))
    found = next((file.handover[name] for name in alike if name in file.handover), None)
    if found is None:
        return None
    return WrittenModel(inertias_of(found.links, f"{file.source}: handover for {reader}"), found.effects)
