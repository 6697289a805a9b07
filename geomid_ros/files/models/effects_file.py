"""The effects of a model in files: what follows from their values for descriptions, and ``effects.yaml``.

``effects.yaml`` is the sidecar that says all effects of a model, in particular those that its URDF and MJCF cannot.

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
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.files.disk import write_text
from geomid_ros.files.parameter_file import read_yaml
from geomid_ros.files.schema import FORMAT, check, check_form, plain, structured
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import (
    EFFECTS,
    IdentifiedEffect,
    KnownEffect,
    ParameterForm,
    Quantity,
    effect_class,
    values_of,
)
from geomid_ros.model.effects.parameters import COM_ENTRIES
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray

QUANTITY_NAMES = ("mass", *COM_ENTRIES, *pseudo_inertia.INERTIA_NAMES)
"""A payload's parameters, in the order of :func:`~geomid_ros.geometry.pseudo_inertia.quantities_of`."""
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


def payload_name(carrier: str) -> str:
    """What the payload of a link is called as a link of a description, if no other is called so."""
    return f"{carrier}_payload"


def is_body(effect: KnownEffect) -> bool:
    """Whether it is a body that a link carries."""
    return effect_class(effect.effect).place == "link"


def is_coefficient(effect: KnownEffect) -> bool:
    """Whether it is one number at a joint that is identified along with the inertias."""
    cls = effect_class(effect.effect)
    return issubclass(cls, IdentifiedEffect) and cls.is_one_number()


def by_parameter(effects: Iterable[KnownEffect]) -> dict[tuple[str, str, str], Quantity]:
    """What effects say, by effect, joint and parameter."""
    return {
        (effect.effect, effect.joint, name): quantity
        for effect in effects
        for name, quantity in effect.parameters.items()
    }


def coefficients_of(model: MeasurementModel, effects: Iterable[KnownEffect]) -> FloatArray:
    """The values ``(coefficients,)`` of a model's coefficients that effects say, zero for others."""
    said = by_parameter(effects)
    none = Quantity(0.0, 0.0, "")
    return np.array([said.get((c.effect.name, c.place_name, c.parameter), none).value for c in model.coefficients])


def joint_attributes(effects: Iterable[KnownEffect], element: str) -> dict[str, dict[str, float]]:
    """What effects say of the attributes of a joint's ``element``, added up, by joint: ``dynamics`` in a URDF,
    ``joint`` in an MJCF, ``actuator`` in a URDF for Drake, ``gazebo`` in one for Gazebo."""
    found: dict[str, dict[str, float]] = {}
    for effect in effects:
        forms, known = effect_class(effect.effect).parameters, values_of(effect)
        places = {(place, form.name) for form in forms for place in (form.urdf, form.mjcf, form.drake, form.gazebo)}
        for place, name in sorted(places):
            own, _, attribute = place.partition("/")
            if own == element:
                numbers = found.setdefault(effect.joint, {})
                numbers[attribute] = numbers.get(attribute, 0.0) + known[name]
    return found


def effects_of_dynamics() -> dict[str, str]:
    """The effects of one coefficient that an attribute of a URDF's ``<dynamics>`` says, by the attribute."""
    return {
        cls.parameters[0].urdf.removeprefix("dynamics/"): name
        for name, cls in EFFECTS.items()
        if cls.is_one_number() and cls.parameters[0].urdf.startswith("dynamics/")
    }


def unsaid(effects: Iterable[KnownEffect], files: Iterable[str]) -> list[str]:
    """What ``files`` (see :meth:`~geomid_ros.model.effects.ParameterForm.said_by`) cannot say of effects, in words.

    Errors of sensors are no part of a robot, and do not count."""
    files = tuple(files)
    found: dict[str, list[str]] = {}
    for effect in effects:
        cls = effect_class(effect.effect)
        forms = [form for form in cls.parameters if form.name in effect.parameters]
        # A usual constant no format has, and no simulator needs.
        missing = [form.name for form in forms if not form.said_by(files) and form.name != cls.usual_constant]
        if missing and not cls.of_sensor:
            name = cls.label if cls.label[0].isupper() else effect.effect.replace("_", " ")
            what = name + (f" ({', '.join(missing)})" if len(missing) < len(forms) else "")
            found.setdefault(what, []).append(effect.link or effect.joint)
    return [what + (f" of {', '.join(places)}" if any(places) else "") for what, places in found.items()]


def payload_parameters(payload: Mapping[str, float]) -> FloatArray:
    """Inertial parameters ``(10,)`` of a payload about its link's origin, from its values."""
    return pseudo_inertia.parameters_of(np.array([payload[name] for name in QUANTITY_NAMES]))


def turned_gravity(gravity: FloatArray, effects: Iterable[KnownEffect]) -> FloatArray:
    """Gravity ``(3,)`` in the base frame, from that of a base that stands straight."""
    for effect in effects:
        gravity = effect_class(effect.effect).turned_gravity(gravity, values_of(effect))
    return gravity


def combined(effects: Iterable[KnownEffect]) -> list[KnownEffect]:
    """Effects of which none is there twice at a place; see
    :meth:`~geomid_ros.model.effects.Effect.together`."""
    found: dict[tuple[str, str], KnownEffect] = {}
    for effect in effects:
        key = effect.effect, effect.link or effect.joint
        parameters = effect.parameters
        if key in found:
            parameters = effect_class(effect.effect).together(found[key].parameters, parameters)
        found[key] = KnownEffect(effect.effect, effect.joint, effect.link, parameters)
    return list(found.values())


def continued(estimated: Sequence[KnownEffect], known: Sequence[KnownEffect]) -> list[KnownEffect]:
    """The effects of a model that began with ``known`` ones, after coefficients were ``estimated``.

    The estimated ones are as they are, or bring those known effects up to date that consist of them; what was not
    estimated holds on. Payloads are in the links' inertias by now.

    Returns:
        coefficients at joints first, then the others.
    """
    left = {(effect.effect, effect.joint): effect for effect in estimated}
    order = list(EFFECTS)
    others = [effect for effect in known if not is_body(effect) and not is_coefficient(effect)]
    refined = [_refined(effect, left) for effect in sorted(others, key=lambda effect: order.index(effect.effect))]
    of_place = [effect for effect in left.values() if not is_coefficient(effect)]
    return [*(effect for effect in left.values() if is_coefficient(effect)), *combined([*refined, *of_place])]


def _refined(effect: KnownEffect, left: dict[tuple[str, str], KnownEffect]) -> KnownEffect:
    """An effect brought up to date, which takes away from what is ``left`` what belongs to it."""
    here = {name: found.parameters for (name, joint), found in left.items() if joint == effect.joint}
    parameters, others = effect_class(effect.effect).refined(effect.parameters, here)
    for name in here:
        del left[name, effect.joint]
    left |= {(name, effect.joint): KnownEffect(name, effect.joint, "", own) for name, own in others.items()}
    return KnownEffect(effect.effect, effect.joint, effect.link, parameters)


def coefficient(name: str, joint: str, quantity: Quantity, constant: Quantity | None = None) -> KnownEffect:
    """An effect of one parameter, and of a constant where it is not as usual."""
    cls = effect_class(name)
    constants = {} if constant is None else {cls.usual_constant: constant}
    return KnownEffect(name, joint, "", {cls.parameters[0].name: quantity} | constants)


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
