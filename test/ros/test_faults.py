"""Bad messages are counted with the reason, and cost nothing but themselves."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from files.recordings import Recorded

from .stage import KINDS, NO_CHOICE, WRIST, Stage, description, messages

SAME = 1e-9  # relative: with the bad messages, and without
PARAMETERS = {**WRIST, **NO_CHOICE, "robot_description": description("arm3")}
HALF = 800


def stamped_later(item: Recorded, nanoseconds: int) -> Recorded:
    message = copy.deepcopy(item.message)
    message.header.stamp.nanosec += nanoseconds
    return replace(item, message=message)


def changed(item: Recorded, **fields: Any) -> Recorded:
    """A bad message on a stamp of its own, between two good ones."""
    return stamped_later(item.changed(**fields), 3_000_000)


def in_frame(item: Recorded, frame: str) -> Recorded:
    message = copy.deepcopy(item.message)
    message.header.frame_id = frame
    return stamped_later(replace(item, message=message), 3_000_000)


def unmeasured(item: Recorded) -> Recorded:
    message = copy.deepcopy(item.message)
    message.wrench.force.x = float("nan")
    return stamped_later(replace(item, message=message), 3_000_000)


def bad_messages(joints: Recorded, wrench: Recorded) -> dict[tuple[str, str], Recorded]:
    """One of each kind, by topic and the reason that is to be counted."""
    nan, three = float("nan"), joints.message.position
    names = list(joints.message.name)
    return {
        ("joint_states", f"position of '{names[0]}' not finite"): changed(joints, position=np.array([nan, 0.0, 0.0])),
        ("joint_states", "is missing"): changed(joints, name=[names[0], names[1], "other"]),
        ("joint_states", "missing or not finite"): changed(joints, effort=np.array([0.0, nan, 0.0])),
        ("joint_states", "position has 2 entries for 3 names"): changed(joints, position=three[:2]),
        ("joint_states", "effort has 1 entries for 3 names"): changed(joints, effort=three[:1]),
        ("joint_states", f"joint '{names[0]}' is named twice"): changed(joints, name=[names[0], names[0], names[2]]),
        ("joint_states", "no joint names"): changed(joints, name=[]),
        ("joint_states", "stamp not later"): stamped_later(joints, -1),
        ("/wrench", "wrench not finite"): unmeasured(wrench),
        ("/wrench", "frame 'tool' is not the declared 'wrist_ft'"): in_frame(wrench, "tool"),
        ("/wrench", "stamp not later"): wrench,
    }


def estimate(stage: Stage, items: list[Recorded], out: Path, name: str, expected: dict[str, int]) -> tuple[Any, Any]:
    """What a node of its own saves for messages, and its stream's last diagnostics."""
    parameters = {**PARAMETERS, "output_folder": str(out)}
    node = stage.node(parameters, "-r", f"__ns:=/{name}", "-r", "joint_states:=/joint_states", name=f"{name}/geomid")
    stage.observer.publish(items, KINDS)
    array = stage.fed(expected, f"{name}/geomid")
    assert stage.observer.trigger(f"/{name}/geomid/save")[0]
    assert node.end() == 0
    return json.loads((out / "estimate.json").read_text()), array.status[0]


def test_bad_messages_cost_only_themselves(stage: Stage, tmp_path: Path) -> None:
    good = messages()[:HALF]
    half = HALF // 2
    joints, wrench = good[half - 2 : half]
    if joints.topic == "/wrench":
        joints, wrench = wrench, joints
    bad = bad_messages(joints, wrench)
    mixed = [*good[:half], *bad.values(), *good[half:]]
    clean, _ = estimate(stage, good, tmp_path / "clean", "clean", {"joint_states": half, "/wrench": half})
    counts = {topic: half + sum(kind == topic for kind, _ in bad) for topic in ("joint_states", "/wrench")}
    dirty, status = estimate(stage, mixed, tmp_path / "dirty", "dirty", counts)
    values = {pair.key: pair.value for pair in status.values}
    for topic in counts:
        rejected = {key: int(value) for key, value in values.items() if key.startswith(f"{topic} rejected: ")}
        assert int(values[f"{topic} received"]) == int(values[f"{topic} accepted"]) + sum(rejected.values())
        assert int(values[f"{topic} accepted"]) == half
        for kind, reason in bad:
            if kind == topic:
                assert any(reason in key for key in rejected), (reason, rejected)
    assert dirty["rows"] == clean["rows"]
    for ours, theirs in zip(dirty["links"], clean["links"], strict=True):
        assert ours["mass"] == pytest.approx(theirs["mass"], rel=SAME)


def test_a_diagnostic_names_what_is_wrong_while_it_is(stage: Stage) -> None:
    node = stage.node(PARAMETERS)
    good = messages()
    nan = np.full(3, np.nan)
    bad = [item.changed(position=nan) if item.topic == "/joint_states" else item for item in good]
    stage.observer.publish(good[:200], KINDS)
    stage.observer.publish(bad[200:400], KINDS)
    reason = "joint_states rejected: position of 'joint1' not finite"
    stage.observer.diagnostics(lambda _, status: status.message.startswith(reason), reason)
    stage.observer.publish(good[400:], KINDS)
    last = stage.fed({"joint_states": 800, "/wrench": 800})
    stage.observer.diagnostics(lambda _, status: reason not in status.message, "it to be over")
    assert {pair.key: pair.value for pair in last.status[0].values}[reason] == "100", "it is still counted"
    assert node.end() == 0
    assert list(stage.folder.glob("process0/*")) == [], "without a folder nothing is written unasked"
