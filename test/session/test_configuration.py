"""The table of parameters and the files that are read by it: what is valid is understood, the rest is named."""

from __future__ import annotations

import re
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import pytest
import yaml

from geomid_ros.errors import InputError
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.effects import DEFAULT_CANDIDATES
from geomid_ros.session.configuration import PARAMETERS, Configuration, find_parameter
from geomid_ros.session.session import Session

FILE = Path(__file__).parents[2] / "config/geomid.yaml"
KEY = re.compile(r"^( *)(# )?( *)([a-z_0-9.]+):( \S.*)?$")


def read(folder: Path, parameters: str) -> Configuration:
    """The configuration of a parameter file with these lines for the node."""
    lines = "".join(f"    {line}\n" for line in parameters.splitlines())
    (folder / "robot.yaml").write_text(f"/**:\n  ros__parameters:\n{lines}", encoding="utf-8")
    return Configuration.read(folder / "robot.yaml")


def uncommented() -> str:
    """The shipped file with everything in force that it only shows."""
    lines = []
    for line in FILE.read_text(encoding="utf-8").splitlines():
        match = KEY.match(line)
        lines.append("".join(part or "" for part in match.group(1, 3, 4)) + ":" + (match[5] or "") if match else line)
    return "\n".join(lines)


def test_the_shipped_file_gives_every_parameter_its_default_as_the_node_needs_it() -> None:
    """The node is strict where the command line is not: an integer for a real number, a list without type. Each is
    described as in the table, whose numbers have a range."""
    text, given = FILE.read_text(encoding="utf-8"), Configuration.read(FILE).given_values
    sections = yaml.safe_load(text)["/**"]["ros__parameters"]
    assert given.keys() == {parameter.name for parameter in PARAMETERS if "*" not in parameter.name}
    assert len({parameter.name for parameter in PARAMETERS}) == len(PARAMETERS)
    for parameter in PARAMETERS:
        last = parameter.name.rpartition(".")[2].replace("*", r"[a-z_.]+")
        assert re.search(rf"# {re.escape(parameter.description)}.*\n *(# *)?{last}:", text), parameter.name
        if "*" not in parameter.name:
            assert Configuration()[parameter.name] == given[parameter.name], parameter.name
            value = reduce(getitem, parameter.name.split("."), sections)
            assert (value, type(value)) == (parameter.default, type(parameter.default))
        if isinstance(parameter.default, float):
            assert parameter.minimum <= parameter.default <= parameter.maximum


def test_the_examples_in_the_shipped_file_are_valid(tmp_path: Path) -> None:
    path = tmp_path / "all.yaml"
    path.write_text(uncommented().replace('wrenches: [""]', 'wrenches: ["wrist"]'), encoding="utf-8")
    configuration = Configuration.read(path)
    assert configuration.sensors == [WrenchSensor("/wrench", "tool0", "mounted")]
    assert configuration.signals(["shoulder_pan_joint"]).effort_gain == {"shoulder_pan_joint": 13.6}
    channels = ["shoulder_pan_joint", "wrench/fx"]
    assert configuration.estimator(channels).sigma == {"shoulder_pan_joint": 0.5, "wrench/fx": 0.2}
    shown = {find_parameter(name).name for name in configuration.given_values}
    assert shown == {parameter.name for parameter in PARAMETERS}


class TestValues:
    """What may be written in a file."""

    def test_candidates_are_tried_with_some_constants_and_not_where_they_are_identified_anyway(self) -> None:
        assert {effect.name for effect in Configuration().candidates} == {*DEFAULT_CANDIDATES, "coulomb_friction"}
        configuration = Configuration({"effects": ["spring", "viscous_friction"], "candidates": ["spring"]})
        assert configuration.candidates == []
        several = Configuration({"candidates": ["stribeck_friction"]}).candidates
        assert len(several) == len(set(several)) > 1
        assert Configuration({"candidates": [""]}).candidates == []

    def test_gains_by_joint_stand_beside_the_common_one(self, tmp_path: Path) -> None:
        configuration = read(tmp_path, "effort_gain: 2\njoint:\n  left.elbow:\n    effort_gain: -13.6")
        gains = configuration.signals(["left.elbow", "wrist"]).effort_gain
        assert gains == {"left.elbow": -13.6, "wrist": 2.0}

    @pytest.mark.parametrize("key", ["left.wrist.ft.fx", "left/wrist.ft/fx"])
    def test_channels_may_be_named_with_dots(self, key: str, tmp_path: Path) -> None:
        channels = ["left/wrist.ft/fx", "a.joint"]
        sigma = read(tmp_path, f"sigma:\n  {key}: 3\n  a.joint: 2").estimator(channels).sigma
        assert sigma == {"left/wrist.ft/fx": 3.0, "a.joint": 2.0}

    def test_wrench_sensors(self, tmp_path: Path) -> None:
        text = """
            wrenches: [wrist, plate]
            wrench:
              wrist: {frame: tool0, role: mounted, sign: -1}
              plate: {frame: odom, topic: /left/plate, role: external, axes: [fz, tx]}
        """
        assert read(tmp_path, "\n".join(line[12:] for line in text.splitlines())).sensors == [
            WrenchSensor("wrist", "tool0", "mounted", sign=-1.0),
            WrenchSensor("/left/plate", "odom", "external", ("fz", "tx")),
        ]

    def test_sensors_given_otherwise_replace_those_of_the_file(self, tmp_path: Path) -> None:
        configuration = read(tmp_path, "wrenches: [a]\nwrench:\n  a:\n    frame: tool0\ngamma: 0.5")
        sensors = [WrenchSensor("/ft", "flange", "external", ("fx",), -1.0)]
        assert configuration.with_sensors(sensors).sensors == sensors
        assert configuration.with_sensors(sensors)["gamma"] == 0.5


MISTAKES: dict[str, tuple[str, str]] = {
    "unknown": ("gama: 0.5", r"unknown parameter 'gama'. Did you mean 'gamma'\? Valid: active, .*wrenches"),
    "unknown of a wrench": ("wrench:\n  ft:\n    frames: a", r"unknown parameter 'wrench.ft.frames'.*wrench.\*.frame"),
    "text for number": ("gamma: much", "gamma is 'much', expected a number"),
    "number for text": ("output_folder: 3", "output_folder is 3, expected a text"),
    "text for truth": ("active: 'yes'", "active is 'yes', expected true or false"),
    "texts for numbers": ("gravity: [a, b, c]", "gravity is .*, expected a list of finite numbers"),
    "infinite": ("gamma: .inf", "gamma is inf, expected a number from 0 to"),
    "too small": ("gamma: -1", "gamma is -1, expected a number from 0 to"),
    "too large": ("forgetting_time: 2.0e+6", r"forgetting_time is 2e\+06, expected a number from 0 to 1e\+06"),
    "gravity in the plane": ("gravity: [0, -9.81]", "gravity has 2 entries, expected 3"),
    "candidate": ("candidates: [sprng]", r"candidates: unknown effect 'sprng'. Did you mean 'spring'\?"),
    "side": ("effort_side: gear", "unknown value of effort_side 'gear'"),
    "side of a joint": ("joint:\n  a:\n    effort_side: gear", "unknown value of joint.a.effort_side 'gear'"),
    "known": ("known: [link1]", "the weighed mass 'link1' is not of the form"),
    "contacts on a fixed base": ("contacts: [foot]", "contacts need an IMU on the base"),
    "gains": ("command.gains: [a=b]", "command.gains: "),
    "objective": ("objective: residuals", r"unknown objective 'residuals'. Did you mean 'residual'\?"),
    "channel": ("sigma:\n  elbo: 1", r"sigma: unknown channel 'elbo'. Did you mean 'elbow'\?"),
    "sigma of nothing": ("sigma:\n  elbow: 0", "sigma.elbow is 0, expected a number from 1e-09"),
    "gain of nothing": ("effort_gain: 0", "effort gain 0.0: expected finite numbers other than zero"),
    "period too short": ("filter:\n  period: 1.0e-9", "signal setting period is 1e-09, expected 0 or at least"),
    "wrench without frame": ("wrenches: [ft]", "wrench.ft.frame is not given"),
    "wrench not listed": ("wrench:\n  ft:\n    frame: a", "wrench.ft is described but 'wrenches' does not list 'ft'"),
    "wrench role": (
        "wrenches: [ft]\nwrench:\n  ft: {frame: a, role: mountd}",
        r"wrench.ft: unknown wrench role 'mountd'. Did you mean 'mounted'\?",
    ),
    "wrench axis": ("wrenches: [ft]\nwrench:\n  ft: {frame: a, axes: [mz]}", "wrench.ft: unknown wrench axis 'mz'"),
    "wrench sign": ("wrenches: [ft]\nwrench:\n  ft: {frame: a, sign: 0.5}", "wrench.ft: .*a sign of 1 or -1"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_is_named_with_its_file(case: str, tmp_path: Path) -> None:
    """At once, or with the robot's joints and channels."""
    text, message = MISTAKES[case]
    with pytest.raises(InputError, match=rf"robot.yaml: {message}"):
        read(tmp_path, text).estimator(["elbow"])


UNREADABLE = {
    "empty": (b"", ".*expected one node.*found 0"),
    "no parameters": (b"geomid:\n  gamma: 1", ".*expected one node.*found 0"),
    "two nodes": (b"a: {ros__parameters: {}}\nb: {ros__parameters: {}}", ".*expected one node.*found 2"),
    "parameters in a list": (b"a: {ros__parameters: [1]}", ".*expected one node"),
    "a key that is a list": (b"? [a]\n: 1", ".*cannot be read"),
    "absent": (None, "the parameter file cannot be read"),
}


@pytest.mark.parametrize("case", UNREADABLE)
def test_what_is_no_parameter_file_is_refused(case: str, tmp_path: Path) -> None:
    data, message = UNREADABLE[case]
    path = tmp_path / "robot.yaml"
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(InputError, match=rf"{path}: {message}") as caught:
        Configuration.read(path)
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=f"{tmp_path}: not a regular file; expected a parameter file"):
        Configuration.read(tmp_path)


def test_values_given_later_win_and_are_checked() -> None:
    configuration = Configuration({"gamma": 0.5, "links": ["a"]}, "node")
    changed: Any = configuration.with_values({"gamma": 0.25})
    assert (changed["gamma"], changed["links"]) == (0.25, ["a"])
    with pytest.raises(InputError, match="node: gamma is 'x'"):
        configuration.with_values({"gamma": "x"})


def test_behind_the_gear_no_motor_is_felt() -> None:
    """At joints whose efforts are measured there neither the own rotor nor one that turns two joints is a parameter."""
    effects = ["rotor_inertia", "coupled_rotor_inertia"]
    values = {"joint.joint2.effort_side": "link", "effects": effects, "candidates": ["spring"]}
    model = Session((FILE.parents[1] / "bags/arm3.urdf").read_text(), Configuration(values), "arm3.urdf").model
    places = {(c.effect.name, c.place_name) for c in model.coefficients}
    rotors = {place for name, place in places if name == "rotor_inertia"}
    assert rotors == {"joint1", "joint3"}
    assert not [place for name, place in places if name == "coupled_rotor_inertia"], "joint2 is of every pair"
    assert ("spring", "joint2") in places
    everywhere = Configuration({"effort_side": "link", "joint.joint1.effort_side": "motor"})
    assert everywhere.behind_gear(["joint1", "joint2"]) == {"joint2"}


def test_a_side_of_an_unknown_joint_is_refused_and_that_of_a_locked_one_is_not() -> None:
    urdf = (FILE.parents[1] / "bags/arm3.urdf").read_text()
    Session(urdf, Configuration({"joint.joint3.effort_side": "link", "locked_joints": ["joint3"]}), "arm3.urdf")
    with pytest.raises(InputError, match=r"cell\.yaml: unknown joint with an effort_side 'jiont3'.*'joint3'"):
        Session(urdf, Configuration({"joint.jiont3.effort_side": "link"}, "cell.yaml"), "arm3.urdf")
