"""``geomid simulate``: it records what was asked for, and nothing is overwritten."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from files.recordings import recorded

from .running import done, refused

QUICK = ("--robot", "arm3", "--duration", "3", "--rate", "50", "--seed", "4")
ROBOT = Path(__file__).parents[2] / "geomid_ros/simulation/robots/arm3.urdf"


@pytest.fixture
def out(tmp_path: Path) -> Path:
    pytest.importorskip("mujoco")
    return tmp_path / "bag"


def test_it_records_what_was_asked_for(out: Path, tmp_path: Path) -> None:
    hide = ("--hide", "spring:joint2=stiffness=5,equilibrium=0.3", "--hide", "payload")
    options = ("--wrench", "--inertia-error", "0.3", "--motion-seed", "5", "--commands", "--motion", "points")
    output = done("simulate", out, *QUICK, *options, *hide)
    assert str(out) in output
    assert ".controller.yaml" in output
    assert "the hidden effects" in output
    assert str(out) + ".truth.json" in output
    messages = recorded(out)
    assert {item.topic for item in messages} == {"/joint_states", "/joint_commands", "/wrench", "/robot_description"}
    for topic in ("/joint_states", "/joint_commands"):
        assert sum(item.topic == topic for item in messages) == 150
    truth = json.loads((tmp_path / "bag.truth.json").read_text())
    assert (truth["robot"], truth["seed"], truth["options"]["inertia_error"]) == ("arm3", 4, 0.3)
    assert truth["motion_seed"] == 5
    spring, payload = truth["effects"]
    assert spring == {"effect": "spring", "joint": "joint2", "parameters": {"stiffness": 5.0, "equilibrium": 0.3}}
    assert payload["effect"] == "payload"


@pytest.mark.parametrize("existing", ["bag", "bag.truth.json"])
def test_nothing_is_overwritten(existing: str, out: Path, tmp_path: Path) -> None:
    (tmp_path / existing).write_text("of last year")
    message = refused("simulate", out, *QUICK)
    assert existing in message
    assert [path.name for path in tmp_path.iterdir()] == [existing]
    assert (tmp_path / existing).read_text() == "of last year"


def test_a_realistic_robot_loses_messages_and_is_told_of_in_the_truth(out: Path) -> None:
    done("simulate", out, *QUICK, "--realistic", "--hide", "link_mass:tool=1.2")
    assert sum(item.topic == "/joint_states" for item in recorded(out)) <= 150
    truth = json.loads(out.with_name("bag.truth.json").read_text())
    assert [entry["effect"] for entry in truth["effects"]] == ["link_mass"]
    assert {"standing", "friction", "motors", "warm_up", "sensors"} < truth.keys()
    assert len(truth["friction"]["stiffness"]) == len(truth["joints"]) == 3
