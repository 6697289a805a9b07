"""A model's effects as files have them: the values of their parameters, and what follows from these."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from geomid_ros.gap.result import Quantity
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import PARAMETERS, PHYSICAL_EFFECTS
from geomid_ros.model.effects.parameters import COM_ENTRIES, INERTIA_ENTRIES
from geomid_ros.types import FloatArray


class ModelEffect(Protocol):
    """An effect with the values of its parameters: a finding, or what is read of it from a file."""

    @property
    def effect(self) -> str:
        """Its name."""

    @property
    def joint(self) -> str:
        """The joint, or the topic of a wrench sensor; empty for the whole robot."""

    @property
    def link(self) -> str:
        """The link that carries a payload, else empty."""

    @property
    def parameters(self) -> Mapping[str, Quantity]:
        """The parameters by name."""


@dataclass(frozen=True)
class KnownEffect:
    """An effect as a file says it; see :class:`ModelEffect`."""

    effect: str
    joint: str
    link: str
    parameters: Mapping[str, Quantity]


def values(effect: ModelEffect) -> dict[str, float]:
    """An effect's parameters without their units; what may be left out is zero."""
    optional = {name: 0.0 for name, form in PARAMETERS[effect.effect].items() if form.optional}
    return optional | {name: quantity.value for name, quantity in effect.parameters.items()}


def joint_attributes(effect: str, known: Mapping[str, float], element: str) -> dict[str, float]:
    """What an effect with the parameters ``known`` adds to attributes of a joint's ``element``: ``dynamics`` in a URDF,
    ``joint`` in an MJCF."""
    forms = PARAMETERS[effect].values()
    places = [(form.name, place.partition("/")) for form in forms for place in (form.urdf, form.mjcf)]
    return {attribute: known[name] for name, (own, _, attribute) in places if own == element}


def inertia_matrix(payload: Mapping[str, float]) -> FloatArray:
    """Inertia ``(3, 3)`` [kg m^2] of a payload about its centre of mass, from its values."""
    xx, xy, yy, xz, yz, zz = (payload[name] for name in INERTIA_ENTRIES)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def payload_parameters(payload: Mapping[str, float]) -> FloatArray:
    """Inertial parameters ``(10,)`` of a payload about its link's origin, from its values."""
    centre = np.array([payload[name] for name in COM_ENTRIES])
    return pseudo_inertia.assemble(np.array(payload["mass"]), centre, inertia_matrix(payload))


def tilted_gravity(gravity: FloatArray, tilt: Mapping[str, float]) -> FloatArray:
    """Gravity ``(3,)`` in the frame of a base that is tilted, from the tilt's values."""
    turn = Rotation.from_rotvec([tilt["tilt_x"], tilt["tilt_y"], 0.0]).as_matrix()
    turned: FloatArray = turn.T @ gravity
    return turned


def combined(effects: Iterable[ModelEffect]) -> list[KnownEffect]:
    """Effects of which none is there twice at a place: what adds up is added, gains are multiplied, of others the later
    one holds."""
    found: dict[tuple[str, str], KnownEffect] = {}
    for effect in effects:
        new = KnownEffect(effect.effect, effect.joint, effect.link, effect.parameters)
        key = effect.effect, effect.link or effect.joint
        found[key] = _together(found[key], new) if key in found else new
    return list(found.values())


def _together(first: KnownEffect, second: KnownEffect) -> KnownEffect:
    if second.effect == "effort_gain":
        return replace(second, parameters={"gain": _scaled(second.parameters["gain"], first.parameters["gain"].value)})
    if not PHYSICAL_EFFECTS[second.effect].adds_up:
        return second
    both = [*first.parameters.items(), *second.parameters.items()]
    sums: dict[str, Quantity] = {}
    for name, quantity in both:
        sums[name] = _sum(sums[name], quantity) if name in sums else quantity
    return replace(second, parameters=sums)


def _scaled(quantity: Quantity, factor: float) -> Quantity:
    return replace(quantity, value=factor * quantity.value, std=abs(factor) * quantity.std)


def _sum(first: Quantity, second: Quantity) -> Quantity:
    """Sum of two independent estimates; where the uncertainty of one is not known, the other's."""
    known = [quantity.std for quantity in (first, second) if math.isfinite(quantity.std)]
    return replace(second, value=first.value + second.value, std=math.hypot(*known) if known else math.nan)
