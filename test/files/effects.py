"""Effects made by hand, for tests of what is written of them."""

from __future__ import annotations

from geomid_ros.model.effects import EFFECTS, KnownEffect, Quantity


def effect(name: str, place: str = "", **parameters: float) -> KnownEffect:
    """An effect at a joint, a link or a topic, in units of a turning joint, every standard deviation a tenth."""
    place_of, units = EFFECTS[name].place, {form.name: form.units[0] for form in EFFECTS[name].parameters}
    quantities = {key: Quantity(value, abs(value) / 10.0, units[key]) for key, value in parameters.items()}
    return KnownEffect(name, "" if place_of == "link" else place, place if place_of == "link" else "", quantities)


PAYLOAD = {
    "mass": 1.5,
    "com_x": 0.02,
    "com_y": -0.03,
    "com_z": 0.08,
    "ixx": 0.004,
    "ixy": 0.0005,
    "ixz": -0.0003,
    "iyy": 0.005,
    "iyz": 0.0002,
    "izz": 0.003,
}
