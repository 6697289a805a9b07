"""The sidecar of effects: what is written is read again, and what cannot be used is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from geomid_ros.errors import InputError
from geomid_ros.files.models.effects_file import combined, read_sidecar, write_sidecar
from geomid_ros.model.effects import EFFECTS, KnownEffect, Quantity

from .effects import PAYLOAD, effect
from .estimates import edited


def one_of_each() -> list[KnownEffect]:
    """Every effect with numbers within its range, viscous friction first."""
    places = {"joint": "joint1", "joints": "joint1+joint2", "robot": "", "link": "tool", "sensor": "/wrench"}
    places |= {"base": "base", "commands": ""}
    return [
        effect("payload", "tool", **PAYLOAD)
        if name == "payload"
        else effect(name, places[known.place], **{p.name: 0.1 + 0.01 * k for k, p in enumerate(known.parameters)})
        for name, known in sorted(EFFECTS.items(), key=lambda named: named[0] != "viscous_friction")
    ]


def test_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "folder/effects.yaml"
    write_sidecar(path, "größe: 1", one_of_each())
    assert yaml.safe_load(path.read_text())["robot"] == "größe: 1"
    assert [*read_sidecar(path)] == one_of_each()


def test_it_explains_itself(tmp_path: Path) -> None:
    path = tmp_path / "effects.yaml"
    own, lacking = effect("stribeck_friction", "joint1", level=1.0, excess=0.5, speed=0.1), effect("spring", "joint2")
    write_sidecar(path, "arm", [own], estimated=[own, lacking])
    comments = [line for line in path.read_text().splitlines() if line.startswith("#")]
    assert any("level + excess exp(-(v/speed)^2)" in line for line in comments)
    assert "links that belong to them: spring of joint2." in " ".join(comments).replace(" # ", " ")
    (entry,) = yaml.safe_load(path.read_text())["effects"]
    assert (entry["urdf"], entry["mjcf"]) == (["level"], ["level"])


FIRST = ("effects", 0)
LEVEL = (*FIRST, "parameters", "coefficient")
UNUSABLE: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "no effects": (edited("effects"), "no 'effects'"),
    "another format": (edited("format", value=7), "format 7"),
    "an unknown effect": (edited(*FIRST, "effect", value="viscous_frictoin"), "Did you mean 'viscous_friction'"),
    "a missing parameter": (edited(*LEVEL), "coefficient is not given"),
    "an unknown parameter": (
        edited(*FIRST, "parameters", "slope", value={"value": 1.0, "unit": ""}),
        "unknown parameter 'slope'",
    ),
    "negative friction": (edited(*LEVEL, "value", value=-0.1), "coefficient is -0.1, expected a number above 0"),
    "twice": (
        lambda content: content["effects"].append(content["effects"][0]),
        "viscous_friction is listed twice at 'joint1'",
    ),
    "another unit": (edited(*LEVEL, "unit", value="lb in"), "unit is 'lb in', expected N m s/rad or N s/m"),
}


@pytest.mark.parametrize("case", UNUSABLE)
def test_what_cannot_be_used_is_named(case: str, tmp_path: Path) -> None:
    edit, message = UNUSABLE[case]
    path = tmp_path / "broken.yaml"
    write_sidecar(path, "arm3", one_of_each())
    content = yaml.safe_load(path.read_text())
    edit(content)
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=rf"broken\.yaml: .*{message}"):
        read_sidecar(path)


def test_effects_at_one_place_are_combined() -> None:
    found = combined(
        [
            effect("coulomb_friction", "joint1", level=1.0),
            effect("effort_gain", "joint1", gain=1.1),
            effect("spring", "joint1", stiffness=1.0, equilibrium=0.0),
            effect("coulomb_friction", "joint2", level=5.0),
            effect("coulomb_friction", "joint1", level=3.0),
            effect("effort_gain", "joint1", gain=0.9),
            effect("spring", "joint1", stiffness=2.0, equilibrium=0.1),
            effect("wrench_offset", "/wrench", fx=1.0),
            effect("wrench_offset", "/wrench", fx=1.0, tz=2.0),
        ]
    )
    assert [(e.effect, e.joint) for e in found] == [
        ("coulomb_friction", "joint1"),
        ("effort_gain", "joint1"),
        ("spring", "joint1"),
        ("coulomb_friction", "joint2"),
        ("wrench_offset", "/wrench"),
    ]
    dry, gain, spring, _, offset = found
    assert dry.parameters["level"] == Quantity(4.0, pytest.approx(np.hypot(0.1, 0.3)), "N m")
    assert gain.parameters["gain"].value == pytest.approx(0.99)
    assert spring.values == {"stiffness": 2.0, "equilibrium": 0.1}
    assert offset.values == {"fx": 2.0, "fy": 0.0, "fz": 0.0, "tx": 0.0, "ty": 0.0, "tz": 2.0}
