"""``geomid simulate``: what it records can be identified, and nothing is overwritten."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from files.recordings import recorded

from .running import NO_CHOICE, WRIST, done, refused

QUICK = ("--robot", "arm3", "--duration", "3", "--rate", "50", "--seed", "4")
ROBOT = Path(__file__).parents[2] / "geomid_ros/simulation/robots/arm3.urdf"


@pytest.fixture
def out(tmp_path: Path) -> Path:
    pytest.importorskip("mujoco")
    return tmp_path / "bag"


def test_it_records_what_was_asked_for(out: Path, tmp_path: Path) -> None:
    output = done("simulate", out, *QUICK, "--wrench", "--inertia-error", "0.3", "--motion-seed", "5")
    assert str(out) in output
    assert str(out) + ".truth.json" in output
    messages = recorded(out)
    assert {item.topic for item in messages} == {"/joint_states", "/wrench", "/robot_description"}
    assert sum(item.topic == "/joint_states" for item in messages) == 150
    truth = json.loads((tmp_path / "bag.truth.json").read_text())
    assert (truth["robot"], truth["seed"], truth["options"]["inertia_error"]) == ("arm3", 4, 0.3)
    assert truth["motion_seed"] == 5


@pytest.mark.usefixtures("without_pictures")
def test_what_it_records_can_be_identified(out: Path, tmp_path: Path) -> None:
    done("simulate", out, *QUICK, "--wrench")
    options = ("--urdf", ROBOT, *WRIST, *NO_CHOICE, "--json", "--hold-out", "0", "--out", tmp_path / "results")
    found = {link["name"]: link["mass"] for link in json.loads(done("identify", out, *options))["links"]}
    truth = {link["name"]: link["mass"] for link in json.loads((tmp_path / "bag.truth.json").read_text())["links"]}
    assert found["wrist_ft"] == pytest.approx(truth["tool"], rel=0.05)


@pytest.mark.parametrize("existing", ["bag", "bag.truth.json"])
def test_nothing_is_overwritten(existing: str, out: Path, tmp_path: Path) -> None:
    (tmp_path / existing).write_text("of last year")
    message = refused("simulate", out, *QUICK)
    assert existing in message
    assert [path.name for path in tmp_path.iterdir()] == [existing]
    assert (tmp_path / existing).read_text() == "of last year"


def truth_of(out: Path) -> list[dict[str, Any]]:
    effects: list[dict[str, Any]] = json.loads(out.with_name(out.name + ".truth.json").read_text())["effects"]
    return effects


def test_it_hides_what_was_asked_for(out: Path) -> None:
    output = done("simulate", out, *QUICK, "--hide", "spring:joint2=stiffness=5,equilibrium=0.3", "--hide", "payload")
    assert "the hidden effects" in output
    spring, payload = truth_of(out)
    assert spring == {"effect": "spring", "joint": "joint2", "parameters": {"stiffness": 5.0, "equilibrium": 0.3}}
    assert payload["effect"] == "payload"


def test_a_realistic_robot_loses_messages_and_is_told_of_in_the_truth(out: Path) -> None:
    done("simulate", out, *QUICK, "--realistic", "--hide", "link_mass:tool=1.2")
    assert sum(item.topic == "/joint_states" for item in recorded(out)) <= 150
    truth = json.loads(out.with_name("bag.truth.json").read_text())
    assert [entry["effect"] for entry in truth["effects"]] == ["link_mass"]
    assert {"standing", "friction", "motors", "warm_up", "sensors"} < truth.keys()
    assert len(truth["friction"]["stiffness"]) == len(truth["joints"]) == 3


def test_it_records_commands(out: Path) -> None:
    assert ".controller.yaml" in done("simulate", out, *QUICK, "--commands", "--motion", "points")
    assert sum(item.topic == "/joint_commands" for item in recorded(out)) == 150
