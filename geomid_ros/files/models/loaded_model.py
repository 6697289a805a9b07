"""An earlier model, as the starting point of a :class:`~geomid_ros.session.session.Session`.

The estimation begins with its inertias and effect coefficients. Its findings on sensors and gravity are applied:
efforts are divided by their gain and their delay is removed, offsets are subtracted from wrenches, gravity is tilted.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.estimation.estimate import LinksInformation
from geomid_ros.estimation.posterior import Posterior
from geomid_ros.files.models.effects_file import by_parameter, combined, is_payload_name, updated_effects
from geomid_ros.files.models.estimate_file import EffectFactors, EstimateFile
from geomid_ros.files.models.written_model import WrittenModel, fitted_model_of
from geomid_ros.model.channels import AXES, Channel, WrenchSensor
from geomid_ros.model.effects import Effect, IdentifiedEffect, KnownEffect, LoadEffect, SituationEffect
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.urdf_tree import UrdfTree
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.types import BoolArray, FloatArray


@dataclass(frozen=True)
class LoadedModel:
    """A model from the file ``source``: ``inertias (10,)`` of bodies by name, without payloads, and ``effects``.
    ``links_information`` is the joint information on these bodies, in their order. ``merged`` has the fixed links
    merged into them, if stated. ``warning`` is a sentence if its verdict makes the model doubtful. ``fitted_models``
    has the models fitted for descriptions, by reader; ``posterior`` is set for a model identified in this process.
    ``drives`` are gains of drives to predict with, and ``predictor`` the factors of the effects beside them."""

    source: str = ""
    inertias: Mapping[str, FloatArray] | None = None
    effects: tuple[KnownEffect, ...] = ()
    links_information: LinksInformation | None = None
    merged: Mapping[str, frozenset[str]] = field(default_factory=dict)
    warning: str = ""
    fitted_models: Mapping[str, WrittenModel] = field(default_factory=dict)
    posterior: Posterior | None = None
    drives: tuple[KnownEffect, ...] = ()
    predictor: tuple[EffectFactors, ...] = ()

    @staticmethod
    def read(path: str) -> LoadedModel:
        """Read an ``estimate.json``; without ``path``, nothing is known. Raises InputError naming file and fault."""
        return LoadedModel.of(EstimateFile.read(Path(path))) if path else LoadedModel()

    @staticmethod
    def of(file: EstimateFile) -> LoadedModel:
        """Convert the content of such a file. Raises InputError naming its fault."""
        models = {reader: fitted_model_of(file, reader) for reader in file.handover}
        fitted = {reader: written.with_payloads_in_links for reader, written in models.items() if written}
        return LoadedModel(
            source=file.source,
            inertias=file.inertias,
            effects=tuple(effect for effect in file.known_effects if effect.cls.has_columns),
            links_information=file.known_information,
            merged=file.merged,
            warning=file.warning,
            fitted_models=fitted,
            drives=tuple(effect for effect in file.known_effects if not effect.cls.has_columns),
            predictor=file.predictor,
        )

    @property
    def to_predict(self) -> LoadedModel:
        """The model with gains of drives, and with the effects beside them."""
        factors = {(e.effect, e.joint, name): factor for e in self.predictor for name, factor in e.factors.items()}
        beside = (
            replace(
                e, parameters={n: q.scaled(factors.get((e.effect, e.joint, n), 1.0)) for n, q in e.parameters.items()}
            )
            for e in self.effects
        )
        return replace(self, effects=(*beside, *self.drives))

    def refitted(
        self, model: MeasurementModel, coefficients: FloatArray, beside: Sequence[KnownEffect] = ()
    ) -> LoadedModel:
        """Return the effects with other coefficients, which keep their standard deviations; the result has no inertias.
        Payloads are dropped, as the links' inertias include them by then.

        Args:
            model: a measurement model.
            coefficients: coefficients of its effects; NaN or an invalid sign drops the effect.
            beside: the remaining ones of :attr:`situational_effects`.
        """
        within = self.coefficient_stds(model)[len(model.nominal_inertias) :]
        drift = [coefficient.effect.drift for coefficient in model.coefficients] * coefficients
        entries = [
            KnownEffect(c.effect.name, c.place_name, "", c.parameters(float(value), float(std)))
            for c, value, std in zip(model.coefficients, coefficients, np.hypot(within, drift), strict=True)
            if math.isfinite(value) and (value > 0.0 or not c.positive)
        ]
        fitted = {(entry.effect, entry.joint) for entry in entries}
        gone = {(effect.name, place) for effect, place, _ in self._coefficients} - fitted
        kept = [
            known for known in self.effects if not _is_situational(known) and (known.effect, known.joint) not in gone
        ]
        return LoadedModel(self.source, None, tuple(updated_effects(combined(entries), [*kept, *beside])))

    @property
    def situational_effects(self) -> list[KnownEffect]:
        """Effects in samples that no measurement model has as coefficients, as they depend on its state."""
        return [effect for effect in self.effects_in_samples if _is_situational(effect)]

    @property
    def not_predicted(self) -> str:
        """Sentence on known effects that cannot be predicted; empty if there are none."""
        names = [f"{effect.effect} of {effect.joint}" for effect in self.effects if _is_situational(effect)]
        return f"{self.source}: {', '.join(names)}: not predicted, only simulated with the MJCF" if names else ""

    @property
    def effects_in_samples(self) -> list[KnownEffect]:
        """Effects without payloads that remain in samples corrected by :meth:`corrected_signals` and
        :meth:`corrected_sensors`."""
        return [e for e in self.effects if not (e.is_payload or e.cls.corrected_in_samples)]

    def locked_joints(self, tree: UrdfTree) -> list[str]:
        """Names of a description's joints that were locked when the model was identified: the links at both ends were
        one body. Joints that mimic another one are locked with it."""
        bodies = [{name, *merged} for name, merged in self.merged.items()]
        moving = [joint for joint in tree.joints if joint.type != "fixed" and joint.mimic is None]
        return [joint.name for joint in moving if any({joint.parent, joint.child} <= links for links in bodies)]

    def corrected_sensors(self, sensors: Sequence[WrenchSensor]) -> list[WrenchSensor]:
        """Apply the known offsets to the sensors."""
        corrected = []
        for sensor in sensors:
            own = [effect for effect in self.effects if effect.joint == sensor.topic]
            shifts = [shift for e in own if (shift := e.cls.wrench_shift(e.values))]
            offset = tuple(sum(shift.get(axis, 0.0) for shift in shifts) for axis in AXES)
            corrected.append(replace(sensor, offset=offset) if shifts else sensor)
        return corrected

    def corrected_signals(self, settings: SignalSettings, joints: Sequence[str]) -> SignalSettings:
        """Apply the known gains and delays of the effort sensors to the settings."""
        given = settings.effort_gain
        by_joint = given if isinstance(given, dict) else dict.fromkeys(joints, given)
        gains = {joint: by_joint.get(joint, 1.0) / self._gains.get(joint, 1.0) for joint in joints}
        delay = sum(effect.cls.effort_lag(effect.values) for effect in self.effects)
        return replace(settings, effort_gain=gains if self._gains else given, effort_delay=delay)

    def drive_gains(self, channels: Sequence[Channel]) -> FloatArray:
        """Factors ``(channels,)`` of the links' efforts."""
        scales = [(known.joint, known.cls.load_scale(known.values)) for known in self.effects]
        by_joint = {joint: scale for joint, scale in scales if scale != 1.0}
        return np.array([by_joint.get(channel.name, 1.0) for channel in channels])

    @cached_property
    def _gains(self) -> dict[str, float]:
        """Factors from true to measured efforts by joint, where they are not 1."""
        scales = [(known.joint, known.cls.effort_scale(known.values)) for known in self.effects]
        return {joint: scale for joint, scale in scales if scale != 1.0}

    @cached_property
    def _coefficients(self) -> dict[tuple[IdentifiedEffect, str, str], float]:
        """Coefficients of effects that a measurement model can have, without gain error, by effect, place and
        parameter."""
        coefficients: dict[tuple[IdentifiedEffect, str, str], float] = {}
        for effect in self.effects_in_samples:
            for part, values in effect.cls.coefficients(effect.values).items():
                if isinstance(part, IdentifiedEffect):
                    for form, value in zip(part.column_parameters, values, strict=True):
                        key = part, effect.joint, form.name
                        coefficients[key] = coefficients.get(key, 0.0) + value
        return coefficients

    def local_effects(self, common: Collection[Effect]) -> dict[str, list[IdentifiedEffect]]:
        """Effects known at single places, by the place's name, in addition to the ``common`` ones of all places."""
        effects: dict[str, list[IdentifiedEffect]] = {}
        for effect, place in dict.fromkeys((effect, place) for effect, place, _ in self._coefficients):
            if effect not in common:
                effects.setdefault(place, []).append(effect)
        return effects

    def parameters(self, model: MeasurementModel) -> FloatArray | None:
        """Parameters ``(D,)`` of ``model``, NaN where nothing is known; None if nothing is known at all.

        Raises InputError if the model is of another robot, or if the values are invalid.
        """
        if self.inertias is None:
            return None
        if not self.inertias.keys() & set(model.body_names):
            names = f"{', '.join(self.inertias) or 'none'}; those of this robot: {', '.join(model.body_names)}"
            raise InputError(f"{self.source}: an estimate of another robot. Its links: {names}")
        self._check_merged(model)
        carriers = [name for name in model.body_names if name in self.inertias]
        for effect in self.effects:
            if effect.is_payload and effect.link not in carriers:
                raise InputError(f"{self.source}: {unknown_name('link with a payload', effect.link, carriers)}")
        inertias = WrittenModel(self.inertias, self.effects).with_payloads_in_links.inertias
        stored = self._coefficients
        coefficients = np.array([stored.get((c.effect, c.place_name, c.parameter), np.nan) for c in model.coefficients])
        positive = np.array([c.effect.column_parameters[c.index].above == 0.0 for c in model.coefficients], dtype=bool)
        if np.any(coefficients[positive] <= 0.0) or np.any(np.isinf(coefficients)):
            raise InputError(f"{self.source}: an effect that must be positive and finite is not")
        return np.concatenate([*(inertias.get(name, np.full(10, np.nan)) for name in model.body_names), coefficients])

    def shape_mask(self, model: MeasurementModel) -> BoolArray:
        """Boolean mask ``(coefficients,)`` of ``model``: False for another shape of a mechanism that is known."""
        pairs = [(c.mechanism, (c.effect, c.place_name, c.parameter) in self._coefficients) for c in model.coefficients]
        mechanisms = {mechanism for mechanism, is_known in pairs if is_known}
        return np.array([is_known or mechanism not in mechanisms for mechanism, is_known in pairs], dtype=bool)

    def _check_merged(self, model: MeasurementModel) -> None:
        """Raise InputError if a body consists of other links than the body of this name in the file. Links without a
        mass in this description belong to no body, and a payload in the file may be a link here."""
        moving = {link for body in model.robot.bodies for link in (body.name, *body.merged)}
        carriers = {effect.link for effect in self.effects if effect.is_payload}
        for body in (model.robot.bodies[place] for place in model.identified):
            current = {*body.merged}
            if body.name in carriers:  # a description that was written from this model has the payload as a link
                current -= {link for link in body.merged if is_payload_name(link, body.name)}
            recorded = self.merged.get(body.name, current)
            if recorded & moving != current:
                then, now = (", ".join(sorted(links)) or "no other link" for links in (recorded, current))
                raise InputError(
                    f"{self.source}: link '{body.name}' was identified together with {then}, here it moves with {now}: "
                    "declare the same mounted wrench sensors and locked joints as then"
                )

    def coefficient_stds(self, model: MeasurementModel) -> FloatArray:
        """Standard deviations ``(D,)`` of the effects' coefficients within their motion, NaN if unknown."""
        sizes = by_parameter(self.effects)
        places = [(c.effect, (c.effect.name, c.place_name, c.parameter)) for c in model.coefficients]
        stds = [effect.within_motion(sizes[place]) if place in sizes else math.nan for effect, place in places]
        return np.concatenate([np.full(len(model.nominal_inertias), np.nan), stds])

    def information(self, model: MeasurementModel) -> LinksInformation | None:
        """Joint information on all identified bodies of ``model``, in their order; None if there is none, or if some of
        the bodies were not identified.

        Links that are not identified here are fixed at their estimates.
        """
        if self.links_information is None or self.inertias is None or not {*model.body_names} <= self.inertias.keys():
            return None
        places = [10 * list(self.inertias).index(name) for name in model.body_names]
        rows = np.concatenate([self.links_information.rows[:, place : place + 10] for place in places], axis=1)
        return LinksInformation(rows, self.links_information.residuals)


def _is_situational(effect: KnownEffect) -> bool:
    cls = effect.cls
    identified = issubclass(cls, LoadEffect) or cls.corrected_in_samples or cls.compensated_in_samples
    return issubclass(cls, SituationEffect) and not identified
