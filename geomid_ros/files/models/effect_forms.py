"""What follows from the values of a model's effects: attributes in descriptions, and what a file cannot say."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import EFFECTS, IdentifiedEffect, KnownEffect, Quantity, effect_class, values_of
from geomid_ros.model.effects.parameters import COM_ENTRIES
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray

QUANTITY_NAMES = ("mass", *COM_ENTRIES, *pseudo_inertia.INERTIA_NAMES)
"""A payload's parameters, in the order of :func:`~geomid_ros.geometry.pseudo_inertia.quantities_of`."""


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
