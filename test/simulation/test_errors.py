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
    [("duration", float("inf")), ("rate", float("nan")), ("seed", -1), ("motion_speed", 1.5), ("longest_step", 0.01)],
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


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<parent link="link2"/>', '<parent link="link9"/>', "MuJoCo cannot build this robot"),
        ('effort="30"', 'effort="2"', "drives are too weak"),
    ],
)
def test_robots_that_cannot_be_built_or_moved(old: str, new: str, message: str, tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    (tmp_path / "robot.urdf").write_text(robot_description("arm3").replace(old, new))
    with pytest.raises(InputError, match=message):
        simulate(tmp_path / "bag", replace(QUICK, robot=str(tmp_path / "robot.urdf"), duration=4.0))
    assert not (tmp_path / "bag").exists()
