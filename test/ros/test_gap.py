"""The node notices a change, and finds in what it remembers what ``geomid gap`` finds in a bag."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from commands.running import done, found_only
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from files.recordings import BAGS, Recorded, write_bag
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from .in_motion import InMotion, noisy
from .observer import latched
from .stage import Stage, description, staged

URDF = BAGS / "arm3.urdf"
ARM3 = {"robot_description": description("arm3")}
SECONDS = 32.0
CHANGE = 22.0  # [s] when the friction grows
LEVEL, NOISE = 1.0, 0.05  # [N m] of the friction at joint2; of all efforts
LOOKING = (True, "search started; the result is published on ~/gap")


@pytest.fixture(scope="module")
def rubbing() -> list[Recorded]:
    """Joint messages of a small arm with friction that its description lacks."""
    arm = InMotion(description("arm3"), duration=SECONDS, rate=100.0, seed=5, swing=0.8, error=0.0)
    efforts, rubs = noisy(arm.efforts(friction=False), NOISE, seed=1), arm.joints.index("joint2")
    efforts[:, rubs] += LEVEL * np.sign(arm.samples.velocity[:, rubs])
    return arm.joint_states(efforts)


def seconds(items: list[Recorded], begin: float, end: float) -> list[Recorded]:
    """Those of a part of the time."""
    first = items[0].time
    return [item for item in items if begin <= (item.time - first) * 1e-9 < end]


def growing(items: list[Recorded]) -> list[Recorded]:
    """The same from a robot at whose second joint friction grows in the middle."""
    changed = []
    for item in items:
        late = (item.time - items[0].time) * 1e-9 >= CHANGE
        more = LEVEL * np.sign(item.message.velocity) * (np.array(item.message.name) == "joint2")
        changed.append(item.changed(effort=item.message.effort + more) if late else item)
    return changed


@dataclass
class Found:
    """What the node says, and what is said of the bag."""

    offline: dict[str, Any]
    short: list[str] = field(default_factory=list)
    live: dict[str, Any] = field(default_factory=dict)
    watched: Any = None
    status: Any = None


@pytest.fixture(scope="module")
def found(rubbing: list[Recorded], tmp_path_factory: pytest.TempPathFactory) -> Found:
    """A node that hears the arm, and is asked: before any data, too soon, and in the end, which waits for no search."""
    folder = tmp_path_factory.mktemp("found")
    bag = write_bag(folder / "bag", rubbing)
    with pytest.MonkeyPatch.context() as patch:
        found_only(patch)
        run = Found(json.loads(done("gap", bag, "--urdf", URDF, "--out", folder / "out", "--json", "--no-report")))
    with staged(folder) as stage:
        node = stage.node({**ARM3, "solve_period": 0.5, "output_folder": str(folder / "saved")})
        trigger = stage.observer.trigger
        findings = stage.observer.collect(String, "/geomid/gap", latched())
        assert trigger("/geomid/find_gap") == (False, "no data yet")
        for begin, end in ((0, 20), (20, 150), (150, len(rubbing))):
            stage.observer.publish(rubbing[begin:end], {"/joint_states": JointState})
            stage.fed({"joint_states": end})
            if end == len(rubbing):
                run.watched = stage.observer.diagnostics(lambda values, _: "gap joint1" in values, "a watch").status[0]
            findings.clear()
            assert trigger("/geomid/find_gap") == LOOKING
            if end == len(rubbing):
                assert trigger("/geomid/find_gap") == (False, "already running; the result is published on ~/gap")
            stage.observer.wait_for(lambda: findings, "a finding")
            run.live = json.loads(findings[0].data)
            run.short += [run.live["error"]] if "error" in run.live else []
        late = stage.observer.collect(String, "/geomid/gap", latched())
        stage.observer.wait_for(lambda: late, "a finding for those who come late")
        assert late[-1].data == findings[0].data
        run.status = finding(stage)
        assert trigger("/geomid/find_gap") == LOOKING
        assert node.end() == 0, "though it looks"
        assert (folder / "saved/estimate.json").exists()
    return run


def finding(stage: Stage) -> Any:
    """The first status of a search that has ended."""
    arrays = stage.observer.collect(DiagnosticArray, "/diagnostics")

    def look() -> Any:
        for array in arrays:
            for status in array.status:
                if status.name == "geomid: gap finding" and not status.message.startswith("looking"):
                    return status
        return None

    return stage.observer.wait_for(look, "a status of the finding")


def test_too_little_is_answered_with_one_sentence(found: Found) -> None:
    assert len(found.short) == 2
    for sentence in found.short:
        assert sentence.startswith("no finding: too short: ")
        assert "half a minute" in sentence


OF_PAGES = {
    *("ranking", "located", "units", "bodies", "cutoff", "seconds", "judged_seconds"),
    *("robot", "recordings", "known", "not_simulated", "handover"),
}


def test_live_finds_what_is_found_in_the_bag(found: Found) -> None:
    """The same document, but for what is simulated again from files, and for what only a page and files need."""
    assert found.live.keys() == found.offline.keys() - OF_PAGES
    assert found.live["resimulated"] is None
    assert found.live["verdict"] == found.offline["verdict"]
    first = found.live["findings"][0]
    assert (first["effect"], first["joint"]) == ("coulomb_friction", "joint2")
    assert first["parameters"]["level"]["value"] == pytest.approx(LEVEL, rel=0.05)
    assert [[f["effect"], f["joint"]] for f in found.live["findings"]] == [
        [f["effect"], f["joint"]] for f in found.offline["findings"]
    ]
    for ours, theirs in zip(found.live["findings"], found.offline["findings"], strict=True):
        assert ours["parameters"].keys() == theirs["parameters"].keys()
        for name, quantity in ours["parameters"].items():
            assert quantity["unit"] == theirs["parameters"][name]["unit"]
            for key in ("value", "std"):
                assert quantity[key] == pytest.approx(theirs["parameters"][name][key], rel=1e-6)
    for kind, ratios in found.live["gap"].items():
        assert ratios == pytest.approx(found.offline["gap"][kind], rel=1e-6)


def test_diagnostics_tell_the_finding(found: Found) -> None:
    """What was there from the beginning opens no gap: the estimate has it."""
    values = {pair.key: pair.value for pair in found.status.values}
    assert found.status.level == DiagnosticStatus.WARN
    assert "Coulomb friction at joint2" in found.status.message
    assert values["verdict"] == found.live["verdict"]
    assert values["finding 1"] == found.live["findings"][0]["sentence"]
    assert float(values["joint2 before"]) > 2.0 > float(values["joint2 after"])
    assert {"gap joint1", "gap joint2", "gap joint3"} <= {pair.key for pair in found.watched.values}
    assert "gap" not in found.watched.message


def test_friction_that_grows_opens_a_gap(stage: Stage, rubbing: list[Recorded]) -> None:
    """At its joint and no other, once it grows and not before; and it stays, until all is forgotten."""
    stage.node({**ARM3, "solve_period": 0.5})
    observer, items = stage.observer, growing(rubbing)
    before, after = seconds(items, 0.0, CHANGE), seconds(items, CHANGE, SECONDS)
    told = observer.collect(String, "/geomid/gap/open", latched())
    observer.publish(before, {"/joint_states": JointState})
    first = stage.fed({"joint_states": len(before)}).status[0]
    assert not first.message.startswith("gap"), first.message
    observer.publish(after, {"/joint_states": JointState})

    def opened(_: dict[str, str], status: Any) -> bool:
        return status.message.startswith("gap at ")

    status = observer.diagnostics(opened, "a gap").status[0]
    assert status.level == DiagnosticStatus.WARN
    assert status.message.startswith("gap at joint2: ")
    assert "also" not in status.message
    width = {pair.key: float(pair.value) for pair in status.values if pair.key.startswith("gap ")}
    assert width["gap joint2"] > 5.0
    assert max(width["gap joint1"], width["gap joint3"]) < 2.0
    findings = observer.collect(String, "/geomid/gap", latched())
    assert observer.trigger("/geomid/find_gap") == LOOKING
    observer.wait_for(lambda: findings, "a finding")
    document = json.loads(findings[0].data)
    assert document["compared_with"].startswith("compared with the estimate before the gap")
    (found,) = (f for f in document["findings"] if f["confidence"] == "confident")
    assert found["joint"] == "joint2"
    assert found["parameters"]["level"]["value"] == pytest.approx(2.0 * LEVEL, rel=0.05), "as it is now"
    assert found["was"]["level"] == pytest.approx(LEVEL, rel=0.05), "as it was"
    assert observer.trigger("/geomid/reset")[0]
    observer.diagnostics(lambda values, _: "gap joint2" not in values, "a watch that starts afresh")
    observer.wait_for(lambda: len(told) > 2, "the end of the gap")
    assert [[gap["channel"] for gap in json.loads(message.data)["gaps"]] for message in told] == [[], ["joint2"], []]
