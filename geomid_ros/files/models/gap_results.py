"""``gap.json``: what the gap workflow found, for programs.

==============  =======================================================================================================
key             value
==============  =======================================================================================================
format          1
verdict         ``no gap``, ``named``, ``incomplete`` or ``unexplained``
findings        list of named effects, the surest first:
                ``effect``, ``joint`` (a wrench sensor's topic, or empty for the whole robot), ``link`` (of a payload),
                ``parameters`` {name: {``value``, ``std``, ``unit``}},
                ``probability`` (of the name beside nothing and its rivals), ``confidence`` (the same in a word:
                ``confident`` above .95, ``tentative`` from .5, ``ambiguous``),
                ``rivals`` [{``effect``, ``joint``, ``loss``}] other names for the same, ``loss`` by how much worse,
                ``separability`` (0: this motion cannot tell it from the inertias, to 1: nothing like it),
                ``loss`` (how much worse without it, a difference of -2 log p), ``share`` (of the gap that it closes),
                ``was`` {name: value} (the parameters that the model had, if the effect has changed),
                ``sentence``, ``settled_by`` (the recording that would settle an ambiguity, or empty) and
                ``moment`` {name: {``value``, ``std``, ``unit``}} (mass times centre of mass, of a payload whose mass
                the motion does not tell; else empty)
links           list of links that weigh something else than the model says, the surest first:
                ``link``, ``joint`` (that moves it), ``mass`` {``value``, ``std``, ``unit``} (by how much more),
                ``was`` (in the model), ``loss``, ``probability``, ``confidence`` and ``sentence``
unexplained     list of {``joint`` (or wrench channel), ``depends_on``, ``gap`` (times the floor)}
ordinary        list of effects that no finding says and that are in the written model: beside a URDF alone, friction,
                rotor inertia and offsets of all joints, as ``geomid identify`` finds them (as in the sidecar)
gap             {``before``, ``inertias_only``, ``after``}, each {channel: residual of all held-out samples in units of
                the floor}, ``after`` that of the written model, in which are the findings that are ``confident``;
                ``moving``: the same of ``after`` where joints move one way; and ``expected``: what noise and the
                uncertainty of the fit would leave there if the model were right
floor           {channel: the noise's standard deviation in N m or N, of efforts without the gains that were found}
resimulated     {``before``, ``after``}, each {joint or wrench channel: error of held-out data simulated again in short
                windows, in units of what noise makes of it}; null where it could not be simulated
closed_loop     the same of efforts in closed loop under the recorded commands, or null
causes          what makes the recording doubtful: list of {``kind``, ``places``, ``sentence``, ``settings`` (to write
                into the configuration), ``sure``, ``rivals``}
warnings        what else to know, in sentences: of the recording, and of the model that it was compared with
notes           what was settled for the user, in sentences: where the description was found, which joints were locked
robot ...       what the page shows beside: ``robot``, ``recordings``, ``known`` (effects that the model had),
                ``judged_seconds``, ``not_simulated``, and what :mod:`geomid_ros.files.models.gap_reading` adds
==============  =======================================================================================================

Numbers that do not exist (a channel without measurements, say) are null.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

from geomid_ros.files.models.effect_forms import by_channel, effect_entry, finite, quantity_entry
from geomid_ros.gap.result import Finding, GapResult, LinkChange

FORMAT = 1


Errors: TypeAlias = Mapping[str, Mapping[str, float]]


def gap_document(result: GapResult, simulations: Mapping[str, Errors]) -> dict[str, Any]:
    """The document of a result; ``simulations`` has the errors {before, after} of ``windows`` and ``closed_loop``."""
    kinds = ("before", "inertias_only", "after", "expected")
    return {
        "format": FORMAT,
        "verdict": result.verdict,
        "findings": [_finding(finding) for finding in result.findings],
        "links": [_link(change) for change in result.links],
        "unexplained": [
            {"joint": entry.joint, "depends_on": entry.depends_on, "gap": finite(entry.gap)}
            for entry in result.unexplained
        ],
        "gap": {kind: by_channel(result.channels, getattr(result.gap, kind)) for kind in kinds}
        | {"moving": by_channel(result.channels, result.moving)},
        "ordinary": [effect_entry(effect) for effect in result.ordinary],
        "floor": by_channel(result.channels, result.corrected_floor),
        "resimulated": _errors(simulations.get("windows")),
        "closed_loop": _errors(simulations.get("closed_loop")),
    }


def _errors(errors: Errors | None) -> dict[str, Any] | None:
    if errors is None:
        return None
    return {kind: {name: finite(value) for name, value in by_name.items()} for kind, by_name in errors.items()}


def _link(change: LinkChange) -> dict[str, Any]:
    return {
        "link": change.link,
        "joint": change.joint,
        "mass": quantity_entry(change.mass),
        "was": finite(change.was),
        "moment": {name: quantity_entry(quantity) for name, quantity in change.moment.items()},
        "loss": finite(change.loss),
        "probability": change.probability,
        "confidence": change.confidence,
        "sentence": change.sentence,
    }


def _finding(finding: Finding) -> dict[str, Any]:
    return effect_entry(finding) | {
        "probability": finding.probability,
        "confidence": finding.confidence,
        "rivals": [
            {"effect": rival.effect, "joint": rival.joint, "loss": finite(rival.loss)} for rival in finding.rivals
        ],
        "separability": finite(finding.separability),
        "loss": finite(finding.loss),
        "share": finite(finding.share),
        "was": {name: finite(value) for name, value in finding.was.items()},
        "sentence": finding.sentence,
        "settled_by": finding.settled_by,
        "moment": {name: quantity_entry(quantity) for name, quantity in finding.moment.items()},
    }
