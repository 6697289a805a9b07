"""The names that a gap report leaves open, as the search for a deciding motion wants them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.excitation.feasibility import Feasibility
from geomid_ros.excitation.knowledge import prior_knowledge
from geomid_ros.excitation.rivals import Ambiguity, DiscriminationCriterion, Name, coefficients_of
from geomid_ros.files.models.effects_file import payload_parameters
from geomid_ros.files.models.gap_file import OpenFinding, read_open_findings
from geomid_ros.gap.candidates import Candidate
from geomid_ros.model.channels import is_wrench_channel
from geomid_ros.model.effects import Effect, KnownEffect, OnLink, Place, effect_class, values_of
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray, frozen


def open_questions(feasibility: Feasibility, path: Path) -> tuple[DiscriminationCriterion, list[tuple[str, list[str]]]]:
    """Who says what a motion would decide, and of each finding its label and those of its rivals.

    Raises InputError naming the ``path`` of the gap.json, and what does not fit the robot.
    """
    findings, floor = read_open_findings(path)
    before = feasibility.knowledge
    model = before.model.without_effects()
    _refuse_others(model, floor, path)
    knowledge = prior_knowledge(model, feasibility.limits)
    names = [channel.name for channel in model.channels]
    sigmas = [floor.get(name) or own for name, own in zip(names, knowledge.sigmas.tolist(), strict=True)]
    knowledge = replace(knowledge, sigmas=frozen(sigmas))
    disputes = [_dispute(model, finding) for finding in findings]
    labels = [(dispute.found.label, [rival.label for rival in dispute.rivals]) for dispute in disputes]
    return DiscriminationCriterion(knowledge, disputes), labels


def _refuse_others(model: MeasurementModel, floor: Mapping[str, float], path: Path) -> None:
    """Raise InputError where a gap report says something of joints that the robot does not have."""
    joints = [joint.name for joint in model.robot.tree.joints if joint.type != "fixed"]
    for name in floor:
        if name not in joints and not is_wrench_channel(name):
            raise InputError(f"{path}: was written for another robot: {unknown_name('joint', name, joints)}")


def _dispute(model: MeasurementModel, entry: OpenFinding) -> Ambiguity:
    found = _name_of_finding(model, entry)
    rivals = [_any(model, rival.effect, rival.joint) for rival in entry.rivals]
    return Ambiguity(found, _coefficients(entry, found), tuple(rivals))


def _name_of_finding(model: MeasurementModel, finding: KnownEffect) -> Name:
    """The found effect with its constants first."""
    any_of = _any(model, finding.effect, finding.joint, finding.link)
    if isinstance(any_of.place, OnLink):
        return any_of
    own = effect_class(finding.effect).from_values(values_of(finding))
    return replace(any_of, variants=(own, *(variant for variant in any_of.variants if variant != own)))


def _any(model: MeasurementModel, effect: str, joint: str, link: str = "") -> Name:
    """An effect with any of its constants, at the place that files call ``joint``."""
    cls = effect_class(effect)
    variants = cls.variants()
    places = {_link_of(model, place) or model.places.name(place): place for place in model.places.of(variants[0])}
    place = places[link] if link in places else model.places.named(variants[0], joint)
    where = link or joint
    label = f"{cls.label} at {where}" if where else cls.label
    return Name(variants, place, label, _penalty(variants[0], place))


def _penalty(effect: Effect, place: Place) -> float:
    """For how many parameters an effect counts: a body for those that are said first, without its inertia."""
    terms = Candidate.of(effect, place).terms
    return float(len(terms) + bool(effect.scanned)) if terms else float(effect.said_first or 0)


def _link_of(model: MeasurementModel, place: Place) -> str:
    """The link of a place on one; empty for others."""
    return model.body_names[place.link] if isinstance(place, OnLink) else ""


def _coefficients(finding: KnownEffect, found: Name) -> FloatArray:
    values = values_of(finding)
    if isinstance(found.place, OnLink):
        return payload_parameters(values)
    return coefficients_of(effect_class(finding.effect), values, found.variants[0].parts)
