"""What people bring: descriptions in bags and in xacro, joints in no message, parameters as options."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from files.recordings import BAGS, QUICK, Recorded, altered, recorded, write_bag

import geomid_ros
from geomid_ros.files.models import urdf
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.recording import simulate

from .running import NO_CHOICE, done, geomid, read, refused

pytestmark = pytest.mark.usefixtures("found_only")

BAG, URDF = BAGS / "arm3", BAGS / "arm3.urdf"
ARM3 = URDF.read_text()
FINGER = """<link name="finger{n}"><inertial><mass value="{mass}"/><inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4"
  iyz="0" izz="1e-4"/></inertial></link><joint name="finger_joint{n}" type="prismatic"><origin xyz="0 0 0.1"/>
  <parent link="{parent}"/><child link="finger{n}"/><axis xyz="1 0 0"/>
  <limit lower="0" upper="0.04" effort="20" velocity="0.2"/>{mimic}</joint>"""


def with_gripper(mass: float = 0.05, parent: str = "tool") -> str:
    """The small arm with a finger, and another one that mimics it."""
    first = FINGER.format(n=1, mass=mass, parent=parent, mimic="")
    second = FINGER.format(n=2, mass=mass, parent=parent, mimic='<mimic joint="finger_joint1" multiplier="-1"/>')
    return ARM3.replace("</robot>", f"{first}{second}</robot>")


def links(out: Path) -> list[Any]:
    """What was found, without what takes its time."""
    return [{key: value for key, value in entry.items() if key != "merged"} for entry in read(out)["links"]]


def test_a_gripper_in_no_message_is_locked_as_if_it_had_been_named(tmp_path: Path) -> None:
    (tmp_path / "hand.urdf").write_text(with_gripper())
    arguments = ("identify", BAG, "--urdf", tmp_path / "hand.urdf", *NO_CHOICE, "--out")
    shown = " ".join(done(*arguments, tmp_path / "alone").split())
    assert "Note: no message names 'finger_joint1': locked at zero, as with locked_joints" in shown
    note, of_file = read(tmp_path / "alone")["notes"]
    assert note.startswith("no message names 'finger_joint1'")
    assert "no message names" in (tmp_path / "alone" / "report.html").read_text(encoding="utf-8")
    named = done(*arguments, tmp_path / "named", "--lock", "finger_joint1")
    assert "no message names" not in named
    assert read(tmp_path / "named")["notes"] == [of_file]
    assert links(tmp_path / "alone") == links(tmp_path / "named")
    assert {"finger1", "finger2"} <= set(read(tmp_path / "alone")["links"][-1]["merged"])


@pytest.mark.parametrize(
    ("moving", "status", "said"),
    [
        (False, 0, "Warning: joint_states: joint 'finger_joint1' is locked at zero, but stands at 0.03"),
        (True, 4, "DOUBTFUL: joint_states: joint 'finger_joint1' is locked at zero, but moves"),
    ],
)
def test_a_locked_joint_has_to_stand(moving: bool, status: int, said: str, tmp_path: Path) -> None:
    (tmp_path / "hand.urdf").write_text(with_gripper())
    bag = changed(tmp_path / "bag", lambda n, values: ([*n, "finger_joint1"], [*values, values[0] if moving else 0.03]))
    arguments = ("identify", bag, "--urdf", tmp_path / "hand.urdf", "--lock", "finger_joint1", "--no-report")
    shown = " ".join(done(*arguments, *NO_CHOICE, "--out", tmp_path, status=status).split())
    assert said in shown
    assert shown.count(said.partition(": ")[2]) == 1


def test_joints_that_the_robot_lacks_are_noted(tmp_path: Path) -> None:
    bag = changed(tmp_path / "bag", lambda names, values: ([*names, "finger", "thumb"], [*values, 0.0, 0.0]))
    said = "Note: joint_states: ignored, no moving joints of the robot: 'finger', 'thumb'"
    assert said in " ".join(done("payload", BAG, bag, "--urdf", URDF, "--frame", "tool").split())


@pytest.mark.parametrize(
    "case",
    ["heavy", "a sensor behind it", "an unknown name in the messages", "a joint behind it", "not at all in one bag"],
)
def test_what_matters_is_not_locked(case: str, tmp_path: Path) -> None:
    """A joint that is missing where it counts: its name, and the option that locks it."""
    (tmp_path / "hand.urdf").write_text(with_gripper(mass=2.0 if case == "heavy" else 0.05))
    arguments: list[str | Path] = ["identify", BAG, "--urdf", tmp_path / "hand.urdf"]
    if case == "a sensor behind it":
        arguments += ["--wrench", "/wrench:finger1:mounted"]
    if case == "an unknown name in the messages":
        arguments[1] = changed(tmp_path / "bag", lambda names, values: ([*names, "thumb"], [*values, 0.0]))
    if case == "a joint behind it":
        arguments[1] = changed(tmp_path / "bag", lambda names, values: without("joint2", names, values))
    if case == "not at all in one bag":
        arguments.insert(
            2, changed(tmp_path / "bag", lambda names, values: ([*names, "finger_joint1"], [*values, 0.0]))
        )
    text = refused(*arguments)
    missing = "joint2" if case == "a joint behind it" else "finger_joint1"
    assert re.search(rf"joint '{missing}' is missing.*locked_joints \(--lock\)", text), text


def without(name: str, names: list[str], values: list[float]) -> tuple[list[str], list[float]]:
    kept = [index for index, each in enumerate(names) if each != name]
    return [names[index] for index in kept], [values[index] for index in kept]


def changed(folder: Path, change: Any) -> Path:
    """The small arm's recording with other joints in its messages."""

    def make(item: Recorded) -> Recorded:
        if item.topic != "/joint_states":
            return item
        message = item.message
        fields = {
            key: np.array(change(list(message.name), list(getattr(message, key)))[1])
            for key in ("position", "velocity", "effort")
        }
        return item.changed(name=change(list(message.name), list(message.position))[0], **fields)

    return altered(BAG, folder, make)


@pytest.mark.usefixtures("in_a_step")
def test_options_win_over_the_parameter_file(tmp_path: Path) -> None:
    """Each option is a parameter: the same by either way, and the option where both say something."""
    (tmp_path / "robot.yaml").write_text(
        "/**: {ros__parameters: {filter: {cutoff: 4.0}, gravity: [0.0, 0.0, -9.7], effort_gain: 1.1,"
        " joint: {joint2: {effort_gain: 0.9}}}}"
    )
    (tmp_path / "wrong.yaml").write_text("/**: {ros__parameters: {filter: {cutoff: 7.0}, gravity: [0.0, 9.81, 0.0]}}")
    arguments = ("identify", BAG, "--urdf", URDF, *NO_CHOICE, "--no-report", "--out")
    options = ("--cutoff", "4", "--gravity", "0", "0", "-9.7", "--gain", "1.1", "--gain", "joint2=0.9")
    geomid(*arguments, tmp_path / "file", "--config", tmp_path / "robot.yaml")
    geomid(*arguments, tmp_path / "options", *options, "--config", tmp_path / "wrong.yaml")
    geomid(*arguments, tmp_path / "wrong", "--config", tmp_path / "wrong.yaml")
    assert links(tmp_path / "file") == links(tmp_path / "options") != links(tmp_path / "wrong")


@pytest.mark.usefixtures("in_a_step")
def test_a_description_in_a_namespace_is_found(tmp_path: Path) -> None:
    renamed = altered(BAG, tmp_path / "bag", lambda item: replace(item, topic=f"/cell{item.topic}"))
    options = ("--joint-topic", "cell/joint_states", *NO_CHOICE, "--out", tmp_path)
    shown = " ".join(geomid("identify", renamed, *options).stdout.split())
    assert f"using the description of /cell/robot_description in {renamed}" in shown


def test_two_descriptions_are_one_too_many(tmp_path: Path) -> None:
    def renamed(item: Recorded) -> Recorded:
        return item.changed(data=item.message.data.replace("arm3", "arm4")) if "description" in item.topic else item

    text = refused("identify", BAG, altered(BAG, tmp_path / "bag", renamed))
    assert re.search(
        r"several robot descriptions \(/robot_description in \S*arm3, .*bag\); choose one with --urdf", text
    )


def test_gap_and_payload_take_the_description_from_the_bags(tmp_path: Path) -> None:
    messages = recorded(BAG)
    short = [item for item in messages if item.time < messages[0].time + 1_000_000_000]
    bag, other = write_bag(tmp_path / "bag", short), write_bag(tmp_path / "other", short)
    for arguments in (("gap", bag), ("payload", bag, other)):
        assert re.search("too short|shorter than the filter's window", refused(*arguments))


XACRO = (
    ARM3.replace("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"', 1)
    .replace("<link", '<xacro:arg name="prefix" default=""/>\n<link', 1)
    .replace('"link1"', '"$(arg prefix)link1"')
)


@pytest.fixture
def robot_xacro(tmp_path: Path) -> Iterator[Path]:
    pytest.importorskip("xacro")
    (tmp_path / "robot.urdf.xacro").write_text(XACRO)
    return tmp_path / "robot.urdf.xacro"


@pytest.mark.usefixtures("in_a_step")
def test_a_xacro_is_run_with_its_arguments(robot_xacro: Path, tmp_path: Path) -> None:
    options = ("--xacro-arg", "prefix:=left_", *NO_CHOICE, "--no-report")
    geomid("identify", BAG, "--urdf", robot_xacro, *options, "--out", tmp_path / "xacro")
    geomid("identify", BAG, "--urdf", URDF, *NO_CHOICE, "--no-report", "--out", tmp_path / "plain")
    made, plain = links(tmp_path / "xacro"), links(tmp_path / "plain")
    assert (made[0].pop("name"), plain[0].pop("name")) == ("left_link1", "link1")
    assert made == plain
    assert '<link name="link1">' in geomid("export", robot_xacro, "--for", "urdf").stdout
    assert "xacro" not in (tmp_path / "xacro/identified.urdf").read_text().partition("<robot")[2]


def test_a_xacro_that_fails_says_why(robot_xacro: Path) -> None:
    robot_xacro.write_text(XACRO.replace("$(arg prefix)", "${length}"))
    text = refused("identify", BAG, "--urdf", robot_xacro)
    assert re.search(r"robot.urdf.xacro: xacro cannot make a URDF of it \(.*'length' is not defined", text), text


@pytest.mark.parametrize("forever", ["${max(i for i in python.range(10**12))}", "${'a' * 10**7}" * 3])
def test_a_xacro_is_bounded(forever: str, robot_xacro: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(urdf, "_SECONDS", 1)
    robot_xacro.write_text(XACRO.replace("$(arg prefix)", forever))
    assert re.search(
        r"xacro (takes longer than 1 s|cannot make a URDF)|larger than 5 MB",
        refused("identify", BAG, "--urdf", robot_xacro),
    )


def test_without_the_package_the_command_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(urdf, "find_spec", lambda _: None)
    (tmp_path / "robot.urdf.xacro").write_text(XACRO)
    text = refused("identify", BAG, "--urdf", tmp_path / "robot.urdf.xacro", "--xacro-arg", "prefix:=a b")
    assert re.search(r"convert it to a URDF: xacro \S*robot.urdf.xacro 'prefix:=a b' > robot.urdf", text), text


def test_only_a_file_that_is_called_so_is_run(tmp_path: Path) -> None:
    """A URDF of somebody else's runs nothing, whatever is in it."""
    (tmp_path / "robot.urdf").write_text(XACRO)
    assert "a xacro file; convert it with" in refused("identify", BAG, "--urdf", tmp_path / "robot.urdf")
    wrong = refused("identify", BAG, "--urdf", tmp_path / "robot.urdf", "--xacro-arg", "prefix:=a")
    assert "robot.urdf is not a .xacro file" in wrong
    assert "is not of the form NAME:=VALUE" in refused("identify", BAG, "--urdf", "a.xacro", "--xacro-arg", "prefix=a")


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Recorded], geomid_ros.Identification]:
    """Messages of the small arm in motion from the first one on, and what is identified from them."""
    pytest.importorskip("mujoco")
    bag = tmp_path_factory.mktemp("moving") / "bag"
    simulate(bag, SimulationOptions(robot="arm3", seed=2, duration=9.0, longest_step=QUICK))
    messages = recorded(bag)
    messages = [item for item in messages if item.time > messages[0].time + 1_500_000_000]
    return messages, geomid_ros.identify(write_bag(bag.parent / "cut", messages), URDF, candidates=[])


@pytest.mark.parametrize("stamps", ["new", "old"])
def test_messages_that_repeat_change_nothing(
    stamps: str, moving: tuple[list[Recorded], geomid_ros.Identification], tmp_path: Path
) -> None:
    """A driver that publishes twice as often as it measures: the same samples of what it measures."""

    def again(item: Recorded) -> Recorded:
        shift = 4_000_000
        header = item.message.header
        stamp = replace(header.stamp, nanosec=header.stamp.nanosec + (shift if stamps == "new" else 0))
        return replace(item.changed(header=replace(header, stamp=stamp)), time=item.time + shift)

    messages, once = moving
    messages = [one for item in messages for one in ([item, again(item)] if "joint" in item.topic else [item])]
    twice = geomid_ros.identify(write_bag(tmp_path / "twice", messages), URDF, candidates=[])
    for name in ("stamps", "position", "acceleration", "effort"):
        both = (np.concatenate([getattr(samples, name) for samples in found.train]) for found in (once, twice))
        np.testing.assert_array_equal(*both)
    (said,) = [warning for warning in twice.warnings if "messages are refused" in warning]
    assert "does the driver publish more often than it measures?" in said
    assert json.dumps(once.document["links"]) == json.dumps(twice.document["links"])
