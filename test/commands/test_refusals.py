"""Whatever is wrong with what ``geomid identify`` is given: status 2, one message that names it, and no files."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from files.recordings import BAGS, Recorded, altered

from .running import refused

BAG, URDF = BAGS / "arm3", BAGS / "arm3.urdf"
ARM3 = URDF.read_text()
Arguments = Sequence[str | Path]


def with_urdf(change: Callable[[str], str]) -> Callable[[Path], Arguments]:
    """The small arm's bag with its URDF changed."""

    def make(folder: Path) -> Arguments:
        (folder / "changed.urdf").write_text(change(ARM3))
        return BAG, "--urdf", folder / "changed.urdf"

    return make


def with_bag(change: Callable[[Recorded], Recorded | None]) -> Callable[[Path], Arguments]:
    """The small arm's URDF with a changed copy of its bag."""
    return lambda folder: (altered(BAG, folder / "changed", change), "--urdf", URDF)


def with_options(*options: str) -> Callable[[Path], Arguments]:
    return lambda _: (BAG, "--urdf", URDF, *options)


def with_file(option: str, text: str) -> Callable[[Path], Arguments]:
    """The small arm with an option that names a file with this text."""

    def make(folder: Path) -> Arguments:
        (folder / "file").write_text(text)
        return BAG, "--urdf", URDF, option, folder / "file"

    return make


def joints(**fields: object) -> Callable[[Recorded], Recorded]:
    """Changes joint messages."""
    return lambda item: item.changed(**fields) if item.topic == "/joint_states" else item


def without_topic(topic: str) -> Callable[[Recorded], Recorded | None]:
    return lambda item: None if item.topic == topic else item


def with_pipe(folder: Path) -> Arguments:
    os.mkfifo(folder / "pipe")
    return BAG, "--urdf", folder / "pipe"


def as_xacro(text: str) -> str:
    declared = text.replace("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"', 1)
    return declared.replace("<link", '<xacro:arg name="a" default="1"/><link', 1)


def cut_bag(folder: Path) -> Arguments:
    data = (BAG / "arm3.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(data[:60])
    return folder / "cut.mcap", "--urdf", URDF


def second_bag_bad(folder: Path) -> Arguments:
    return BAG, folder / "nowhere", "--urdf", URDF


NOTHING = np.array([])
CASES: dict[str, tuple[Callable[[Path], Arguments], str]] = {
    # bags
    "no such bag": (lambda folder: (folder / "nowhere", "--urdf", URDF), "nowhere: no such bag"),
    "second bag": (second_bag_bad, "nowhere: no such bag"),
    "bag to validate on": (with_options("--validate", "nowhere"), "nowhere: no such bag"),
    "bag cut off": (cut_bag, r"cut.mcap: truncated at byte .*no intact message"),
    "no joint states": (with_bag(without_topic("/joint_states")), r"no topic /joint_states.*--joint-topic.*/wrench"),
    "wrench on joints": (with_options("--wrench", "/joint_states:tool:mounted"), r"/joint_states is of type.*expected"),
    "no odometry": (with_options("--floating-base", "--wrench", "/wrench:odom:external"), "no topic /odom.*--odom"),
    "another robot's bag": (
        lambda _: (BAG, "--urdf", BAGS / "arm7.urdf"),
        r"arm3: no usable samples. joint_states: 800 of 800 .*'joint4' is missing.*moving joints: joint1.*joint7",
    ),
    "a tf_prefix": (
        with_bag(joints(name=["left_joint2", "left_joint3", "left_joint1"])),
        r"joint 'joint1' is missing: the messages' names have the prefix 'left_'. Give the URDF with it",
    ),
    "a prefix in the URDF": (
        with_urdf(lambda text: text.replace('name="joint', 'name="left_joint')),
        r"joint 'left_joint1' is missing: the URDF's names have the prefix 'left_', the messages' do not",
    ),
    "positions empty": (with_bag(joints(position=NOTHING)), r"position has 0 entries for 3 names"),
    "no names": (with_bag(joints(name=[])), "no joint names"),
    # robot descriptions
    "a folder as URDF": (
        lambda folder: (BAG, "--urdf", folder),
        r": not a regular file; expected a robot description",
    ),
    "a pipe as URDF": (with_pipe, "pipe: not a regular file; expected a robot description"),
    "a device as URDF": (
        lambda _: (BAG, "--urdf", "/dev/zero"),
        "/dev/zero: not a regular file",
    ),
    "a bag as URDF": (lambda _: (BAG, "--urdf", BAG / "arm3.mcap"), r"arm3.mcap: the robot description cannot be read"),
    "SDF": (
        with_urdf(lambda _: "<sdf/>"),
        r"changed.urdf: not a URDF, its root element is <sdf>.*URDF or xacro that it",
    ),
    "MJCF": (with_urdf(lambda _: "<mujoco/>"), r"changed.urdf: not a URDF.*MJCF.*Give the robot's URDF"),
    "xacro": (with_urdf(as_xacro), r"changed.urdf: a xacro file.*: xacro \S*changed.urdf > robot.urdf"),
    "xacro without its namespace": (
        with_urdf(lambda text: text.replace("<link", "<xacro:arg/><link", 1)),
        r"changed.urdf: a xacro file.*: xacro \S*changed.urdf > robot.urdf",
    ),
    "no mass at all": (
        with_urdf(lambda text: re.sub("<inertial>.*?</inertial>", "", text, flags=re.DOTALL)),
        r"changed.urdf: no moving link has a mass.*'geomid prior URDF --mass KG'",
    ),
    # options
    "merged link": (with_options("--links", "tool"), r"unknown link 'tool'.*Valid: link1, link2, link3"),
    "wrench's frame": (with_options("--wrench", "/wrench:wrist:mounted"), r"unknown link 'wrist'.*'wrist_ft'"),
    "wrench's axis": (with_options("--wrench", "/wrench:wrist_ft:mounted:fx,my"), r"unknown wrench axis 'my'.*fx, fy"),
    "wrench twice": (with_options(*2 * ("--wrench", "/wrench:wrist_ft:mounted")), "same topic|must differ"),
    "hold-out": (with_options("--hold-out", "1.5"), "--hold-out"),
    "URDF": (
        lambda folder: (altered(BAG, folder / "bare", without_topic("/robot_description")),),
        r"bare: no robot description is recorded \(robot_description, std_msgs/msg/String\); name a file with --urdf",
    ),
    "unknown option": (with_options("--ouput", "x"), "--ouput.*--out"),
    "no bag": (lambda _: ("--urdf", URDF), "BAGS"),
    # files of options
    "parameter": (
        with_file("--config", "/**: {ros__parameters: {filter: {cutof: 3}}}"),
        r"file: unknown parameter 'filter.cutof'. Did you mean 'filter.cutoff'\?",
    ),
    "parameter's value": (with_file("--config", "/**: {ros__parameters: {gamma: -1}}"), r"file: gamma is -1, expected"),
    "gain of no joint": (
        with_file("--config", "/**: {ros__parameters: {joint: {elbow: {effort_gain: 2}}}}"),
        r"joint .*'elbow'.*joint1, joint2, joint3",
    ),
    "cutoff too high": (
        with_file("--config", "/**: {ros__parameters: {filter: {cutoff: 90}}}"),
        r"cutoff of 90 Hz is too high for data at 100 Hz: set the parameter filter.cutoff \(--cutoff\) to 40 or less",
    ),
    "no such model": (with_options("--model", "no.json"), r"no.json: the model cannot be read"),
    "a model that is none": (with_file("--model", "{}"), r"file: not a model as geomid writes it"),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_refused(case: str, tmp_path: Path) -> None:
    make, message = CASES[case]
    out = tmp_path / "out"
    text = refused("identify", *make(tmp_path), "--out", out)
    assert re.search(message, text), text
    assert not out.exists()


def test_a_file_as_folder_for_results_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "results"
    path.write_text("of last year")
    assert "--out" in refused("identify", BAG, "--urdf", URDF, "--out", path)
    assert path.read_text() == "of last year"
    assert "cannot be written" in refused("identify", BAG, "--urdf", URDF, "--out", path / "below")


def test_results_of_before_stay_when_there_are_no_new_ones(tmp_path: Path) -> None:
    (tmp_path / "estimate.json").write_text("of last year")
    refused("identify", BAG, "--urdf", URDF, "--out", tmp_path, "--effects", "friction")
    assert [path.name for path in tmp_path.iterdir()] == ["estimate.json"]
    assert (tmp_path / "estimate.json").read_text() == "of last year"


def test_no_traceback_in_a_process_of_its_own(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "geomid_ros", "identify", str(tmp_path / "nowhere"), "--urdf", str(URDF)]
    result = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr == f"Error: {tmp_path / 'nowhere'}: no such bag\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("megabytes", "module"),
    [*((size, "geomid_ros") for size in (200, 300, 400)), *((size, "geomid_ros.ros.main") for size in (200, 300, 350))],
)
def test_too_little_memory_is_said_in_one_sentence(megabytes: int, module: str) -> None:
    """Whichever of the libraries finds no room, or would hang."""
    if module != "geomid_ros":
        pytest.importorskip("rclpy")
    code = (
        f"import resource, runpy, sys; resource.setrlimit(resource.RLIMIT_AS, ({megabytes}_000_000,) * 2);"
        f"sys.argv = ['geomid', 'identify', {str(BAG)!r}, '--urdf', {str(URDF)!r}, '--out', '/nowhere/out'];"
        f"runpy.run_module({module!r}, run_name='__main__')"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=300)
    assert "Traceback" not in result.stderr
    assert result.returncode == 2
    assert result.stderr.splitlines()[-1].endswith("check limits such as ulimit -v")
