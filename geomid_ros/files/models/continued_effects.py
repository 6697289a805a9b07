"""The effects of an estimate that began with a model of its own, as ``estimate.json`` has them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

from geomid_ros.files.models.effect_forms import KnownEffect, ModelEffect, values
from geomid_ros.files.models.gap_results import effect_entry
from geomid_ros.gap.result import Quantity

# The coefficients that were estimated, by name and joint, as entries of estimate.json.
_Found: TypeAlias = dict[tuple[str, str], dict[str, Any]]


def continued(estimated: Sequence[Mapping[str, Any]], known: Sequence[ModelEffect]) -> dict[str, list[dict[str, Any]]]:
    """``effects`` and ``added`` of a document: the ``estimated`` coefficients, by which springs and Stribeck friction
    among the ``known`` effects are brought up to date, and what of these was not estimated and holds on.

    Payloads are in the links' inertias by now.
    """
    found = {(entry["name"], entry["joint"]): dict(entry) for entry in estimated}
    order = list(_CONTINUED)
    ordered = sorted((e for e in known if e.effect in _CONTINUED), key=lambda effect: order.index(effect.effect))
    added = [_CONTINUED[effect.effect](effect, found) for effect in ordered]
    return {"effects": list(found.values()), "added": [effect_entry(effect) for effect in added]}


def _held(effect: ModelEffect, _: _Found) -> ModelEffect:
    return effect


def _gain(effect: ModelEffect, found: _Found) -> ModelEffect:
    """The offset was estimated of efforts that are free of the gain; files say it of the measured ones."""
    offset = found.get(("effort_offset", effect.joint))
    if offset is not None:
        offset |= {key: offset[key] * values(effect)["gain"] for key in ("value", "std")}
    return effect


def _spring(effect: ModelEffect, found: _Found) -> ModelEffect:
    """The estimated offset has that of the spring in it."""
    entry = found.pop(("spring", effect.joint), None)
    if entry is None:
        return effect
    offset = found.get(("effort_offset", effect.joint))
    if offset is not None:
        offset["value"] += entry["value"] * values(effect)["equilibrium"]
    return _with(effect, {"stiffness": entry})


def _stribeck(effect: ModelEffect, found: _Found) -> ModelEffect:
    """The estimated Coulomb friction is the level."""
    names = {"excess": "stribeck_friction", "level": "coulomb_friction"}
    if not all((name, effect.joint) in found for name in names.values()):
        return effect
    return _with(effect, {parameter: found.pop((name, effect.joint)) for parameter, name in names.items()})


def _with(effect: ModelEffect, entries: Mapping[str, Mapping[str, Any]]) -> ModelEffect:
    new = {name: Quantity(entry["value"], entry["std"], entry["unit"]) for name, entry in entries.items()}
    return KnownEffect(effect.effect, effect.joint, effect.link, {**effect.parameters, **new})


# In this order: springs before gains, as both change the offset.
_CONTINUED: dict[str, Callable[[ModelEffect, _Found], ModelEffect]] = {
    "spring": _spring,
    "stribeck_friction": _stribeck,
    "effort_gain": _gain,
    **dict.fromkeys(
        ("effort_delay", "gravity_tilt", "wrench_offset", "load_friction", "joint_elasticity", "backlash"), _held
    ),
}
