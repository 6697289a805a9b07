"""Layouts for RViz, Foxglove and PlotJuggler name only topics, fields, joints, links and keys that exist."""

from __future__ import annotations

import json
import re
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState

from geomid_ros.live.status import Status
from geomid_ros.ros.diagnostics import Diagnostics

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "config"
REFERENCE = (ROOT / "docs/pages/reference.md").read_text(encoding="utf-8")
ARM7 = ElementTree.parse(ROOT / "bags/arm7.urdf").getroot()
JOINTS = [str(joint.get("name")) for joint in ARM7.iter("joint") if joint.get("type") != "fixed"]
LINKS = {str(link.get("name")) for link in ARM7.iter("link")}
STREAM = Diagnostics("geomid").array(Status(active=True)).status[0]


def node_topics() -> dict[str, tuple[str, str]]:
    """Type and QoS of the node's topics, by full name under the default ones, as the reference has them."""
    rows = re.findall(r"^\| `([^`]+)` \| `(\w+/msg/\w+)` \| ([^|]+) \|", REFERENCE, re.MULTILINE)
    names = {name: "/" + name.lstrip("/").replace("~", "geomid") for name, _, _ in rows}
    return {names[name]: (kind, qos) for name, kind, qos in rows}


TOPICS = node_topics()


def message_class(topic: str) -> Any:
    package, _, name = TOPICS[topic][0].split("/")
    return getattr(import_module(f"{package}.msg"), name)


def resolve(kind: Any, path: str) -> str:
    """The type of a field such as ``status[:].values[:].value``."""
    for part in path.split("."):
        name, index = re.fullmatch(r"(\w+)(\[(?:\d+|:)\])?", part).groups()  # type: ignore[union-attr]
        found = kind.get_fields_and_field_types()[name]
        element = re.fullmatch(r"sequence<([\w/]+)>", found)
        assert bool(element) == bool(index), f"{part} is {found}"
        found = element[1] if element else found
        if "/" not in found:
            return str(found)
        package, name = found.split("/")
        kind = getattr(import_module(f"{package}.msg"), name)
    raise AssertionError(f"{path} is no value")


def diagnostic_keys(status: str) -> str:
    """A pattern of a status's keys, from the reference; capitals there stand for the joints of the arm."""
    keys = re.findall(rf"^\| `{status}` \| `([^`]+)` \|", REFERENCE, re.MULTILINE)
    assert keys
    channel = f"({'|'.join(JOINTS)})"
    return "|".join(re.escape(key).replace("CHANNEL", channel) for key in keys)


def assert_diagnostic(status: str, key: str) -> None:
    node, _, name = status.partition(": ")
    assert node == "geomid"
    assert re.fullmatch(diagnostic_keys("LINK" if name in LINKS else name), key), (status, key)


class TestRviz:
    """config/geomid.rviz"""

    @pytest.fixture
    def document(self) -> Any:
        return yaml.safe_load((CONFIG / "geomid.rviz").read_text(encoding="utf-8"))["Visualization Manager"]

    def test_displays_hear_what_the_node_publishes_and_the_robots_own_description(self, document: Any) -> None:
        displays = {entry["Name"]: entry for entry in document["Displays"]}
        assert all(entry["Enabled"] for entry in displays.values())
        for display, key, heard, kind in (
            ("Robot", "Description Topic", "/robot_description", "std_msgs/msg/String"),
            ("Identified robot", "Description Topic", "/geomid/robot_description", "std_msgs/msg/String"),
            ("Identified ellipsoids", "Topic", "/geomid/markers", "visualization_msgs/msg/MarkerArray"),
        ):
            topic = displays[display][key]
            assert topic["Value"] == heard
            assert TOPICS[heard] == (kind, "reliable, transient local, last 1")
            assert (topic["Reliability Policy"], topic["Durability Policy"]) == ("Reliable", "Transient Local")
        for display, visible, inertia in (("Robot", True, False), ("Identified robot", False, True)):
            assert displays[display]["Description Source"] == "Topic"
            assert displays[display]["Visual Enabled"] == visible
            assert displays[display]["Mass Properties"] == {"Inertia": inertia, "Mass": False}

    def test_the_fixed_frame_is_the_base_of_the_arm(self, document: Any) -> None:
        children = {joint.find("child").get("link") for joint in ARM7.iter("joint")}  # type: ignore[union-attr]
        assert {document["Global Options"]["Fixed Frame"]} == LINKS - children


class TestFoxglove:
    """config/foxglove_layout.json"""

    @pytest.fixture
    def layout(self) -> Any:
        return json.loads((CONFIG / "foxglove_layout.json").read_text(encoding="utf-8"))

    def test_plots_show_fields_that_exist(self, layout: Any) -> None:
        paths = [
            series["value"]
            for name, panel in layout["configById"].items()
            if name.startswith("Plot!")
            for series in panel["paths"]
        ]
        for index, joint in enumerate(JOINTS):
            assert {f"/joint_states.effort[{index}]", f"/geomid/predicted_joint_states.effort[{index}]"} <= {*paths}
            assert f'/diagnostics.status[:]{{name=="geomid: stream"}}.values[:]{{key=="gap {joint}"}}.value' in paths
        for path in paths:
            topic, _, field = re.sub(r"\{[^}]*\}", "", path).partition(".")
            assert resolve(message_class(topic), field) in ("double", "string")
            for status, key in re.findall(r'name=="([^"]+)".*key=="([^"]+)"', path):
                assert_diagnostic(status, key)

    def test_the_other_panels_name_what_exists(self, layout: Any) -> None:
        panels = layout["configById"]
        for name, panel in panels.items():
            if name.startswith("Diagnostic"):
                assert message_class(panel["topicToRender"]) is DiagnosticArray
                assert STREAM.hardware_id == panel.get("selectedHardwareId", panel.get("hardwareIdFilter"))
        assert panels["DiagnosticStatusPanel!stream"]["selectedName"] == STREAM.name
        assert diagnostic_keys(panels["DiagnosticStatusPanel!finding"]["selectedName"].removeprefix("geomid: "))
        topic, _, field = panels["RawMessages!gap"]["topicPath"].partition(".")
        assert resolve(message_class(topic), field) == "string"
        robot = panels["3D!robot"]
        assert {TOPICS[topic][0] for topic in robot["topics"]} == {"visualization_msgs/msg/MarkerArray"}
        assert TOPICS[robot["layers"]["identified"]["topic"]][0] == "std_msgs/msg/String"
        assert robot["followTf"] in LINKS


class TestPlotJuggler:
    """config/plotjuggler_layout.xml"""

    @pytest.fixture
    def root(self) -> ElementTree.Element:
        return ElementTree.parse(CONFIG / "plotjuggler_layout.xml").getroot()

    def test_curves_name_what_its_parsers_make_of_the_messages(self, root: ElementTree.Element) -> None:
        """TOPIC/JOINT/FIELD of joint states; TOPIC/HARDWARE/STATUS/KEY of diagnostics."""
        curves = [str(curve.get("name")) for curve in root.iter("curve")]
        for joint in JOINTS:
            assert {f"/joint_states/{joint}/effort", f"/geomid/predicted_joint_states/{joint}/effort"} <= {*curves}
        used = set()
        for curve in curves:
            topic = max((topic for topic in TOPICS if curve.startswith(f"{topic}/")), key=len)
            used.add(topic)
            first, *rest = curve.removeprefix(f"{topic}/").split("/")
            if message_class(topic) is JointState:
                (field,) = rest
                assert first in JOINTS
                assert JointState.get_fields_and_field_types()[field] == "sequence<double>"
            else:
                assert message_class(topic) is DiagnosticArray
                assert first == STREAM.hardware_id
                assert_diagnostic(*rest)
        assert {topic.get("name") for topic in root.iter("topic")} == used
