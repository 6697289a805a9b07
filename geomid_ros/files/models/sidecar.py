"""``effects.yaml``: the sidecar that says all effects of a model, in particular those that its URDF and MJCF cannot.

::

    format: 1
    robot: NAME                     # as in the URDF
    effects:
      - effect: stribeck_friction   # names, places, parameters and units: geomid_ros/model/effects/
        joint: joint3               # or FIRST+SECOND, or the topic of a wrench sensor; absent for the whole robot
        link: tool                  # of a payload, else absent
        parameters:
          level: {value: 1.2, std: 0.01, unit: N m}     # std: standard deviation, null where it is not known
          excess: {value: 0.4, std: 0.02, unit: N m}
          speed: {value: 0.1, std: 0.01, unit: rad/s}
        urdf: [level]               # the parameters that the URDF says, too
        mjcf: [level]               # the same of the MJCF
        alone: {level: 1.4}         # what both say instead, as they cannot say all of the friction; absent if they do
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.files.disk import write_text
from geomid_ros.files.parameter_file import read_yaml
from geomid_ros.files.schema import FORMAT, check_form, entry, structured
from geomid_ros.model.effects import EFFECTS, KnownEffect, ParameterForm, Quantity, effect_class
from geomid_ros.model.effects.parameters import Quantities

_PLACES = {
    "joint": ("joint", "the joint at which it acts"),
    "joints": ("joint", "the two joints at which it acts, FIRST+SECOND"),
    "sensor": ("joint", "the topic of the wrench sensor"),
    "link": ("link", "the link at which it acts"),
}
_HEADER = """\
# Effects of this robot's joints and sensors, in SI units. "urdf" and "mjcf" list the parameters that the URDF and the
# MJCF also contain. If you load one of these files, add only the others. "alone" is the value in both files: it was
# fitted without the friction that they cannot hold. If you add that friction, use the value under "parameters".
# q, v, a: a joint's position, velocity and acceleration; tau: the effort that its gear transmits to the link.
"""


@dataclass(frozen=True)
class Sidecar:
    """The effects of the robot called ``robot``."""

    robot: str
    effects: tuple[KnownEffect, ...]


@dataclass(frozen=True)
class QuantityEntry:
    """A parameter of an effect in files."""

    value: float
    unit: str
    std: float = math.nan


@dataclass(frozen=True, kw_only=True)
class EffectEntry:
    """An effect in files: with its place, and with the share of its uncertainty that data removed if that is known."""

    effect: str
    joint: str = ""
    link: str = ""
    parameters: Mapping[str, QuantityEntry] = field(default_factory=dict)
    from_data: float = math.nan

    def known(self, where: str) -> KnownEffect:
        """The effect. Raises InputError beginning with ``where`` if it cannot be."""
        if self.effect not in EFFECTS:
            raise InputError(f"{where}: {unknown_name('effect', self.effect, EFFECTS)}")
        cls, where = EFFECTS[self.effect], f"{where} ({self.effect})"
        key, what = _PLACES.get(cls.place, ("effect", ""))
        if not getattr(self, key):
            raise InputError(f"{where}: {key} is not given, expected {what}")
        forms = {form.name: form for form in cls.parameters}
        for name in self.parameters:
            if name not in forms:
                raise InputError(f"{where}: parameters: {unknown_name('parameter', name, forms)}")
        for name, form in forms.items():
            if name not in self.parameters and not form.optional:
                raise InputError(f"{where}: parameters: {name} is not given")
        found = {name: _quantity(q, forms[name], f"{where}: parameters: {name}") for name, q in self.parameters.items()}
        return KnownEffect(self.effect, self.joint, self.link, found)


def _quantity(given: QuantityEntry, form: ParameterForm, where: str) -> Quantity:
    if not form.above < given.value < form.below:
        raise InputError(f"{where} is {given.value:g}, expected a number above {form.above:g} and below {form.below:g}")
    if given.std < 0.0:
        raise InputError(f"{where}: std is {given.std:g}, expected a number from zero on, or null")
    if given.unit not in form.units:
        expected = " or ".join(dict.fromkeys(form.units))
        raise InputError(f"{where}: unit is {given.unit!r:.80}, expected {expected}")
    return Quantity(given.value, given.std, given.unit)


def effect_of(given: Any, where: str) -> KnownEffect:
    """The effect that a file has. Raises InputError that begins with ``where``."""
    return structured(EffectEntry, given, where).known(where)


def effect_entry(effect: KnownEffect) -> dict[str, Any]:
    """An effect as :func:`effect_of` reads it."""
    return entry(effect, "effect", "joint", "link") | {"parameters": quantities_entry(effect.parameters)}


def coefficient_entry(effect: KnownEffect) -> dict[str, Any]:
    """An effect of one coefficient at a joint, as ``estimate.json`` has it; with its constant unless that is usual."""
    quantity, *_ = effect.parameters.values()
    name = effect_class(effect.effect).usual_constant
    constants = {name: effect.parameters[name].value} if name in effect.parameters else {}
    return {"name": effect.effect, "joint": effect.joint, **quantity_entry(quantity), **constants}


def quantities_entry(quantities: Quantities) -> dict[str, Any]:
    """Values with their units and standard deviations; null for what is not finite."""
    return {name: quantity_entry(quantity) for name, quantity in quantities.items()}


def quantity_entry(quantity: Quantity) -> dict[str, Any]:
    """A value with its unit and standard deviation; null for what is not finite."""
    return entry(quantity, "value", "unit", "std")


def write_sidecar(
    path: Path, robot: str, effects: Sequence[KnownEffect], alone: Sequence[KnownEffect] | None = None
) -> None:
    """Write the sidecar of a robot; ``alone``: the same effects as URDF and MJCF have them, if these differ."""
    entries = [_entry(*each) for each in zip(effects, effects if alone is None else alone, strict=True)]
    document = {"format": FORMAT, "robot": robot, "effects": entries}
    text = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    names = dict.fromkeys(entry["effect"] for entry in entries)
    meanings = "".join(f"#   {name}: {effect_class(name).meaning}\n" for name in names)
    write_text(path, _HEADER + meanings + text)


def _entry(effect: KnownEffect, alone: KnownEffect) -> dict[str, Any]:
    forms = effect_class(effect.effect).parameters
    place = {"joint": effect.joint, "link": effect.link}
    other = {n: float(q.value) for n, q in alone.parameters.items() if q.value != effect.parameters[n].value}
    return {
        "effect": effect.effect,
        **{key: name for key, name in place.items() if name},
        "parameters": {
            name: {"value": float(q.value), "std": float(q.std) if math.isfinite(q.std) else None, "unit": q.unit}
            for name, q in effect.parameters.items()
        },
        "urdf": [form.name for form in forms if form.urdf and form.name in effect.parameters],
        "mjcf": [form.name for form in forms if form.mjcf and form.name in effect.parameters],
        **({"alone": other} if other else {}),
    }


def read_sidecar(path: Path) -> Sidecar:
    """Read a sidecar. Raises InputError naming the file and the key."""
    document = read_yaml(path, "file of effects")
    check_form(document, ("effects",), f"{path}:", "file of effects")
    entries = structured(_Document, document, f"{path}:").effects
    effects = [each.known(f"{path}: effects[{index}]") for index, each in enumerate(entries)]
    for (name, place), count in Counter((effect.effect, effect.link or effect.joint) for effect in effects).items():
        if count > 1:
            raise InputError(f"{path}: {name} is said twice at '{place}'")
    return Sidecar(str(document.get("robot", "")), tuple(effects))


@dataclass(frozen=True)
class _Document:
    effects: tuple[EffectEntry, ...]
