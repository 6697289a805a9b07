"""The launch files name only what exists. ``launch`` has no wheel: they run on a stub of it, which knows no more than
what they use; so that they run with the real one is not tested here."""

from __future__ import annotations

import runpy
import shlex
import sys
from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

from geomid_ros.signals.messages import COMMANDS, IMU, JOINT_STATES, ODOM

ROOT = Path(__file__).parents[1]
(LAUNCH_FILE,) = (ROOT / "launch").glob("*.launch.py")
NAMES = {
    "launch": ("LaunchContext", "LaunchDescription"),
    "launch.actions": ("DeclareLaunchArgument", "OpaqueFunction"),
    "launch.conditions": ("IfCondition",),
    "launch.substitutions": ("Command", "LaunchConfiguration", "NotEqualsSubstitution", "PathJoinSubstitution"),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
    "launch_ros.substitutions": ("FindPackageShare",),
}


@dataclass(frozen=True)
class Made:
    """What the launch file has made: the name of its class, and what was given."""

    kind: str
    values: tuple[Any, ...]
    named: dict[str, Any]


def stub(kind: str) -> Any:
    return lambda *values, **named: Made(kind, values, named)


@pytest.fixture
def actions(monkeypatch: pytest.MonkeyPatch) -> list[Made]:
    """What a launch file consists of."""
    for name, kinds in NAMES.items():
        module = ModuleType(name)
        for kind in kinds:
            setattr(module, kind, stub(kind))
        monkeypatch.setitem(sys.modules, name, module)
    description = runpy.run_path(str(LAUNCH_FILE))["generate_launch_description"]()
    (made,) = description.values
    return list(made)


class Launched:
    """What comes of a launch file with some arguments."""

    def __init__(self, actions: list[Made], **given: str) -> None:
        self._arguments = {a.values[0]: a.named["default_value"] for a in actions if a.kind == "DeclareLaunchArgument"}
        assert given.keys() <= self._arguments.keys()
        self._arguments |= given
        self.used: set[str] = set()
        context = SimpleNamespace(launch_configurations=self._arguments)
        functions = [action.named["function"] for action in actions if action.kind == "OpaqueFunction"]
        nodes = [node for function in functions for node in function(context)]
        self.nodes = {
            node.named["executable"]: {key: self.value(value) for key, value in node.named.items()}
            for node in nodes
            if "condition" not in node.named or self.value(node.named["condition"])
        }

    @property
    def declared(self) -> set[str]:
        return set(self._arguments)

    def value(self, part: Any) -> Any:
        """What a part stands for."""
        if isinstance(part, list | tuple):
            return type(part)(map(self.value, part))
        if isinstance(part, dict):
            return {key: self.value(own) for key, own in part.items()}
        return self._made(part) if isinstance(part, Made) else part

    def _made(self, part: Made) -> Any:
        values = part.values
        match part.kind:
            case "LaunchConfiguration":
                self.used.add(values[0])
                return self.value(self._arguments[values[0]])
            case "FindPackageShare":
                assert values == ("geomid_ros",)
                return str(ROOT)  # setup.py installs these folders as they are
            case "PathJoinSubstitution":
                return "/".join(self.value(values[0]))
            case "Command":
                return shlex.split("".join(self.value(values[0])))
            case "NotEqualsSubstitution":
                first, second = self.value(values)
                return "true" if first != second else "false"
            case "IfCondition":
                return {"true": True, "false": False}[self.value(values[0])]
            case "ParameterValue":
                return self.value(values[0])
        raise AssertionError(part.kind)


def test_by_default_the_node_alone_is_started(actions: list[Made]) -> None:
    scripts = distribution("geomid_ros").entry_points.select(group="console_scripts")
    (node,) = Launched(actions).nodes.values()
    assert node["package"] == "geomid_ros"
    assert callable(scripts[node["executable"]].load())
    assert node["parameters"] == [f"{ROOT}/config/geomid.yaml"], "nothing overrides the file"
    assert node["remappings"] == [(topic, topic) for topic in (JOINT_STATES, ODOM, IMU, COMMANDS)]


def test_a_parameter_file_of_ones_own_wins_over_a_shipped_one(actions: list[Made]) -> None:
    shipped = Launched(actions, config="ur.yaml").nodes["geomid_node"]["parameters"]
    assert shipped == [f"{ROOT}/config/ur.yaml"]
    started = Launched(actions, params_file="mine.yaml", config="ur.yaml", lifecycle="managed").nodes
    assert started["geomid_node"]["parameters"] == ["mine.yaml", {"lifecycle": "managed"}]


def test_rviz_shows_the_topics_of_the_node_in_its_namespace(actions: list[Made]) -> None:
    """Every topic of the file is remapped to the same without the slash at its beginning."""
    rviz = Launched(actions, rviz="true", namespace="left", fixed_frame="world").nodes["rviz2"]
    assert rviz["package"] == "rviz2"
    assert rviz["namespace"] == "left"
    display, path, frame, name = rviz["arguments"]
    assert (display, frame, name) == ("-d", "--fixed-frame", "world")
    displays = yaml.safe_load(Path(path).read_text())["Visualization Manager"]["Displays"]
    topics = [entry[key]["Value"] for entry in displays for key in ("Description Topic", "Topic") if key in entry]
    assert sorted(rviz["remappings"]) == sorted((topic, topic.removeprefix("/")) for topic in topics)


def test_a_urdf_is_for_robot_state_publisher(actions: list[Made]) -> None:
    started = Launched(actions, urdf="my robot.xacro", joint_states="arm/joint_states", namespace="left").nodes
    assert started.keys() == {"geomid_node", "robot_state_publisher"}
    publisher = started["robot_state_publisher"]
    assert publisher["package"] == "robot_state_publisher"
    assert publisher["namespace"] == started["geomid_node"]["namespace"] == "left"
    assert publisher["parameters"][0] == {"robot_description": ["xacro", "my robot.xacro"]}
    assert publisher["remappings"] == [(JOINT_STATES, "arm/joint_states")]


def test_all_follow_the_clock_of_a_simulation_and_arguments_are_declared_explained_and_used(
    actions: list[Made],
) -> None:
    """And what is started is in the package file."""
    launched = Launched(actions, urdf="robot.urdf", rviz="true", use_sim_time="true", lifecycle="none")
    started = launched.nodes.values()
    assert len(started) == 3
    assert all({"use_sim_time": "true"} in node["parameters"] for node in started)
    needed = {"launch", "launch_ros", "xacro", *(node["package"] for node in started)} - {"geomid_ros"}
    assert needed <= {entry.text for entry in ElementTree.parse(ROOT / "package.xml").iter("exec_depend")}
    assert launched.used == launched.declared
    assert launched.declared >= {"config", "params_file", "namespace", "use_sim_time", "rviz", "urdf"}
    explained = [action.named["description"] for action in actions if action.kind == "DeclareLaunchArgument"]
    assert all(text.endswith(".") for text in explained)
