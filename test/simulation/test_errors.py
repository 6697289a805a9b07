"""Requests that cannot be met are refused with what would work."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from geomid_ros.errors import InputError
from geomid_ros.simulation.description import robot_description
from geomid_ros.simulation.options import Hidden, SimulationOptions
from geomid_ros.simulation.recording import simulate

QUICK = SimulationOptions(robot="arm3", duration=1.0)


def test_missing_mujoco_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match="pip install mujoco"):
        simulate(tmp_path / "bag", QUICK)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("duration", 0.0),
        ("duration", float("inf")),
        ("rate", float("nan")),
        ("seed", -1),
        ("motion_speed", 1.5),
        ("longest_step", 0.01),
    ],
)
def test_impossible_option_is_named(option: str, value: Any) -> None:
    with pytest.raises(InputError, match=option):
        replace(QUICK, **{option: value})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"wrench_frame": "hand"}, "unknown wrench frame 'hand'.*wrist_ft"),
        ({"motion": "dance"}, "unknown motion 'dance'.*chirp"),
        ({"hide": (Hidden("magic", "joint1", 1.0),)}, "unknown effect 'magic'.*coulomb_friction"),
        ({"hide": (Hidden("payload", "base_link"),)}, "unknown joint or moving link 'base_link'.*joint1.*tool"),
        ({"hide": (Hidden("spring", "joint1", None, {"hardness": 1.0}),)}, "unknown parameter of spring 'hardness'"),
        ({"robot": "nowhere.urdf"}, "nowhere.urdf: the URDF cannot be read"),
    ],
)
def test_unknown_names_are_answered_with_the_known(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    with pytest.raises(InputError, match=message):
        simulate(tmp_path / "bag", replace(QUICK, **changes))


def test_what_mujoco_cannot_build_is_passed_on(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    orphan = tmp_path / "orphan.urdf"
    orphan.write_text(robot_description("arm3").replace('<parent link="link2"/>', '<parent link="link9"/>'))
    with pytest.raises(InputError, match="MuJoCo cannot build this robot"):
        simulate(tmp_path / "bag", replace(QUICK, robot=str(orphan)))


def test_drives_too_weak_for_the_motion(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    weak = tmp_path / "weak.urdf"
    weak.write_text(robot_description("arm3").replace('effort="30"', 'effort="2"'))
    with pytest.raises(InputError, match="drives are too weak"):
        simulate(tmp_path / "bag", replace(QUICK, robot=str(weak), duration=4.0))
    assert not (tmp_path / "bag").exists()
