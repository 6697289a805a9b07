"""``estimate.json``: its schema, an estimate for people and programs, and its use as a starting point."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from geomid_ros.checks.causes import RecordingFault
from geomid_ros.checks.verdict import NOT_CONVERGED, STATUS, USABLE, Verdict
from geomid_ros.errors import InputError, check_name, refusing, unknown_name
from geomid_ros.estimation.comparison import RobotValues
from geomid_ros.estimation.estimate import (
    FINEST,
    EffectEstimate,
    Estimate,
    LinkEstimate,
    LinksInformation,
    WeighedEstimate,
)
from geomid_ros.files.disk import read_text
from geomid_ros.files.models.effects_file import check_quantity, combined, effects_entries, updated_effects
from geomid_ros.files.schema import (
    FORMAT,
    Matrix,
    Vector,
    attributes_entry,
    from_base64,
    from_document,
    parse_document,
    to_base64,
    to_document,
    triangle_from_base64,
    upper_triangle,
)
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.model.effects import KnownEffect, effect_class, identifiable
from geomid_ros.model.effects.parameters import quantities
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import GRAVITY
from geomid_ros.signals.ledger import Account
from geomid_ros.types import FloatArray

_MOST_LINKS_TOGETHER = 100  # for more links, their joint information would be most of the file
_PACKED = "<f4"  # seven digits suffice, and nobody reads so many numbers
OF_PAGE = (
    *("robot", "rms", "sigma", "channels", "seconds", "steps", "gamma", "rows", "known", "urdf_masses"),
    *("warnings", "notes", "telling", "messages", "origin"),
)
"""Keys that a page requires."""
ByChannel: TypeAlias = Mapping[str, float]
_WITHOUT_INFORMATION = "identify again, or delete 'information', without which less is known of payloads"


@dataclass(frozen=True, eq=False, kw_only=True)
class InertiaEntry:
    """A body's mass [kg], centre of mass [m] and inertia about it [kg m^2], or the standard deviations of these."""

    mass: float
    com: Vector
    inertia: Matrix

    @property
    def quantities(self) -> FloatArray:
        """These numbers ``(10,)`` in the order of :func:`~geomid_ros.geometry.pseudo_inertia.quantities_of`."""
        return np.concatenate([[self.mass], self.com, pseudo_inertia.inertia_entries(self.inertia)])


@dataclass(frozen=True, eq=False, kw_only=True)
class LinkEntry(InertiaEntry):
    """A link. The model written by ``geomid gap`` has only its inertia and ``merged``; an estimate has all fields."""

    name: str
    merged: tuple[str, ...] | None = None
    std: InertiaEntry | None = None
    distance_from_prior: float = math.nan
    from_data: float = math.nan
    min_eigenvalue_ratio: float = math.nan
    cannot_tell: tuple[str, ...] | None = None
    identified_moments: tuple[str, ...] = ()
    outlier: bool = False


@dataclass(frozen=True, kw_only=True)
class AddedEffect(KnownEffect):
    """An effect that is no single coefficient at a joint; ``from_data``: see :class:`CoefficientEntry`."""

    from_data: float = math.nan


@dataclass(frozen=True, kw_only=True)
class CoefficientEntry:
    """An effect of one coefficient at a joint; ``from_data``: fraction of its prior variance that the data removed."""

    name: str
    joint: str
    value: float
    std: float = math.nan
    unit: str = ""
    from_data: float = math.nan


@dataclass(frozen=True, kw_only=True)
class VerdictEntry:
    """A verdict and its reasons."""

    result: str
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class InformationEntry:
    """Joint information on all ``links``: an upper triangle and residuals, float32 in base64."""

    links: tuple[str, ...]
    rows: str
    residuals: str


@dataclass(frozen=True, kw_only=True)
class HandoverEntry:
    """The model that was fitted for a reader of descriptions, and its file name."""

    links: tuple[LinkEntry, ...]
    effects: tuple[KnownEffect, ...]
    file: str = ""


@dataclass(frozen=True, kw_only=True)
class EffectFactors:
    """Factors by which the parameters of an effect differ beside the gains of the drives."""

    effect: str
    joint: str = ""
    factors: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class ErrorsEntry:
    """RMS residuals by channel."""

    nominal: ByChannel = field(default_factory=dict)
    train: ByChannel = field(default_factory=dict)
    held_out: ByChannel | None = None


@dataclass(frozen=True, kw_only=True)
class RowsEntry:
    """Counts of accepted and rejected rows."""

    accepted: int | None = None
    rejected: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class ChannelEntry:
    """Fit of a channel: RMS residuals of the URDF, of the estimate, and of the written description, without and with
    sensor offsets."""

    channel: str
    unit: str = ""
    urdf: float = math.nan
    identified: float = math.nan
    file: float = math.nan
    file_with_offsets: float = math.nan

    @property
    def ratio(self) -> float:
        """RMS of the estimate divided by that of the URDF: below 1 is better; NaN if undefined."""
        return self.identified / self.urdf if self.urdf > 0.0 else math.nan


@dataclass(frozen=True, eq=False, kw_only=True)
class EstimateFile:
    """A file written by ``geomid identify`` or ``geomid gap``, or by a person, with as much as is known.

    ``source`` names it in messages; ``document`` is its full content. A node's message has the identified URDF as its
    ``robot_description``. Properties raise InputError for invalid content.
    Only files of ``geomid identify`` have everything that a page shows (:data:`OF_PAGE`).
    """

    source: str
    document: Mapping[str, Any]
    links: tuple[LinkEntry, ...]
    effects: tuple[CoefficientEntry, ...]
    added: tuple[AddedEffect, ...] = ()
    robot: str = ""
    robot_description: str = ""
    converged: bool = True
    reason: str = ""
    verdict: VerdictEntry = VerdictEntry(result="")
    gravity: Vector = field(default_factory=GRAVITY.copy)
    information: InformationEntry | None = None
    handover: Mapping[str, HandoverEntry] = field(default_factory=dict)
    predictor: tuple[EffectFactors, ...] = ()
    rms: ErrorsEntry = ErrorsEntry()
    sigma: ByChannel = field(default_factory=dict)
    floor: ByChannel = field(default_factory=dict)
    cutoff: float | None = None
    channels: tuple[ChannelEntry, ...] = ()
    seconds: float = math.nan
    steps: int | None = None
    gamma: float = math.nan
    rows: RowsEntry = RowsEntry()
    known: tuple[WeighedEstimate, ...] = ()
    urdf_masses: ByChannel = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    telling: Mapping[str, Mapping[str, tuple[str, ...]]] = field(default_factory=dict)
    messages: Mapping[str, Account] = field(default_factory=dict)
    origin: Mapping[str, Any] = field(default_factory=dict)

    @staticmethod
    def read(path: Path) -> EstimateFile:
        """Read a file. Raises InputError naming it and the key that is wrong."""
        return EstimateFile.parse(read_text(path, "model"), str(path))

    @staticmethod
    def parse(text: str, source: str) -> EstimateFile:
        """Read the text of a file. Raises InputError naming the ``source`` and the key that is wrong."""
        return EstimateFile.of(parse_document(text, source, "model", ("links", "effects")), source)

    @staticmethod
    def of(document: Mapping[str, Any], source: str) -> EstimateFile:
        """Read the content of a file. Raises InputError naming the ``source``."""
        return from_document(EstimateFile, {**document, "source": source, "document": document}, f"{source}:")

    @cached_property
    def inertias(self) -> dict[str, FloatArray]:
        """Parameters ``(10,)`` of the links in pinocchio's order, by name."""
        return inertias_of(self.links, self.source)

    @property
    def merged(self) -> dict[str, frozenset[str]]:
        """Fixed links that are merged into each link, as far as the file states them."""
        return {link.name: frozenset(link.merged) for link in self.links if link.merged is not None}

    @property
    def known_effects(self) -> list[KnownEffect]:
        """All effects."""
        single = [
            _known_effect(coefficient, raw, f"{self.source}:")
            for coefficient, raw in zip(self.effects, self.document["effects"], strict=True)
        ]
        return combined([*single, *self.added])

    @property
    def judgement(self) -> Verdict:
        """The verdict; a file without one is usable if its solver converged."""
        if "verdict" not in self.document:
            word = USABLE if self.converged else NOT_CONVERGED
            return Verdict(word=word, reasons=() if self.converged else (self.reason,))
        check_name("verdict", self.verdict.result, STATUS, self.source)
        return Verdict(word=self.verdict.result, reasons=self.verdict.reasons)

    @property
    def judged_on(self) -> str:
        """Name of the data on which the errors by channel are computed."""
        return "the fitted data" if self.rms.held_out is None else "held-out data"

    @property
    def description(self) -> str:
        """File name of the description that was written with it."""
        return next((entry.file for entry in self.handover.values() if entry.file), "identified.urdf")

    @property
    def doubts(self) -> list[str]:
        """Reasons not to use the estimate, each after its file; none if it is usable."""
        return [f"{self.source}: {reason}" for reason in self._doubts]

    @property
    def warning(self) -> str:
        """Sentence on why the estimate should not be used; empty if it is usable."""
        reasons = "; ".join(self._doubts)
        return f"{self.source}: this model's verdict is '{self.judgement.word}': {reasons}" if reasons else ""

    @property
    def _doubts(self) -> tuple[str, ...]:
        verdict = self.judgement
        return () if verdict.word == USABLE else verdict.reasons or ("no reason is given",)

    @cached_property
    def bodies(self) -> dict[str, LinkEstimate]:
        """Links with their uncertainty, by name, as far as the file states it."""
        unknown = np.full(13, np.nan)  # of quantities and first moments: no file has them
        return {
            link.name: LinkEstimate(
                name=link.name,
                merged=link.merged or (),
                parameters=self.inertias[link.name],
                std=unknown[:10] if link.std is None else link.std.quantities,
                distance_from_prior=link.distance_from_prior,
                from_data=link.from_data,
                min_eigenvalue_ratio=link.min_eigenvalue_ratio,
                cannot_tell=link.cannot_tell or (),
                moments=link.identified_moments,
                std_doubted=unknown,
                std_prior=unknown,
                outlier=link.outlier,
            )
            for link in self.links
        }

    @property
    def values(self) -> RobotValues:
        """Values to compare with those of another estimate."""
        return RobotValues(links=self.bodies, effects=tuple(self.known_effects), information=self.known_information)

    @property
    def known_information(self) -> LinksInformation | None:
        """Joint information on the links, in their order; None if there is none."""
        if self.information is None:
            return None
        size = 10 * len(self.links)
        information = f"{self.source}: the information on {len(self.links)} links"
        with refusing(f"{information} cannot be read", ValueError, advice=_WITHOUT_INFORMATION):
            rows = triangle_from_base64(self.information.rows, _PACKED, size)
            residuals = from_base64(self.information.residuals, _PACKED, size)
        if list(self.information.links) != list(self.inertias):
            raise InputError(f"{information} is on other links, or in another order; {_WITHOUT_INFORMATION}")
        manifold = ParameterManifold(len(self.links), 0, np.zeros(0))
        with np.errstate(all="ignore"):  # for extreme bodies; results that are not numbers are refused
            whitened = manifold.whiten(manifold.point(np.concatenate([*self.inertias.values()])), rows)
        # The rows are rounded to seven digits.
        if not np.all(np.abs(whitened) < 2.0 * FINEST) or not np.all(np.isfinite(residuals)):
            raise InputError(f"{information} is more precise than any measurement; {_WITHOUT_INFORMATION}")
        return LinksInformation(rows, residuals)

    @property
    def link_estimates(self) -> list[LinkEstimate]:
        """Estimates of the links. Raises InputError for a link with missing entries."""
        for link in self.links:
            if link.std is None or link.merged is None or link.cannot_tell is None:
                raise InputError(f"{self.source}: link '{link.name}' has no std, merged or cannot_tell")
        return [*self.bodies.values()]

    @property
    def effect_estimates(self) -> list[EffectEstimate]:
        """Effects for which the file states how informative the data were."""
        shares = {(entry.name, entry.joint): entry.from_data for entry in self.effects}
        shares |= {(entry.effect, entry.joint): entry.from_data for entry in self.added}
        return [
            EffectEstimate(name=effect.effect, joint=effect.joint, parameters=effect.parameters, from_data=share)
            for effect in self.known_effects
            if math.isfinite(share := shares[effect.effect, effect.joint])
        ]


def inertias_of(links: Sequence[LinkEntry], source: str) -> dict[str, FloatArray]:
    """Parameters ``(10,)`` of links in pinocchio's order, by name. Raises InputError for an inconsistent one."""
    inertias: dict[str, FloatArray] = {}
    for link in links:
        if link.name in inertias:
            raise InputError(f"{source}: there are two links '{link.name}', expected each once")
        inertias[link.name] = pseudo_inertia.assemble(np.array(link.mass), link.com, link.inertia)
        matrix = pseudo_inertia.from_parameters(inertias[link.name])
        if not np.all(np.isfinite(matrix)) or not np.linalg.eigvalsh(matrix)[0] > 0.0:
            raise InputError(f"{source}: the inertia of link '{link.name}' is not physically consistent")
    return inertias


def _known_effect(entry: CoefficientEntry, raw: Mapping[str, Any], source: str) -> KnownEffect:
    """Effect of one coefficient. A constant other than the default is in the ``raw`` entry under its name."""
    if entry.name not in identifiable():
        raise InputError(f"{source} {unknown_name('effect', entry.name, identifiable())}")
    cls = effect_class(entry.name)
    if not cls.is_one_number():
        raise InputError(f"{source} effect '{entry.name}' has several parameters, expected it under 'added'")
    if not math.isfinite(entry.value):
        raise InputError(f"{source} {entry.name} at '{entry.joint}' has no value, expected a finite number")
    first, *constants = cls.parameters
    sliding = first.slides_by(entry.unit)
    parameters = quantities([first], [(entry.value, entry.std or math.nan)], sliding=sliding)
    for form in constants:
        if form.name in raw:
            where = f"{source} {form.name} of {cls.name} at '{entry.joint}'"
            parameters |= quantities([form], [(from_document(float, raw[form.name], where), 0.0)], sliding=sliding)
            check_quantity(parameters[form.name], form, where)
    return KnownEffect(entry.name, entry.joint, "", parameters)


def estimate_document(
    estimate: Estimate,
    rows_rejected: Mapping[str, int],
    held_out: FloatArray | None = None,
    known: Sequence[KnownEffect] = (),
) -> dict[str, Any]:
    """Make the document of an estimate.

    Args:
        estimate: the estimate.
        rows_rejected: numbers of rows that were not used, by reason.
        held_out: RMS residuals ``(channels,)`` on data that were not fitted, if any were held out.
        known: the effects of the model that the estimation began with.
    """
    rms = {"nominal": estimate.rms_nominal, "train": estimate.rms, "held_out": held_out}
    rejected = {reason: count for reason, count in sorted(rows_rejected.items()) if count}
    information = {
        "links": [link.name for link in estimate.links],
        "rows": to_base64(upper_triangle(estimate.information.rows), _PACKED),
        "residuals": to_base64(estimate.information.residuals, _PACKED),
    }
    return {
        "format": FORMAT,
        **attributes_entry(estimate, "converged", "reason"),
        "seconds": round(estimate.seconds, 3),
        **attributes_entry(estimate, "steps", "gamma"),
        "rows": {"accepted": estimate.rows_accepted, "set_aside": estimate.rows_set_aside, "rejected": rejected},
        "links": [
            link_entry(link.name, link.merged, link.parameters)
            | {"std": to_document({"mass": link.std_mass, "com": link.std_com, "inertia": link.std_inertia})}
            | attributes_entry(link, "distance_from_prior", "from_data", "min_eigenvalue_ratio", "cannot_tell")
            | {"identified_moments": [*link.moments], "outlier": link.outlier}
            for link in estimate.links
        ],
        **effects_entries(model_effects(estimate, known), shares_from_data(estimate)),
        "known": [attributes_entry(mass, "name", "mass", "std", "given", "given_std") for mass in estimate.known],
        "rms": {
            kind: None if values is None else by_channel(estimate.channels, values) for kind, values in rms.items()
        },
        "sigma": by_channel(estimate.channels, estimate.sigmas),
        "information": information if len(estimate.links) <= _MOST_LINKS_TOGETHER else None,
    }


def predictor_entry(model: MeasurementModel, estimate: Estimate) -> list[dict[str, Any]]:
    """Entry for the factors of an estimate's effects in its predictions."""
    values = zip(estimate.parameters, estimate.predictor.parameters, strict=True)
    pairs = zip(model.coefficients, list(values)[len(model.nominal_inertias) :], strict=True)
    factors = ((c, float(beside / alone)) for c, (alone, beside) in pairs if alone)
    return [{"effect": c.effect.name, "joint": c.place_name, "factors": {c.parameter: f}} for c, f in factors]


def shares_from_data(estimate: Estimate) -> dict[tuple[str, str], float]:
    """Fraction of the prior variance that the data removed, by effect and place: the mean over its coefficients."""
    fractions: dict[tuple[str, str], list[float]] = {}
    for effect in estimate.effects:
        fractions.setdefault((effect.name, effect.joint), []).append(effect.from_data)
    return {key: float(np.mean(values)) for key, values in fractions.items()}


def model_effects(estimate: Estimate, known: Sequence[KnownEffect]) -> list[KnownEffect]:
    """All effects, as in files, of the model of an estimate that began with the ``known`` ones."""
    estimated = combined(KnownEffect(effect.name, effect.joint, "", effect.parameters) for effect in estimate.effects)
    return updated_effects(estimated, known)


def link_entry(name: str, merged: Sequence[str], parameters: FloatArray) -> dict[str, Any]:
    """Entry of a link with parameters ``(10,)`` and the fixed links merged into it."""
    com, inertia = pseudo_inertia.centre_of_mass(parameters), pseudo_inertia.central_inertia(parameters)
    entry = {"name": name, "merged": [*merged], "mass": parameters[0], "com": com, "inertia": inertia}
    return {key: to_document(value) for key, value in entry.items()}


def by_channel(channels: Sequence[str], values: FloatArray) -> dict[str, float | None]:
    """Values by channel name; NaN and infinity become null."""
    return dict(zip(channels, to_document(values), strict=True))


def verdict_entry(verdict: Verdict, findings: Sequence[RecordingFault]) -> dict[str, Any]:
    """Verdict on the result, its reasons, and the suspected causes in the recording."""
    return {"result": verdict.word, "reasons": [*verdict.reasons], "causes": causes_entry(findings)}


def causes_entry(findings: Sequence[RecordingFault]) -> list[dict[str, Any]]:
    """Causes found in a recording, with the parameters that fix them."""
    return [
        to_document(finding.cause) | {"sure": finding.sure, "rivals": to_document(finding.rivals)}
        for finding in findings
    ]


def account_entry(account: Account) -> dict[str, Any]:
    """Counts of a topic's messages."""
    kinds = {kind: dict(sorted((+getattr(account, kind)).items())) for kind in ("rejected", "dropped", "noted")}
    return {"received": account.received, "accepted": account.accepted, **kinds, "lost": account.lost}
