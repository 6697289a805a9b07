"""Files of the model with the gap workflow's findings: ``estimate.json``, URDF, MJCF and the sidecar of effects.

``estimate.json`` is an ordinary :class:`~geomid_ros.files.models.estimate_file.EstimateFile` without the standard
deviations of links. It also has the ``floor``: the standard deviation of each channel's noise [N m, N] below the
``cutoff`` [Hz], in which ``geomid verify`` expresses the errors.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from geomid_ros.checks.causes import RecordingFault
from geomid_ros.checks.verdict import recording_verdict
from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.tolerances import SETTLED
from geomid_ros.files.disk import write_json, write_text
from geomid_ros.files.models.effects_file import combined, effects_entries, updated_effects, write_sidecar
from geomid_ros.files.models.estimate_file import EstimateFile, inertias_of, link_entry, verdict_entry
from geomid_ros.files.models.mjcf import Shapes, mjcf
from geomid_ros.files.models.readers import ELEMENTS, READERS, URDF, with_same_files
from geomid_ros.files.models.urdf import with_absolute_files, with_effects, with_inertials
from geomid_ros.files.schema import FORMAT, to_document
from geomid_ros.model.coefficients import Coefficient
from geomid_ros.model.effects import Effect, KnownEffect, Place
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.types import FloatArray

ESTIMATE, IDENTIFIED, MJCF, EFFECTS_FILE = "estimate.json", "identified.urdf", "identified.xml", "effects.yaml"


@dataclass(frozen=True)
class ModelFiles:
    """An MJCF and its sidecar of effects."""

    mjcf: Path
    effects: Path

    @staticmethod
    def of(folder: Path) -> ModelFiles:
        """Paths of the files that :func:`write_model` writes into a folder."""
        return ModelFiles(folder / MJCF, folder / EFFECTS_FILE)


def write_model(
    folder: Path,
    model: MeasurementModel,
    urdf: str,
    inertias: Mapping[str, FloatArray],
    effects: Iterable[KnownEffect],
    gravity: FloatArray,
    findings: Sequence[RecordingFault] = (),
    noise: Mapping[str, Any] = MappingProxyType({}),
    folded: Mapping[tuple[str, str], float] = MappingProxyType({}),
    fitted: Mapping[str, WrittenModel] = MappingProxyType({}),
    reader: str = URDF,
    shapes: Shapes | None = None,
) -> list[Path]:
    """Write the model with ``inertias (10,)`` of identified bodies by name and all of its ``effects`` into ``folder``;
    returns the files. ``fitted`` are the models that descriptions contain instead, by reader. The sidecar is that of
    one ``reader``.

    ``gravity (3,)`` is that of an upright base. ``findings`` are the suspected faults of the model's recording,
    ``noise`` its floor by channel and its cutoff, if known. ``folded`` is the model's, see :class:`WrittenModel`. The
    MJCF has the ``shapes``.
    Duplicate effects are merged, see :func:`~geomid_ros.files.models.effects_file.combined`.
    """
    effects = combined(effects)
    full = WrittenModel(inertias, tuple(effects), folded)
    models = {name: fitted.get(name, full) for name in READERS}
    alone = {name: replace(m, effects=tuple(_with_folded(m.effects, m.folded))) for name, m in models.items()}
    merged = {body.name: body.merged for body in model.robot.bodies if body.name in inertias}
    links, removed = model.robot.as_links(alone[URDF].inertias), model.robot.included_links(inertias)
    document = {
        "format": FORMAT,
        "links": [link_entry(name, merged[name], m) for name, m in inertias.items()],
        **effects_entries(effects),
        "handover": {name: handover_entry(m.representable_in(ELEMENTS[name]), merged) for name, m in alone.items()},
        "robot": model.robot.name,
        "gravity": gravity.tolist(),
        "verdict": verdict_entry(recording_verdict(findings), findings),
    }
    write_json(folder / ESTIMATE, document | dict(noise))
    of_urdf, of_mjcf = alone[URDF], alone["mujoco"]
    whole = with_absolute_files(urdf, model.robot.source)
    write_text(folder / IDENTIFIED, with_effects(with_inertials(whole, links, removed), of_urdf.effects))
    write_text(folder / MJCF, mjcf(model.robot, of_mjcf.inertias, of_mjcf.effects, model.sensors, gravity, shapes))
    of_sidecar = with_same_files(reader)
    in_sidecar = models[of_sidecar].effects, alone[of_sidecar].effects
    write_sidecar(folder / EFFECTS_FILE, model.robot.name, *in_sidecar, estimated=effects)
    return [folder / name for name in (ESTIMATE, IDENTIFIED, MJCF, EFFECTS_FILE)]


def _with_folded(effects: Sequence[KnownEffect], folded: Mapping[tuple[str, str], float]) -> list[KnownEffect]:
    """Add the folded changes of joint attributes, each to the first effect that has the attribute."""
    remaining = dict(folded)
    shifted = []
    for effect in effects:
        changes = {
            form.name: remaining.pop((effect.joint, form.urdf))
            for form in effect.cls.parameters
            if (effect.joint, form.urdf) in remaining and form.name in effect.parameters
        }
        shifted.append(with_shifted_parameters(effect, changes))
    return shifted


def with_shifted_parameters(effect: KnownEffect, changes: Mapping[str, float]) -> KnownEffect:
    """Change parameters of an effect by these amounts, limited to valid values."""
    forms = {form.name: form for form in effect.cls.parameters}
    values = {
        name: min(max(q.value + changes.get(name, 0.0), forms[name].above), forms[name].below)
        for name, q in effect.parameters.items()
    }
    return replace(effect, parameters={name: replace(q, value=values[name]) for name, q in effect.parameters.items()})


_Values: TypeAlias = dict[tuple[Place, Effect, int], tuple[Coefficient, float]]


@dataclass(frozen=True, eq=False)
class WrittenModel:
    """The model that a file contains.

    Attributes:
        inertias: parameters ``(10,)`` in pinocchio's order, by link.
        effects: effects in the file, and the sensor errors, which are in the sidecar.
        folded: differences of joint attributes in a URDF and an MJCF from these effects, as these formats cannot
            represent all friction; by joint and attribute.
    """

    inertias: Mapping[str, FloatArray]
    effects: tuple[KnownEffect, ...]
    folded: Mapping[tuple[str, str], float] = field(default_factory=dict)

    @property
    def with_payloads_in_links(self) -> WrittenModel:
        """The model, without ``folded``, with payloads added to the inertias of their links."""
        inertias = dict(self.inertias)
        for effect in self.effects:
            if effect.is_payload:
                inertias[effect.link] = inertias[effect.link] + effect.body
        return WrittenModel(inertias, tuple(effect for effect in self.effects if not effect.is_payload))

    def representable_in(self, elements: Collection[str]) -> WrittenModel:
        """Return the model without effects that are zero, or that a file with these ``elements`` cannot represent."""
        return replace(self, effects=tuple(effect for effect in self.effects if _is_representable(effect, elements)))


def _is_representable(effect: KnownEffect, elements: Collection[str]) -> bool:
    cls = effect.cls
    forms = [form for form in cls.parameters if form.name in effect.parameters]
    nonzero = all(form.above < effect.parameters[form.name].value for form in forms)
    return nonzero and (cls.is_sensor_error or any(form.said_by(elements) for form in forms))


def written_model(
    model: MeasurementModel, estimate: Estimate, reader: str, known: Sequence[KnownEffect] = ()
) -> WrittenModel:
    """Make the model that is written for a ``reader``.

    Args:
        model: the model that was identified.
        estimate: the estimate; it is used unchanged if nothing was fitted for this reader.
        reader: one of :data:`ELEMENTS`.
        known: the effects of the model that the estimation began with.
    """
    parameters = estimate.within.get(reader, estimate.parameters)
    first = len(model.nominal_inertias)
    inertias = dict(zip(model.body_names, parameters[:first].reshape(-1, 10), strict=True))
    pairs = zip(model.coefficients, parameters[first:].tolist(), strict=True)
    values: _Values = {(c.place, c.effect, c.index): (c, value) for c, value in pairs if value}
    composites = [joined for key in list(values) if (joined := _whole(values, key, ELEMENTS[reader])) is not None]
    estimated = {(effect.name, effect.joint, effect.parameter): effect for effect in estimate.effects}
    effects = []
    for c, value in values.values():
        own = estimated.get((c.effect.name, c.place_name, c.parameter))
        std = own.std if own is not None and abs(value - own.value) <= SETTLED * own.std else math.nan  # of this value
        effects.append(KnownEffect(c.effect.name, c.place_name, "", c.parameters(value, std)))
    return WrittenModel(inertias, tuple(updated_effects(combined([*effects, *composites]), known)))


def _whole(values: _Values, key: tuple[Place, Effect, int], elements: Collection[str]) -> KnownEffect | None:
    """Merge the parts of a composite effect, if all are present and the file can represent its parameters: a spring's
    offset becomes its rest position. The parts are removed. None for other effects."""
    place, effect, _ = key
    parts = [(place, part, 0) for part in effect.parts]
    representable = all(form.said_by(elements) for form in effect.parameters[: len(parts)])
    if len(parts) < 2 or not representable or not all(part in values for part in parts):
        return None
    name, sliding = values[key][0].place_name, effect.parameters[0].slides_by(values[key][0].unit)
    coefficients = np.array([values.pop(part)[1] for part in parts])
    quantities = effect.quantities(coefficients, np.full((len(parts), len(parts)), math.nan), sliding=sliding)
    return KnownEffect(effect.name, name, "", quantities)


def handover_entry(model: WrittenModel, merged: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """Entry of ``estimate.json`` for the model that a file contains."""
    links = [link_entry(name, merged[name], parameters) for name, parameters in model.inertias.items()]
    return {"links": links, "effects": to_document(model.effects)}


def fitted_model_of(file: EstimateFile, reader: str) -> WrittenModel | None:
    """Model that was fitted for a ``reader``; None if the file has none. Raises InputError if it is invalid."""
    handover, source = file.handover.get(with_same_files(reader)), f"{file.source}: handover for {reader}"
    if handover is None:
        return None
    inertias = inertias_of(handover.links, source)
    links = {*inertias, *(effect.link for effect in handover.effects if effect.is_payload)}
    if links != file.inertias.keys():
        here, expected = (", ".join(sorted(names)) for names in (links, file.inertias))
        raise InputError(f"{source}: its links are {here}; expected {expected}")
    return WrittenModel(inertias, handover.effects)
