"""Mistakes as people make them: each is answered with what to do, by status 2 and no files or by a doubt that names its
cause."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from files.recordings import BAGS, TYPES, Recorded, altered, recorded, write_bag
from rosbags.rosbag2 import StoragePlugin, Writer

from .running import NO_CHOICE, geomid, refused

pytestmark = pytest.mark.usefixtures("found_only")

BAG, URDF = BAGS / "arm3", BAGS / "arm3.urdf"
ARM3 = URDF.read_text()
OTHER = ("--urdf", BAGS / "arm7.urdf")
ROBOT = ("--urdf", URDF)
DEGREES = 180.0 / np.pi
Arguments = Sequence[str | Path]


def typed(*arguments: str | Path) -> Callable[[Path], Arguments]:
    """``geomid identify`` with the small arm's bag."""
    return lambda _: ("identify", BAG, *arguments)


def on(change: Callable[[Recorded], Recorded | None], *arguments: str | Path) -> Callable[[Path], Arguments]:
    """``geomid identify`` with another recording than the small arm's."""
    return lambda folder: ("identify", altered(BAG, folder / "bag", change), *(arguments or ROBOT))


def joints(**change: Callable[[Any], Any]) -> Callable[[Recorded], Recorded]:
    """Changes these fields of joint messages."""

    def changed(item: Recorded) -> Recorded:
        if item.topic != "/joint_states":
            return item
        return item.changed(**{name: make(getattr(item.message, name)) for name, make in change.items()})

    return changed


def stamp_of_zero(item: Recorded) -> Recorded:
    if not hasattr(item.message, "header"):
        return item
    header = item.message.header
    return item.changed(header=replace(header, stamp=replace(header.stamp, sec=0, nanosec=0)))


def under(namespace: str) -> Callable[[Recorded], Recorded]:
    return lambda item: replace(item, topic=namespace + item.topic) if item.topic == "/joint_states" else item


def with_text(name: str, text: str, *arguments: str | Path) -> Callable[[Path], Arguments]:
    """``geomid identify`` with a file of this name, which the last of the arguments is to name."""

    def make(folder: Path) -> Arguments:
        (folder / name).write_text(text)
        return ("identify", *arguments, folder / name)

    return make


def with_urdf(change: Callable[[str], str]) -> Callable[[Path], Arguments]:
    """``geomid identify`` with the small arm's URDF changed."""
    return with_text("changed.urdf", change(ARM3), BAG, "--urdf")


def with_pipe(folder: Path) -> Arguments:
    os.mkfifo(folder / "pipe")
    return "identify", BAG, "--urdf", folder / "pipe"


def as_xacro(text: str) -> str:
    declared = text.replace("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"', 1)
    return declared.replace("<link", '<xacro:arg name="a" default="1"/><link', 1)


def configured(text: str) -> Callable[[Path], Arguments]:
    return with_text("robot.yaml", f"/**: {{ros__parameters: {text}}}", BAG, *ROBOT, "--config")


def seconds(command: str, count: float) -> Callable[[Path], Arguments]:
    """A command with the beginning of the small arm's recording."""

    def make(folder: Path) -> Arguments:
        messages = recorded(BAG)
        end = messages[0].time + count * 1e9
        return command, write_bag(folder / "bag", [item for item in messages if item.time < end]), *ROBOT

    return make


def latin(path: Path) -> Path:
    path.write_text(f"<!-- Gelenk für links -->\n{ARM3}", encoding="latin-1")
    return path


REFUSED: dict[str, tuple[Callable[[Path], Arguments], str]] = {
    "1 another joint topic": (typed(*ROBOT, "--joint-topic", "/joint_state"), r"--joint-topic names.*/joint_states \("),
    "2 a namespace": (on(under("/robot1")), r"no topic /joint_states.*--joint-topic.*/robot1/joint_states"),
    "5 other names": (on(joints(name=lambda _: ["a", "b", "c"])), r"none of the messages' names is a joint.*'a', 'b'"),
    "6 one other name": (
        on(joints(name=lambda names: ["elbow" if name == "joint2" else name for name in names])),
        r"'joint2' is missing: .*--lock.*joint_states \(--merge\); or is it 'elbow'\? Or the .*in no message: joint2$",
    ),
    "7 no efforts": (
        on(joints(effort=lambda _: np.array([]))),
        r"no effort is measured \(empty, NaN or zero.*--wrench",
    ),
    "8 efforts of zero": (on(joints(effort=np.zeros_like)), r"zero throughout\).*Let the driver publish efforts"),
    "14 stamps of zero": (on(stamp_of_zero), r"stamp is zero: whoever publishes has to fill in header.stamp$"),
    "15 a second": (seconds("identify", 1.0), r"shorter than the filter's window.*record half a minute"),
    "18 a folder of two robots": (
        lambda _: ("identify", BAGS, *OTHER),
        r"arm3: .*'joint4' is missing.*another robot\. The URDF's .*: joint1, ",
    ),
    "21 no such URDF": (typed("--urdf", "nope.urdf"), r"nope.urdf: the robot description cannot be read"),
    "23 effect": (typed(*ROBOT, "--effects", "coulomb"), r"Did you mean 'coulomb_friction'\?"),
    "27 another link": (
        typed(*ROBOT, "--wrench", "/wrench:link3:mounted"),
        r"frame 'wrist_ft' is not the declared 'link3'; --wrench sets the frame.*wrench\.\*\.frame_id",
    ),
    "29 wrench's topic": (
        typed(*ROBOT, "--wrench", "/ft:wrist_ft:mounted"),
        r"no topic /ft; --wrench, or .* in a parameter file, names another.*/wrench \(",
    ),
    "32 floating": (
        typed(*ROBOT, "--floating-base"),
        r"needs --contacts, the feet on the ground, or at least one wrench sensor of role external",
    ),
    "36 fitted and judged": (
        typed(*ROBOT, "--validate", BAG),
        r"given twice\. .*without --validate the end of each bag",
    ),
    "41 hidden effect": (
        lambda folder: ("simulate", folder / "bag", "--hide", "coulomb:joint2"),
        r"unknown effect 'coulomb'. Did you mean 'coulomb_friction'\?",
    ),
    "44 no payload": (lambda _: ("export", URDF, "--for", "ur"), r"Name it with --frame: base_link"),
    "52 robot": (
        lambda folder: ("simulate", folder / "bag", "--robot", "panda"),
        r"Valid: arm3, arm7, path/to/your.urdf",
    ),
    "53 simulated by itself": (
        lambda _: ("gap", BAG, *ROBOT, "--simulated", BAG),
        r"the same positions as in .*: no simulator made them. Record what yours does",
    ),
    "lock": (typed(*ROBOT, "--lock", "finger"), r"unknown joint to lock 'finger'.*joint1"),
    "unknown option": (typed(*ROBOT, "--ouput", "x"), "--ouput.*--out"),
    "a command": (lambda _: ("identfy", BAG), r"unknown command 'identfy'. Did you mean 'identify'\?"),
    # bags
    "no such bag": (lambda folder: ("identify", BAG, folder / "nowhere", *ROBOT), "nowhere: no such bag"),
    "no odometry": (typed(*ROBOT, "--floating-base", "--wrench", "/wrench:odom:external"), "no topic /odom.*--odom"),
    "a tf_prefix": (
        on(joints(name=lambda names: [f"left_{name}" for name in names])),
        r"joint 'joint1' is missing: the messages' names have the prefix 'left_'. Give the URDF with it",
    ),
    # robot descriptions
    "a prefix in the URDF": (
        with_urdf(lambda text: text.replace('name="joint', 'name="left_joint')),
        r"joint 'left_joint1' is missing: the URDF's names have the prefix 'left_', the messages' do not",
    ),
    "none recorded": (
        on(lambda item: None if item.topic == "/robot_description" else item, "--cutoff", "3"),
        r"bag: no robot description is recorded \(robot_description, std_msgs/msg/String\); name a file with --urdf",
    ),
    "a pipe": (with_pipe, "pipe: not a regular file; expected a robot description"),
    "a device": (typed("--urdf", "/dev/zero"), "/dev/zero: not a regular file"),
    "SDF": (
        with_urdf(lambda _: "<sdf/>"),
        r"changed.urdf: not a URDF, its root element is <sdf>.*URDF or xacro that it",
    ),
    "MJCF": (with_urdf(lambda _: "<mujoco/>"), r"changed.urdf: not a URDF.*MJCF.*Give the robot's URDF"),
    "xacro": (with_urdf(as_xacro), r"changed.urdf: a xacro file.*: xacro \S*changed.urdf > robot.urdf"),
    "no mass at all": (
        with_urdf(lambda text: re.sub("<inertial>.*?</inertial>", "", text, flags=re.DOTALL)),
        r"changed.urdf: no moving link has a mass.*'geomid prior URDF --mass KG'",
    ),
    # what does not fit the robot or the recording
    "gain of no joint": (configured("{joint: {elbow: {effort_gain: 2}}}"), r"joint .*'elbow'.*joint1, joint2, joint3"),
    "cutoff too high": (
        configured("{filter: {cutoff: 90}}"),
        r"cutoff of 90 Hz is too high for data at 100 Hz: set the parameter filter.cutoff \(--cutoff\) to 40 or less",
    ),
    "a URDF for a model": (typed(*ROBOT, "--model", URDF), r"arm3.urdf: the model cannot be read, it must be JSON as"),
    "a URDF in Latin": (
        lambda folder: ("identify", BAG, "--urdf", latin(folder / "a.urdf")),
        r"a.urdf: .*cannot be read.*save it as UTF-8",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_it_is_refused_with_what_to_do(case: str, tmp_path: Path) -> None:
    make, words = REFUSED[case]
    command, *arguments = make(tmp_path)
    text = refused(command, *arguments, *(("--out", tmp_path / "out") if command == "identify" else ()))
    assert re.search(words, text.strip()), text
    assert not (tmp_path / "out").exists()


def half_of(item: Recorded) -> Recorded:
    """The first joint's efforts fail throughout."""
    return joints(effort=lambda effort: np.where(np.arange(3) == 0, np.nan, effort))(item)


def standing(item: Recorded) -> Recorded:
    noise = np.random.default_rng(item.time).normal(size=3)
    return joints(
        position=lambda _: 1e-6 * noise, velocity=lambda _: 1e-5 * noise, effort=lambda _: 1.0 + 1e-2 * noise
    )(item)


WITHOUT_A_MASS = re.sub('(<link name="link2">.*?<mass value=")[^"]*', r"\g<1>0", ARM3, count=1, flags=re.DOTALL)
SAID: dict[str, tuple[Callable[[Path], Arguments], int, str]] = {
    "4 degrees": (
        on(joints(position=lambda p: DEGREES * p, velocity=lambda v: DEGREES * v)),
        4,
        r"DOUBTFUL: joint positions are in degrees.* send messages in rad",
    ),
    "10 one effort missing": (
        on(half_of),
        0,
        r"Warning: most of the time no effort is measured at '\w+': it is left out",
    ),
    "12 amperes": (on(joints(effort=lambda e: e / 11.0)), 4, r"DOUBTFUL: .*in A, .*about effort_gain: \d"),
    "13 standing still": (on(standing), 4, r"DOUBTFUL: the robot is at rest: .*record a motion of all joints"),
    "a link without a mass": (
        with_text("light.urdf", WITHOUT_A_MASS, BAG, "--urdf"),
        0,
        r"Warning: 'link2' moves without a mass in the URDF: .*'geomid prior'",
    ),
    "22 no URDF": (typed(), 0, r"Note: no --urdf is given: using the description of /robot_description in \S*arm3"),
}


@pytest.mark.parametrize("case", SAID)
def test_it_is_said_before_the_result(case: str, tmp_path: Path) -> None:
    make, status, words = SAID[case]
    result = geomid(*make(tmp_path), *NO_CHOICE, "--no-report", "--out", tmp_path / "out")
    assert result.exit_code == status, result.output
    remarks = " ".join(result.stdout.partition("joint_states: ")[0].split())
    assert re.search(words, remarks), remarks


def test_a_bag_of_humble_is_read(tmp_path: Path) -> None:
    """Rows 17 and 49: an older description of the files, in a database; and nothing but JSON on the standard output."""
    with Writer(tmp_path / "humble", version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections: dict[str, Any] = {}
        for item in recorded(BAG):
            if item.topic not in connections:
                connections[item.topic] = writer.add_connection(item.topic, item.kind, typestore=TYPES)
            writer.write(connections[item.topic], item.time, bytes(TYPES.serialize_cdr(item.message, item.kind)))
    result = geomid("identify", tmp_path / "humble", *ROBOT, *NO_CHOICE, "--json", "--out", tmp_path / "out")
    assert (result.exit_code, result.stderr) == (0, "")
    assert json.loads(result.stdout)["converged"] is True


def test_results_of_before_stay_when_there_are_no_new_ones(tmp_path: Path) -> None:
    (tmp_path / "estimate.json").write_text("of last year")
    refused("identify", BAG, *ROBOT, "--out", tmp_path, "--effects", "friction")
    assert [path.name for path in tmp_path.iterdir()] == ["estimate.json"]
    assert "--out" in refused("identify", BAG, *ROBOT, "--out", tmp_path / "estimate.json"), "a file"
    assert (tmp_path / "estimate.json").read_text() == "of last year"


@pytest.mark.parametrize(
    ("megabytes", "module"),
    [(200, "geomid_ros"), (400, "geomid_ros"), (300, "geomid_ros.ros.main")],
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


def test_ctrl_c_is_no_result(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of ``verify``, status 1 says that a requirement does not hold."""

    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("geomid_ros.commands.check_memory", interrupted)
    ended = geomid("verify", "estimate.json", "--validate", BAG)
    assert (ended.exit_code, ended.output) == (130, "Interrupted.\n")


def printed(out: int, *arguments: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """``geomid`` with this file as its standard output."""
    code = "from geomid_ros.commands import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env=os.environ | environment,
        stdout=out,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )


def test_output_that_nobody_reads_costs_no_result(tmp_path: Path) -> None:
    """As by ``| head``."""
    reader, writer = os.pipe()
    os.close(reader)
    ended = printed(writer, "identify", BAG, *ROBOT, *NO_CHOICE, "--no-report", "--out", tmp_path)
    os.close(writer)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert (tmp_path / "estimate.json").is_file()


def test_output_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    with Path("/dev/full").open("wb") as full:
        ended = printed(full.fileno(), "--help")
    assert ended.returncode == 2
    assert ended.stderr == "Error: standard output cannot be written: No space left on device\n"
    with (tmp_path / "ascii").open("wb") as file:
        arguments = ("identify", BAG, *ROBOT, *NO_CHOICE, "--no-report", "--out", tmp_path)
        ended = printed(file.fileno(), *arguments, PYTHONIOENCODING="ascii")
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "In the tables ? is one standard deviation." in (tmp_path / "ascii").read_text()
