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
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.files.disk import write_text
from geomid_ros.files.parameter_file import read_yaml
from geomid_ros.model.effects import EFFECTS, KnownEffect, ParameterForm, PlaceKind, Quantity, effect_class

FORMAT = 1
_MOST_EFFECTS = 10_000
_LARGEST = 1e50  # products of three still fit
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
    if not isinstance(document, dict) or not isinstance(document.get("effects"), list):
        raise InputError(f"{path}: not a file of effects, it has no list 'effects'")
    if document.get("format") != FORMAT:
        raise InputError(f"{path}: has format {document.get('format')}, this version reads format {FORMAT}")
    if len(document["effects"]) > _MOST_EFFECTS:
        raise InputError(f"{path}: has {len(document['effects'])} effects, more than {_MOST_EFFECTS}")
    effects = [effect_of(entry, f"{path}: effects[{index}]") for index, entry in enumerate(document["effects"])]
    _refuse_repeats(effects, path)
    return Sidecar(str(document.get("robot", "")), tuple(effects))


def _refuse_repeats(effects: list[KnownEffect], path: Path) -> None:
    seen: set[tuple[str, str]] = set()
    for effect in effects:
        key = effect.effect, effect.link or effect.joint
        if key in seen:
            raise InputError(f"{path}: {effect.effect} is said twice at '{key[1]}'")
        seen.add(key)


def effect_of(entry: Any, where: str) -> KnownEffect:
    """The effect of a mapping as files have it. Raises InputError that begins with ``where``."""
    if not isinstance(entry, dict):
        raise InputError(f"{where}: expected an effect with its parameters, found {reprlib.repr(entry)}")
    name = str(entry.get("effect"))
    if name not in EFFECTS:
        raise InputError(f"{where}: {unknown_name('effect', name, EFFECTS)}")
    forms = {form.name: form for form in EFFECTS[name].parameters}
    where = f"{where} ({name})"
    parameters = entry.get("parameters")
    if not isinstance(parameters, dict):
        raise InputError(f"{where}: parameters: expected {', '.join(forms)}")
    joint, link = (_text(entry, key, where) for key in ("joint", "link"))
    _check_place(EFFECTS[name].place, joint, link, where)
    return KnownEffect(name, joint, link, _parameters(parameters, forms, f"{where}: parameters"))


def _text(entry: Mapping[str, Any], key: str, where: str) -> str:
    value = entry.get(key) or ""
    if not isinstance(value, str):
        raise InputError(f"{where}: {key} is {reprlib.repr(value)}, expected a name")
    return value


def _check_place(place: PlaceKind, joint: str, link: str, where: str) -> None:
    needed = {"joint": joint, "joints": joint, "sensor": joint, "link": link}
    if place in needed and not needed[place]:
        key = "link" if place == "link" else "joint"
        others = {"sensor": "the topic of the wrench sensor", "joints": "the two joints at which it acts, FIRST+SECOND"}
        what = others.get(place, f"the {key} at which it acts")
        raise InputError(f"{where}: {key} is not given, expected {what}")


def _parameters(given: Mapping[Any, Any], forms: Mapping[str, ParameterForm], where: str) -> dict[str, Quantity]:
    for name in given:
        if name not in forms:
            raise InputError(f"{where}: {unknown_name('parameter', str(name), forms)}")
    for name, expected in forms.items():
        if name not in given and not expected.optional:
            raise InputError(f"{where}: {name} is not given")
    return {name: _quantity(given[name], forms[name], f"{where}: {name}") for name in given}


def _quantity(given: Any, form: ParameterForm, where: str) -> Quantity:
    if not isinstance(given, dict):
        raise InputError(f"{where} is {reprlib.repr(given)}, expected value, std and unit")
    value, std = _number(given.get("value"), where), given.get("std")
    if not form.above < value < form.below:
        raise InputError(f"{where} is {value:g}, expected a number above {form.above:g} and below {form.below:g}")
    deviation = math.nan if std is None else _number(std, f"{where}: std")
    if deviation < 0.0:
        raise InputError(f"{where}: std is {deviation:g}, expected a number from zero on, or null")
    if given.get("unit") not in form.units:
        units = " or ".join(dict.fromkeys(form.units))
        raise InputError(f"{where}: unit is {reprlib.repr(given.get('unit'))}, expected {units}")
    return Quantity(value, deviation, given["unit"])


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < _LARGEST:
        raise InputError(f"{where} is {reprlib.repr(value)}, expected a finite number")
    return float(value)
