"""``geomid excite learn`` in closed loop with a simulated robot, whose controller is a process of its own."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from .processes import Process
from .stage import Stage
from .test_excite_run import PATIENT, URDF, controller, states, status

NOMINAL = 1.5  # [kg] of the last link with its tool in the URDF
HEAVIER, VISCOUS, COULOMB = 1.2, 0.3, 0.4  # what is true of the simulated robot
MOVING = 0.1  # [rad/s]
QUICK = ("--duration", "3", "--repeats", "1", "--no-collision")  # a design looks for collisions most of its time
IN_TIME = ("--duration", "5")  # to be stopped on the way, by a busy machine too


def learn(stage: Stage, *arguments: str | Path) -> Process:
    out = stage.folder / "out"
    return stage.start("geomid_ros", "excite", "learn", "--urdf", URDF, *QUICK, "--out", out, *arguments)


def estimate(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "estimate.json").read_text())
    return document


def test_without_execute_and_without_consent_nothing_moves(stage: Stage) -> None:
    commands = stage.observer.collect(JointTrajectory, "/joint_trajectory_controller/joint_trajectory")
    heard = stage.observer.collect(JointState, "/joint_states")
    controller(stage)
    process = learn(stage)
    assert status(stage, process) == 0, process.output
    assert "Round 1: 1 x 3 s" in process.output
    assert "Approach: 0.200 rad (m) to the start" in process.output
    assert "Nothing has moved" in process.output
    page = stage.folder / "out/round1/motion.html"
    assert page.exists()
    assert "round1 exists already; name another folder with --out" in refused(stage)
    asked = learn(stage, "--out", stage.folder / "asked", "--execute")  # nobody answers
    assert status(stage, asked) == 1
    assert "Run this motion" in asked.output
    assert commands == []
    assert np.ptp([list(state.position) for state in heard]) == 0.0


def refused(stage: Stage, *arguments: str | Path) -> str:
    process = learn(stage, *arguments)
    assert status(stage, process) == 2
    return process.output.partition("Error: ")[2]


def test_from_a_urdf_to_an_identified_robot(stage: Stage) -> None:
    controller(stage)
    process = learn(stage, "--execute", "--yes", "--rounds", "2", *PATIENT)
    for said in ("Round 1:", "Masses after round 1", "Masses after round 2"):
        stage.observer.wait_for(lambda said=said: said in process.output or not process.running, said)
    assert status(stage, process) == 0, process.output
    assert "Stopped after 2 rounds (--rounds)" in process.output
    rounds = sorted((stage.folder / "out").iterdir())
    assert f"Identified from 2 rounds: {rounds[1] / 'identified.urdf'}" in process.output
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
    assert abs(end["mass"] - HEAVIER * NOMINAL) < 0.5 * (HEAVIER - 1.0) * NOMINAL, "nearer to the truth than the URDF"


def test_a_round_that_is_stopped_ends_it_and_the_way_to_go_on_is_said(stage: Stage) -> None:
    heard = stage.observer.collect(JointState, "/joint_states")
    controller(stage)
    process = learn(stage, *IN_TIME, "--execute", "--yes", *PATIENT)

    def in_round_2() -> bool:
        assert process.running, process.output
        announced = "the motion:" in process.output.partition("Round 2:")[2]
        return announced and bool(np.max(np.abs(heard[-1].velocity)) > MOVING)

    stage.observer.wait_for(in_round_2, "the motion of round 2")
    process.send(signal.SIGINT)
    assert status(stage, process) == 2
    said, first = process.output.partition("Error: ")[2], stage.folder / "out/round1"
    assert "round 2: the motion was stopped: interrupted. The robot is at rest." in said
    assert f"The result so far is in {first}. To continue, repeat the command with --from {first}" in said
    on = learn(stage, *IN_TIME, "--from", first / "estimate.json", "--out", stage.folder / "on")
    assert status(stage, on) == 0, on.output
    reports = (stage.folder / out / "round1/excitation.json" for out in ("out", "on"))
    nothing, known = (json.loads(report.read_text())["expected"]["before"]["error"] for report in reports)
    assert known < 0.5 * nothing


def test_before_anything_is_identified_there_is_nothing_to_go_on_from(stage: Stage) -> None:
    controller(stage)
    said = refused(stage, "--execute", "--yes", "--controller", "/nobody")
    assert "round 1: --controller /nobody" in said
    assert "Nothing is identified yet. To start again, repeat the command with another --out" in said
