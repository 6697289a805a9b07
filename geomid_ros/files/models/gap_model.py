"""The model with what the gap workflow found, as files: ``estimate.json``, URDF, MJCF and the sidecar of effects.

``estimate.json`` is an :class:`~geomid_ros.files.models.estimate_file.EstimateFile` like any other, with less in it (no
standard deviations of links); and the ``floor``, the standard deviation of each channel's noise [N m, N] below the
``cutoff`` [Hz], in which ``geomid verify`` judges it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from geomid_ros.checks.causes import Finding
from geomid_ros.checks.verdict import recording_verdict
from geomid_ros.files.disk import write_json, write_text
from geomid_ros.files.models.effect_forms import combined, is_coefficient
from geomid_ros.files.models.estimate_file import FORMAT, by_channel, link_entry, verdict_entry
from geomid_ros.files.models.mjcf import mjcf
from geomid_ros.files.models.sidecar import coefficient_entry, effect_entry, write_sidecar
from geomid_ros.files.models.urdf import inertia_of, with_effects, with_inertials
from geomid_ros.model.effects import KnownEffect, effect_class
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray

ESTIMATE, URDF, MJCF, EFFECTS_FILE = "estimate.json", "identified.urdf", "identified.xml", "effects.yaml"
_NOTHING: Mapping[tuple[str, str], float] = {}


@dataclass(frozen=True)
class ModelFiles:
    """An MJCF and, if there is one, its sidecar of effects."""

    mjcf: Path
    effects: Path | None = None


@dataclass(frozen=True, eq=False)
class NoiseFloor:
    """The noise's standard deviation in each of ``channels``, ``stds (C,)``, below the ``cutoff`` [Hz]."""

    channels: Sequence[str]
    stds: FloatArray
    cutoff: float


def write_model(
    folder: Path,
    model: MeasurementModel,
    urdf: str,
    inertias: Mapping[str, FloatArray],
    effects: Iterable[KnownEffect],
    gravity: FloatArray,
    findings: Sequence[Finding] = (),
    floor: NoiseFloor | None = None,
    folded: Mapping[tuple[str, str], float] = _NOTHING,
) -> list[Path]:
    """Write the model with ``inertias (10,)`` of identified bodies by name and all of its ``effects`` into ``folder``;
    returns the files.

    ``gravity (3,)`` is that of a base which stands straight; ``findings`` are what seems to be wrong with the recording
    that the model is from, whose ``floor`` is written if it is known; ``folded``: by how much attributes of joints
    differ in URDF and MJCF, which cannot say all friction. Of effects that are there twice, see
    :func:`~geomid_ros.files.models.effect_forms.combined`.
    """
    effects = combined(effects)
    alone = _with_folded(effects, folded)
    bodies = {name: inertia_of(parameters) for name, parameters in inertias.items()}
    merged = {body.name: body.merged for body in model.robot.bodies if body.name in bodies}
    removed = [name for names in merged.values() for name in names]
    noise = {} if floor is None else {"floor": by_channel(floor.channels, floor.stds), "cutoff": floor.cutoff}
    document = {
        "format": FORMAT,
        "links": [link_entry(name, merged[name], inertia) for name, inertia in bodies.items()],
        "effects": [coefficient_entry(effect) for effect in effects if is_coefficient(effect)],
        "added": [effect_entry(effect) for effect in effects if not is_coefficient(effect)],
        "robot": model.robot.name,
        "verdict": verdict_entry(recording_verdict(findings), findings),
    }
    write_json(folder / ESTIMATE, document | noise)
    write_text(folder / URDF, with_effects(with_inertials(urdf, bodies, removed), alone))
    write_text(folder / MJCF, mjcf(model.robot, inertias, alone, model.sensors, gravity))
    write_sidecar(folder / EFFECTS_FILE, model.robot.name, effects, alone)
    return [folder / name for name in (ESTIMATE, URDF, MJCF, EFFECTS_FILE)]


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
        changed = {name: replace(q, value=q.value + changes.get(name, 0.0)) for name, q in effect.parameters.items()}
        found.append(replace(effect, parameters=changed))
    return found


def model_files(folder: Path) -> ModelFiles:
    """The files of :func:`write_model` in ``folder`` that a simulation needs."""
    return ModelFiles(folder / MJCF, folder / EFFECTS_FILE)
