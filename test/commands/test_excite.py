"""``geomid excite``: from a URDF to a trajectory, and what is refused."""

from __future__ import annotations

import json
import re
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import click
import numpy as np
import pytest
import yaml
from excitation.arm import urdf
from files.recordings import BAGS
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from geomid_ros.files.trajectories import read_trajectory

from .running import WRIST, done, link, read, refused

QUICK = ("--duration", "6", "--repeats", "2")

pytestmark = pytest.mark.usefixtures("without_pictures")


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("excite") / "small.urdf"
    path.write_text(urdf())
    return path


@pytest.fixture(scope="module")
def folder(arm: Path) -> Path:
    out = arm.parent / "out"
    text = done("excite", "--urdf", arm, *QUICK, "--avoid", "plane:0,0,1,-0.2", "--out", out)
    expected = "Expected RMS prediction error of efforts on other motions, in units of the noise:"
    derived = ("acceleration limits are derived", "jerk limits are 10")
    assert all(said in text for said in (*derived, "Smallest distance:", expected, "trajectory.yaml"))
    return out


def test_the_files_say_the_same_motion_with_margins_and_clearances(folder: Path) -> None:
    document = yaml.safe_load((folder / "trajectory.yaml").read_text())
    assert document["joint_names"] == ["j1", "j2", "j3"]
    points = document["points"]
    times = np.array([p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points])
    assert np.allclose(times, np.arange(601) / 100.0)
    position, velocity, acceleration = (
        np.array([point[kind] for point in points]) for kind in ("positions", "velocities", "accelerations")
    )
    assert np.allclose(np.gradient(position, times, axis=0)[1:-1], velocity[1:-1], atol=5e-3)
    for ends in (velocity, acceleration):
        assert np.allclose(ends[[0, -1]], 0.0, atol=1e-6)
    assert np.allclose(position[:301], position[300:], atol=1e-9)
    again = read_trajectory(folder / "trajectory.yaml")
    assert np.array_equal(again.positions, position)
    assert again.duration == 6.0
    table = np.loadtxt(folder / "trajectory.csv", delimiter=",", skiprows=1)
    assert np.allclose(table, np.column_stack([times, position, velocity, acceleration]))
    with AnyReader([folder / "trajectory_bag"], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as bag:
        ((connection, _, data),) = list(bag.messages())
        message = bag.deserialize(data, connection.msgtype)
    assert connection.msgtype == "trajectory_msgs/msg/JointTrajectory"
    assert list(message.joint_names) == document["joint_names"]
    assert np.allclose([point.positions for point in message.points], position)
    assert message.points[-1].time_from_start.sec == 6
    report = json.loads((folder / "excitation.json").read_text())
    assert all(share <= 1.0 for used in report["used"].values() for share in used.values())
    assert all(entry["at_least"] >= entry["clearance"] for entry in report["distances"])
    assert any(entry["second"].startswith("plane:") for entry in report["distances"])
    assert report["expected"]["designed"]["error"] < report["expected"]["before"]["error"]
    assert (folder / "excitation.png").stat().st_size > 10_000


def test_what_a_wrench_sensor_told_is_known(wrist: Path, tmp_path: Path) -> None:
    """The sensor is recorded, so that a motion tells of what it carries, too."""
    command = ("excite", "--from", wrist / "estimate.json", "--urdf", BAGS / "arm3.urdf", *QUICK)
    text = done(*command, *WRIST, "--out", tmp_path / "next")
    assert re.search("Wrench offset fx .*Wrench offset tz ", " ".join(text.split()))
    expected = json.loads((tmp_path / "next/excitation.json").read_text())["expected"]
    before, after = (expected[stage]["links"]["wrist_ft"]["mass"] for stage in ("before", "designed"))
    known = link(read(wrist), "wrist_ft")["std"]["mass"]
    assert before == pytest.approx(known, rel=1e-2), "the result allows for offsets as large as their first fit"
    assert before <= known
    assert after < 0.8 * before  # joint efforts alone would tell of it in tens of grams, not in one
    assert "declare the same mounted wrench sensors" in refused(*command)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "no robot is given"),
        (("--urdf", "ARM", "--start", "1,2"), "--start has 2 numbers, expected 3: those of j1, j2, j3"),
        (("--urdf", "ARM", "--start", "a,b"), "expected numbers"),
        (("--urdf", "ARM", "--for", "fun"), "aim 'fun'"),
        (("--urdf", "ARM", "--for", "link:wing"), "'wing'"),
        (("--urdf", "ARM", "--avoid", "cone:1"), "--avoid cone:1: expected box:"),
        (("--urdf", "ARM", "--avoid", "box:0,0,0,1,1,0"), "edges greater than zero"),
        (("--urdf", "ARM", "--avoid", "plane:0,0,0,1"), "the normal of the plane is zero"),
        (("--urdf", "ARM", "--avoid", "box:0,0,0,9,9,9"), "or make room: --avoid is in metres in the base frame"),
        (("--urdf", "ARM", "--avoid", "plane:0,0,1,-1", "--no-collision"), "exclude each other"),
        (("--urdf", "ARM", "--lock", "wrist"), "'wrist'"),
        (("--urdf", "ARM", "--limits", "nowhere.yaml"), "nowhere.yaml"),
        (("run", "nowhere.yaml"), "nowhere.yaml: the trajectory cannot be read"),
        (("run", "nowhere.yaml", "--urdf", "no.urdf"), "no.urdf: the robot description cannot be read"),
    ],
)
def test_what_is_refused(arm: Path, arguments: tuple[str, ...], message: str) -> None:
    if "run" in arguments:
        pytest.importorskip("rclpy")
    assert message in refused("excite", *(str(arm) if argument == "ARM" else argument for argument in arguments))


def test_nothing_is_written_where_nothing_is_worth_it(arm: Path, tmp_path: Path) -> None:
    text = done("excite", "--urdf", arm, *QUICK, "--until", "99.9%", "--out", tmp_path / "out")
    assert "Nothing was written: 6 s more would lower the expected error by" in text
    assert "less than 99.9%" in text
    assert not (tmp_path / "out").exists()
    assert "'5 apples' is not a share" in refused("excite", "--urdf", arm, "--until", "5 apples")


class Rounds:
    """Of which the first promises more than all others."""

    folder, number = Path(), 1

    def __init__(self, *_: object) -> None:
        self.found = False

    def design(self) -> SimpleNamespace:
        learning = SimpleNamespace(gain=0.04 if self.found else 0.5)
        return SimpleNamespace(learning=learning, not_worth=lambda until: f"less than {until:.0%}")

    def show(self, _: object) -> None:
        self.found = True

    def run(self, _: object, *, execute: bool) -> None:
        assert execute

    def identify(self) -> None:
        click.echo("identified")

    tell = identify


@pytest.mark.parametrize(("until", "said"), [("5%", "Stopped: less than 5%"), ("3%", "Stopped after 3 rounds")])
def test_rounds_end_where_another_is_not_worth_it(
    until: str, said: str, arm: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(import_module("geomid_ros.commands.excite"), "_LearningRounds", Rounds)
    arguments = ("--urdf", arm, "--execute", "--yes", "--rounds", "3", "--until", until, "--out", tmp_path)
    text = done("excite", "learn", *arguments)
    assert said in text
    assert text.count("identified") == (2 if until == "5%" else 4)
