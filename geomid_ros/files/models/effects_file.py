"""Effects of a model in files: their values in robot descriptions, and ``effects.yaml``.

``effects.yaml`` is the sidecar of a robot description. It contains all effects of the model that the description was
fitted with, also those that this cannot hold, and names in a comment what the estimate has in addition.

::

    format: 1
    robot: NAME                     # as in the URDF
    effects:
      - effect: stribeck_friction   # names, places, parameters and units: geomid_ros/model/effects/
        joint: joint3               # or FIRST+SECOND, or the topic of a wrench sensor; absent for the whole robot
        link: tool                  # of a payload, else absent
        parameters:
          level: {value: 1.2, std: 0.01, unit: N m}     # std: standard deviation of this value, null if not known
          excess: {value: 0.4, std: 0.02, unit: N m}
          speed: {value: 0.1, std: 0.01, unit: rad/s}
        urdf: [level]               # the parameters that the URDF contains, too
        mjcf: [level]               # the same for the MJCF
        alone: {level: 1.4}         # values in both instead, as they cannot hold all of the friction; absent if equal
"""

from __future__ import annotations

import math
import textwrap
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from geomid_ros.errors import InputError, check_name
from geomid_ros.files.disk import write_text
from geomid_ros.files.parameter_file import read_yaml
from geomid_ros.files.schema import FORMAT, check, check_form, from_document, to_document
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import EFFECTS, KnownEffect, ParameterForm, Quantity, effect_class
from geomid_ros.model.effects.parameters import COM_ENTRIES
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.types import FloatArray

QUANTITY_NAMES = ("mass", *COM_ENTRIES, *pseudo_inertia.INERTIA_NAMES)
"""Parameters of a payload, in the order of :func:`~geomid_ros.geometry.pseudo_inertia.quantities_of`."""
_PLACES = {"joint": "its joint", "joints": "FIRST+SECOND", "sensor": "its sensor's topic", "link": "its link"}
_HEADER = """\
# Effects of this robot's joints and sensors, in SI units. "urdf" and "mjcf" list the parameters that the URDF and the
# MJCF also contain. If you load one of these files, add only the others. "alone" is the value in both files: it was
# fitted without the friction that they cannot hold. If you add that friction, use the value under "parameters".
# q, v, a: a joint's position, velocity and acceleration; tau: the effort that its gear transmits to the link.
"""


def payload_name(carrier: str) -> str:
    """Name of a link's payload as a link of a description, and of its joint; underscores follow if it is taken."""
    return f"{carrier}_payload"


def is_payload_name(link: str, carrier: str) -> bool:
    """True if a description names the payload of ``carrier`` like this ``link``."""
    return link.rstrip("_") == payload_name(carrier)


def by_parameter(effects: Iterable[KnownEffect]) -> dict[tuple[str, str, str], Quantity]:
    """Quantities of effects, by effect, joint and parameter."""
    return {
        (effect.effect, effect.joint, name): quantity
        for effect in effects
        for name, quantity in effect.parameters.items()
    }


def coefficients_of(model: MeasurementModel, effects: Iterable[KnownEffect]) -> FloatArray:
    """Values ``(coefficients,)`` of a model's coefficients according to the effects, zero for others."""
    numbers = by_parameter(effects)
    zero = Quantity(0.0, 0.0, "")
    return np.array([numbers.get((c.effect.name, c.place_name, c.parameter), zero).value for c in model.coefficients])


def joint_attributes(effects: Iterable[KnownEffect], element: str) -> dict[str, dict[str, float]]:
    """Attributes of a joint's ``element`` according to the effects, added up, by joint. The element is ``dynamics`` in
    a URDF, ``joint`` or ``tendon`` in an MJCF, ``actuator`` in a URDF for Drake, ``gazebo`` in one for Gazebo."""
    attributes: dict[str, dict[str, float]] = {}
    for effect in effects:
        forms, values = effect.cls.parameters, effect.values
        places = {(place, form.name) for form in forms for place in (form.urdf, form.mjcf, form.drake, form.gazebo)}
        for place, name in sorted(places):
            parent, _, attribute = place.partition("/")
            if parent == element:
                numbers = attributes.setdefault(effect.joint, {})
                numbers[attribute] = numbers.get(attribute, 0.0) + values[name]
    return attributes


def of_followers(
    attributes: Mapping[str, Mapping[str, float]], masters: Mapping[str, tuple[str, float, float]]
) -> dict[str, dict[str, float]]:
    """Zeros for the attributes of joints that mimic others, by their ``masters``: the ``attributes`` of these include
    them, unless they have their own."""
    return {
        follower: dict.fromkeys(attributes[master].keys() - attributes.get(follower, {}).keys(), 0.0)
        for follower, (master, _, _) in masters.items()
        if master in attributes
    }


def unrepresentable(effects: Iterable[KnownEffect], files: Iterable[str]) -> list[str]:
    """Effects in words that ``files`` (see :meth:`~geomid_ros.model.effects.ParameterForm.said_by`) cannot represent,
    with their place, or the number of places.

    Sensor errors are ignored, as they are not part of a robot.
    """
    files, pairs = tuple(files), list[tuple[str, str]]()
    for effect in effects:
        cls = effect.cls
        # No format has a constant of default value, and no simulator needs it.
        forms = [form for form in cls.parameters if form.name in {*effect.parameters} - {cls.default_constant}]
        missing = [form.name for form in forms if not form.said_by(files)]
        if missing and not cls.is_sensor_error:
            phrase = effect_name(effect.effect) + (f" ({', '.join(missing)})" if len(missing) < len(forms) else "")
            pairs.append((phrase, effect.location))
    return with_places(pairs)


_NAMES = {"coulomb": "Coulomb", "stribeck": "Stribeck", "imu": "IMU"}


def effect_name(effect: str) -> str:
    """Name of an effect within a sentence: ``Coulomb friction``."""
    return " ".join(_NAMES.get(word, word) for word in effect.split("_"))


def with_places(pairs: Iterable[tuple[str, str]]) -> list[str]:
    """List each name of ``pairs`` of a name and a place once, with its place, or with the number of its places."""
    places: dict[str, list[str]] = {}
    for name, place in pairs:
        places.setdefault(name, []).append(place)
    return [
        f"{name} at {len(at)} places" if len(at) > 1 else f"{name} of {at[0]}" if at[0] else name
        for name, at in places.items()
    ]


def tilted_gravity(gravity: FloatArray, effects: Iterable[KnownEffect]) -> FloatArray:
    """Gravity ``(3,)`` in the frame of a base that the effects tilt, from that of an upright base."""
    for effect in effects:
        gravity = effect.cls.tilted_gravity(gravity, effect.values)
    return gravity


def combined(effects: Iterable[KnownEffect]) -> list[KnownEffect]:
    """Merge effects of the same kind at the same place; see :meth:`~geomid_ros.model.effects.Effect.combined`."""
    merged: dict[tuple[str, str], KnownEffect] = {}
    for effect in effects:
        key = effect.effect, effect.location
        parameters = effect.parameters
        if key in merged:
            parameters = effect.cls.combined(merged[key].parameters, parameters)
        merged[key] = KnownEffect(effect.effect, effect.joint, effect.link, parameters)
    return list(merged.values())


def updated_effects(estimated: Sequence[KnownEffect], known: Sequence[KnownEffect]) -> list[KnownEffect]:
    """Update the effects of a model that began with ``known`` ones, after coefficients were ``estimated``.

    Estimated effects replace known ones, or update known effects that consist of them. Effects that were not estimated
    remain. Payloads are dropped, as the links' inertias include them by now.

    Returns:
        Coefficients at joints first, then the others.
    """
    remaining = {(effect.effect, effect.joint): effect for effect in estimated}
    order = list(EFFECTS)
    others = [effect for effect in known if not effect.is_payload and not effect.is_coefficient]
    refined = [_refined(effect, remaining) for effect in sorted(others, key=lambda effect: order.index(effect.effect))]
    of_place = [effect for effect in remaining.values() if not effect.is_coefficient]
    return [*(effect for effect in remaining.values() if effect.is_coefficient), *combined([*refined, *of_place])]


def _refined(effect: KnownEffect, remaining: dict[tuple[str, str], KnownEffect]) -> KnownEffect:
    """Update an effect by its parts, which are removed from the ``remaining`` estimated effects."""
    estimated = {name: other.parameters for (name, joint), other in remaining.items() if joint == effect.joint}
    parameters, others = effect.cls.updated(effect.parameters, estimated)
    for name in estimated:
        del remaining[name, effect.joint]
    remaining |= {(name, effect.joint): KnownEffect(name, effect.joint, "", values) for name, values in others.items()}
    return KnownEffect(effect.effect, effect.joint, effect.link, parameters)


@check.register
def _check_effect(effect: KnownEffect, where: str) -> None:
    """Refuse an effect of a file that is invalid. Raises InputError beginning with ``where``."""
    check_name("effect", effect.effect, EFFECTS, where)
    cls, where = EFFECTS[effect.effect], f"{where} ({effect.effect})"
    key = "link" if cls.place == "link" else "joint"
    if cls.place in _PLACES and not getattr(effect, key):
        raise InputError(f"{where}: {key} is not given, expected {_PLACES[cls.place]}")
    forms = {form.name: form for form in cls.parameters}
    for name, quantity in effect.parameters.items():
        check_name("parameter", name, forms, f"{where}: parameters")
        check_quantity(quantity, forms[name], f"{where}: parameters: {name}")
    for name, form in forms.items():
        if name not in effect.parameters and not form.optional:
            raise InputError(f"{where}: parameters: {name} is not given")


def check_quantity(size: Quantity, form: ParameterForm, where: str) -> None:
    """Refuse a parameter that its ``form`` excludes. Raises InputError beginning with ``where``."""
    if not form.above < size.value < form.below:
        below = f" and below {form.below:g}" if math.isfinite(form.below) else ""
        raise InputError(f"{where} is {size.value:g}, expected a number above {form.above:g}{below}")
    if size.std < 0.0:
        raise InputError(f"{where}: std is {size.std:g}, expected a number from zero on, or null")
    if size.unit not in form.units:
        expected = " or ".join(dict.fromkeys(form.units))
        raise InputError(f"{where}: unit is {size.unit!r:.80}, expected {expected}")


def coefficient_entry(effect: KnownEffect) -> dict[str, Any]:
    """Entry in ``estimate.json`` of an effect of one coefficient at a joint; a default constant is left out."""
    quantity, *_ = effect.parameters.values()
    name = effect.cls.default_constant
    constants = {name: effect.parameters[name].value} if name in effect.parameters else {}
    return {"name": effect.effect, "joint": effect.joint, **to_document(quantity), **constants}


def effects_entries(
    effects: Iterable[KnownEffect], shares: Mapping[tuple[str, str], float] | None = None
) -> dict[str, Any]:
    """Entries for the ``effects`` of one coefficient at a joint, and for the other effects, which are ``added``; of an
    estimate with the ``shares`` that are from data, by effect and place."""
    kinds: dict[str, Any] = {"effects": [], "added": []}
    for effect in effects:
        single, place = effect.is_coefficient, (effect.effect, effect.joint)
        share = {"from_data": shares.get(place)} if shares is not None and (single or place in shares) else {}
        entry = coefficient_entry(effect) if single else to_document(effect)
        kinds["effects" if single else "added"].append(entry | share)
    return kinds


def write_sidecar(
    path: Path,
    robot: str,
    effects: Sequence[KnownEffect],
    alone: Sequence[KnownEffect] | None = None,
    estimated: Iterable[KnownEffect] = (),
) -> None:
    """Write the sidecar of a robot. ``alone``: the same effects with their values in URDF and MJCF, if these differ.
    ``estimated``: effects of the estimate; those that are not among the ``effects`` are named."""
    entries = [_entry(*pair) for pair in zip(effects, effects if alone is None else alone, strict=True)]
    document = {"format": FORMAT, "robot": robot, "effects": entries}
    text = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    names = dict.fromkeys(entry["effect"] for entry in entries)
    meanings = "".join(f"#   {name}: {effect_class(name).meaning}\n" for name in names)
    own = {(effect.effect, effect.location) for effect in effects}
    places = [(effect.effect, effect.location) for effect in estimated if effect.cls.has_columns]
    lacking = with_places((effect_name(name), place) for name, place in places if (name, place) not in own)
    comment = textwrap.fill(f"{_LACKING} {', '.join(lacking)}.", 120, initial_indent="# ", subsequent_indent="# ")
    write_text(path, _HEADER + meanings + (comment + "\n" if lacking else "") + text)


_LACKING = "Fitted without these effects of the estimate, which estimate.json has, with the links that belong to them:"


def _entry(effect: KnownEffect, alone: KnownEffect) -> dict[str, Any]:
    forms = [form for form in effect.cls.parameters if form.name in effect.parameters]
    other = {n: float(q.value) for n, q in alone.parameters.items() if q.value != effect.parameters[n].value}
    return {
        **{key: item for key, item in to_document(effect).items() if item},
        "urdf": [form.name for form in forms if form.urdf],
        "mjcf": [form.name for form in forms if form.mjcf],
        **({"alone": other} if other else {}),
    }


def read_sidecar(path: Path) -> tuple[KnownEffect, ...]:
    """Read the effects of a sidecar. Raises InputError naming the file and the key."""
    document = read_yaml(path, "file of effects")
    check_form(document, ("effects",), f"{path}:", "file of effects")
    effects = from_document(tuple[KnownEffect, ...], document["effects"], f"{path}: effects")
    for (name, place), count in Counter((e.effect, e.location) for e in effects).items():
        if count > 1:
            raise InputError(f"{path}: {name} is listed twice at '{place}'")
    return effects
