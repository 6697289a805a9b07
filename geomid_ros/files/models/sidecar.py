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

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.files.disk import write_text
from geomid_ros.files.models.effect_forms import is_coefficient
from geomid_ros.files.parameter_file import read_yaml
from geomid_ros.files.schema import FORMAT, check, check_form, plain, structured
from geomid_ros.model.effects import EFFECTS, KnownEffect, ParameterForm, Quantity, effect_class

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


@dataclass(frozen=True, kw_only=True)
class Sidecar:
    """The effects of the robot called ``robot``."""

    robot: str = ""
    effects: tuple[KnownEffect, ...]


@check.register
def _check_effect(effect: KnownEffect, where: str) -> None:
    """Refuse an effect of a file that cannot be. Raises InputError beginning with ``where``."""
    if effect.effect not in EFFECTS:
        raise InputError(f"{where}: {unknown_name('effect', effect.effect, EFFECTS)}")
    cls, where = EFFECTS[effect.effect], f"{where} ({effect.effect})"
    key, what = _PLACES.get(cls.place, ("effect", ""))
    if not getattr(effect, key):
        raise InputError(f"{where}: {key} is not given, expected {what}")
    forms = {form.name: form for form in cls.parameters}
    for name, quantity in effect.parameters.items():
        if name not in forms:
            raise InputError(f"{where}: parameters: {unknown_name('parameter', name, forms)}")
        _check_quantity(quantity, forms[name], f"{where}: parameters: {name}")
    for name, form in forms.items():
        if name not in effect.parameters and not form.optional:
            raise InputError(f"{where}: parameters: {name} is not given")


def _check_quantity(given: Quantity, form: ParameterForm, where: str) -> None:
    if not form.above < given.value < form.below:
        raise InputError(f"{where} is {given.value:g}, expected a number above {form.above:g} and below {form.below:g}")
    if given.std < 0.0:
        raise InputError(f"{where}: std is {given.std:g}, expected a number from zero on, or null")
    if given.unit not in form.units:
        expected = " or ".join(dict.fromkeys(form.units))
        raise InputError(f"{where}: unit is {given.unit!r:.80}, expected {expected}")


def coefficient_entry(effect: KnownEffect) -> dict[str, Any]:
    """An effect of one coefficient at a joint, as ``estimate.json`` has it; with its constant unless that is usual."""
    quantity, *_ = effect.parameters.values()
    name = effect_class(effect.effect).usual_constant
    constants = {name: effect.parameters[name].value} if name in effect.parameters else {}
    return {"name": effect.effect, "joint": effect.joint, **plain(quantity), **constants}


def effects_entries(effects: Iterable[KnownEffect]) -> dict[str, Any]:
    """The ``effects`` of one coefficient at a joint, and those of other forms that are ``added``."""
    kinds: dict[str, Any] = {"effects": [], "added": []}
    for effect in effects:
        single = is_coefficient(effect)
        kinds["effects" if single else "added"].append(coefficient_entry(effect) if single else plain(effect))
    return kinds


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
    forms = [form for form in effect_class(effect.effect).parameters if form.name in effect.parameters]
    other = {n: float(q.value) for n, q in alone.parameters.items() if q.value != effect.parameters[n].value}
    return {
        **{key: own for key, own in plain(effect).items() if own},
        "urdf": [form.name for form in forms if form.urdf],
        "mjcf": [form.name for form in forms if form.mjcf],
        **({"alone": other} if other else {}),
    }


def read_sidecar(path: Path) -> Sidecar:
    """Read a sidecar. Raises InputError naming the file and the key."""
    document = read_yaml(path, "file of effects")
    check_form(document, ("effects",), f"{path}:", "file of effects")
    sidecar = structured(Sidecar, document, f"{path}:")
    for (name, place), count in Counter((own.effect, own.link or own.joint) for own in sidecar.effects).items():
        if count > 1:
            raise InputError(f"{path}: {name} is said twice at '{place}'")
    return sidecar
