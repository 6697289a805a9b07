"""``geomid excite learn`` in closed loop with a simulated robot, whose controller is a process of its own."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from geomid_ros.commands.excite import _LearningRounds
from geomid_ros.errors import GeomidError

from .processes import Process
from .stage import Stage, staged
from .test_excite_run import PATIENT, URDF, controller, states, status

NOMINAL = 1.5  # [kg] of the last link with its tool in the URDF
HEAVIER, VISCOUS, COULOMB = 1.2, 0.3, 0.4  # what is true of the simulated robot
MOVING = 0.1  # [rad/s]
QUICK = ("--duration", "3", "--repeats", "1", "--no-collision")  # a design looks for collisions most of its time
IN_TIME = ("--duration", "5")  # to be stopped on the way, by a busy machine too


def learn(stage: Stage, *arguments: str | Path) -> Process:
    out = stage.folder / "out"
    return stage.start("geomid_ros", "excite", "learn", "--urdf", URDF, *QUICK, "--out", out, *arguments)


def rigid_efforts(urdf: Path, heavier: float = 1.0) -> np.ndarray:
    """Of a robot whose inertias are a multiple of a URDF's, at states drawn within the motion's range ``(100, 3)``."""
    model = pin.buildModelFromUrdf(str(urdf))
    for index in range(1, model.njoints):
        body = model.inertias[index]
        model.inertias[index] = pin.Inertia(heavier * body.mass, body.lever, heavier * body.inertia)
    data, random = model.createData(), np.random.default_rng(0)
    states = random.uniform(-2.0, 2.0, (100, 3, model.nv))
    return np.array([pin.rnea(model, data, *state) for state in states])


def estimate(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "estimate.json").read_text())
    return document


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    """With a robot, for all tests."""
    with staged(tmp_path_factory.mktemp("learn")) as stage:
        controller(stage)
        yield stage


def test_without_execute_and_without_consent_nothing_moves(stage: Stage) -> None:
    commands = stage.observer.collect(JointTrajectory, "/joint_trajectory_controller/joint_trajectory")
    heard, planned = stage.observer.collect(JointState, "/joint_states"), ("--out", stage.folder / "planned")
    stage.observer.wait_for(lambda: bool(heard), "the robot's states")
    process = learn(stage, *planned)
    assert status(stage, process) == 0, process.output
    assert "Round 1: 1 x 3 s" in process.output
    assert "Approach: 0.200 rad (m) to the start" in process.output
    assert "Nothing has moved" in process.output
    assert (stage.folder / "planned/round1/motion.html").exists()
    again = learn(stage, *planned)
    assert status(stage, again) == 2
    assert "round1 exists already; name another folder with --out" in again.output.partition("Error: ")[2]
    asked = learn(stage, "--out", stage.folder / "asked", "--execute")  # nobody answers
    assert status(stage, asked) == 1
    assert "Run this motion" in asked.output
    assert commands == []
    assert np.ptp([list(state.position) for state in heard]) == 0.0


@pytest.fixture(scope="module")
def learned(stage: Stage) -> Path:
    """The folder of two rounds."""
    process = learn(stage, "--execute", "--yes", "--rounds", "2", *PATIENT)
    for said in ("Round 1:", "Masses after round 1", "Masses after round 2"):
        stage.observer.wait_for(lambda said=said: said in process.output or not process.running, said)
    assert status(stage, process) == 0, process.output
    assert "Stopped after 2 rounds (--rounds)" in process.output
    out = stage.folder / "out"
    assert f"Identified from 2 rounds: {out / 'round2/identified.urdf'}" in process.output
    return out


def test_from_a_urdf_to_an_identified_robot(learned: Path) -> None:
    rounds = sorted(learned.iterdir())
    slow, fast = (np.array([s.message.velocity for s in states(folder / "recording")]) for folder in rounds)
    assert np.max(np.abs(slow)) < 0.5 * np.max(np.abs(fast))
    first, last = estimate(rounds[0]), estimate(rounds[-1])
    assert last["rows"]["accepted"] > 1.5 * first["rows"]["accepted"], "it identifies from all recordings"
    joints = [effect for effect in last["effects"] if effect["name"] in ("viscous_friction", "coulomb_friction")]
    assert len(joints) == 6
    for effect in joints:
        true = VISCOUS if effect["name"] == "viscous_friction" else COULOMB
        assert abs(effect["value"] - true) < max(5.0 * effect["std"], 0.02)
    end = next(link for link in last["links"] if link["name"] == "link3")
    assert abs(end["mass"] - HEAVIER * NOMINAL) < max(4.0 * end["std"]["mass"], 0.1)
    identified, true = rigid_efforts(rounds[-1] / "identified.urdf"), rigid_efforts(URDF, HEAVIER)
    error, before = np.std(identified - true), np.std(rigid_efforts(URDF) - true)
    assert error < 0.25 * before, "what the motion tells is much nearer to the truth than the URDF"


def test_it_goes_on_with_what_is_known_until_it_is_stopped(stage: Stage, learned: Path) -> None:
    """And says how to start again, as long as nothing more is identified."""
    heard = stage.observer.collect(JointState, "/joint_states")
    known = ("--from", learned / "round2/estimate.json", "--out", stage.folder / "on")
    process = learn(stage, *IN_TIME, *known, "--execute", "--yes", *PATIENT)

    def moves() -> bool:
        assert process.running, process.output
        return "the motion:" in process.output and bool(np.max(np.abs(heard[-1].velocity)) > MOVING)

    stage.observer.wait_for(moves, "the motion")
    process.send(signal.SIGINT)
    assert status(stage, process) == 2
    said = process.output.partition("Error: ")[2]
    assert "round 1: the motion was stopped: interrupted. The robot is at rest." in said
    assert "Nothing is identified yet. To start again, repeat the command with another --out" in said
    reports = (stage.folder / out / "round1/excitation.json" for out in ("out", "on"))
    before, after = (json.loads(report.read_text())["expected"]["before"]["error"] for report in reports)
    assert after < 0.5 * before


def test_after_a_round_the_way_to_go_on_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: Any, **__: Any) -> None:
        raise GeomidError("the motion was stopped")

    monkeypatch.setattr("geomid_ros.commands.excite._run_motion", stopped)
    anything: Any = SimpleNamespace(text="", source="", trajectory=None)
    rounds = _LearningRounds(
        robot=anything, chosen=anything, asked=anything, out=tmp_path, number=2, identified=1, found=anything
    )
    first = tmp_path / "round1"
    way = f"The result so far is in {first}. To continue, repeat the command with --from {first / 'estimate.json'}"
    with pytest.raises(GeomidError, match=re.escape(f"round 2: the motion was stopped. {way} and another --out")):
        rounds.run(anything, execute=True)
