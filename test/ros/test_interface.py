"""What the node opens is what the reference and the security policy say, no more and no less."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias
from xml.etree import ElementTree

import pytest

from .domains import free_domain
from .observer import Observer
from .stage import staged

ROOT = Path(__file__).parents[2]
POLICY = ROOT / "security/geomid.policy.xml"
EVERYTHING = {
    "floating_base": True,
    "command": {"gains": ["20:1"]},
    "wrenches": ["wrench"],
    "wrench": {"wrench": {"frame": "flange"}},
    "use_sim_time": True,
}
WITH_IMU = {key: value for key, value in EVERYTHING.items() if key != "floating_base"} | {"imu": {"frame": "base_link"}}
ODOMETRY, IMU = ("odom", "nav_msgs/msg/Odometry"), ("imu", "sensor_msgs/msg/Imu")
COMMANDS = "joint_commands", "sensor_msgs/msg/JointState"

Opened: TypeAlias = dict[str, set[tuple[str, str]]]
"""Full names and types of what is ``subscribe``, ``publish`` and ``reply``."""


def opened_by(observer: Observer, name: str, namespace: str) -> Opened:
    """What a node has opened, as somebody else on the network sees it."""
    node = observer.node
    found = {
        "subscribe": node.get_subscriber_names_and_types_by_node(name, namespace),
        "publish": node.get_publisher_names_and_types_by_node(name, namespace),
        "reply": node.get_service_names_and_types_by_node(name, namespace),
    }
    assert node.get_client_names_and_types_by_node(name, namespace) == []
    return {how: {(entry, kind) for entry, kinds in entries for kind in kinds} for how, entries in found.items()}


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Opened]]:
    """What nodes have opened: one that uses everything, one with an IMU in place of odometry, one with the defaults
    alone, and a managed one."""
    with staged(tmp_path_factory.mktemp("interface")) as stage:
        stage.node(EVERYTHING)
        stage.node(WITH_IMU, "-r", "__ns:=/legged", name="legged/geomid")
        stage.node({}, "-r", "__ns:=/plain", name="plain/geomid")
        stage.node({"lifecycle": "autostart"}, "-r", "__ns:=/managed", name="managed/geomid")
        yield stage.observer.settled(
            lambda: {
                kind: opened_by(stage.observer, "geomid", namespace)
                for kind, namespace in (
                    ("everything", "/"),
                    ("imu", "/legged"),
                    ("defaults", "/plain"),
                    ("managed", "/managed"),
                )
            }
        )


def full(name: str, namespace: str = "") -> str:
    """The full name of what the node names so."""
    return name if name.startswith("/") else f"{namespace}/{name.replace('~', 'geomid')}"


def documented(namespace: str = "") -> Opened:
    """What the reference says; the wrench sensor's name is ``wrench``."""
    how = {"inputs": "subscribe", "outputs": "publish", "services": "reply"}
    opened: Opened = {"subscribe": set(), "publish": set(), "reply": set()}
    for table, row in rows():
        name, kind = (cell.strip("`") for cell in row[:2])
        of_every_node = {"subscribed": "subscribe", "published": "publish", "served": "reply"}
        key = how.get(table) or of_every_node[row[2].split(",")[0]]
        opened[key].add((full("wrench" if name == "NAME" else name, namespace), kind))
    return opened


def rows() -> Iterator[tuple[str, list[str]]]:
    """Rows of the tables of topics and services, with the tables' names."""
    text = (ROOT / "docs/pages/reference.md").read_text(encoding="utf-8")
    for table in re.finditer(r"<!-- table (inputs|outputs|services|of_every_node):.*?<!-- end -->", text, re.DOTALL):
        lines = [line for line in table[0].splitlines() if line.startswith("| `")]
        assert lines, table[1]
        yield from ((table[1], line.strip("| ").split(" | ")) for line in lines)


def test_tables_are_what_the_code_makes_of_them() -> None:
    with free_domain() as domain:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "PYTHONPATH": str(ROOT)}
        command = [sys.executable, str(ROOT / "docs/generators/tables.py"), "--check"]
        checked = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=300)
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_the_running_node_opens_what_is_documented(seen: dict[str, Opened]) -> None:
    for kind, namespace, other in (("everything", "", IMU), ("imu", "/legged", ODOMETRY)):
        expected = documented(namespace)
        expected["subscribe"].remove((full(other[0], namespace), other[1]))
        assert seen[kind] == expected


def test_with_the_defaults_it_opens_no_more_than_it_needs(seen: dict[str, Opened]) -> None:
    needless = {("/plain/wrench", "geometry_msgs/msg/WrenchStamped"), ("/clock", "rosgraph_msgs/msg/Clock")}
    needless |= {(full(name, "/plain"), kind) for name, kind in (ODOMETRY, IMU, COMMANDS)}
    expected = documented("/plain")
    expected["subscribe"] -= needless
    assert seen["defaults"] == expected


# Children and attributes of the elements of a policy of version 0.2.0, with the attributes' values.
RULE = "ALLOW|DENY"
STRUCTURE: dict[str, tuple[set[str], dict[str, str]]] = {
    "policy": ({"enclaves"}, {"version": r"0\.2\.0"}),
    "enclaves": ({"enclave"}, {}),
    "enclave": ({"profiles"}, {"path": r"(/[a-z_]+)+"}),
    "profiles": ({"profile"}, {}),
    "profile": ({"topics", "services", "actions"}, {"ns": r"/[a-z_/]*", "node": r"[a-z_]+"}),
    "topics": ({"topic"}, {"publish": RULE, "subscribe": RULE}),
    "services": ({"service"}, {"reply": RULE, "request": RULE}),
    "topic": (set(), {}),
    "service": (set(), {}),
}
OPTIONAL = ("publish", "subscribe", "reply", "request")


class TestPolicy:
    """security/geomid.policy.xml"""

    def test_it_has_the_structure_of_a_policy(self) -> None:
        root = ElementTree.parse(POLICY).getroot()
        assert root.tag == "policy"
        for element in root.iter():
            children, attributes = STRUCTURE[element.tag]
            assert {child.tag for child in element} <= children
            assert bool(children) == bool(len(element))
            assert bool((element.text or "").strip()) == (not children)
            assert attributes.keys() - set(OPTIONAL) <= element.attrib.keys() <= attributes.keys()
            for name, value in element.attrib.items():
                assert re.fullmatch(attributes[name], value)

    def test_sros2_takes_it(self) -> None:
        pytest.importorskip("sros2.policy", reason="sros2 is not installed").load_policy(POLICY)

    def test_it_allows_what_the_running_node_opens_and_nothing_else(self, seen: dict[str, Opened]) -> None:
        (profile,) = ElementTree.parse(POLICY).getroot().iter("profile")
        assert (profile.get("ns"), profile.get("node")) == ("/", "geomid")
        allowed: dict[str, list[str]] = {"subscribe": [], "publish": [], "reply": []}
        for group in profile:
            for how, rule in group.attrib.items():
                assert rule == "ALLOW"
                allowed[how] += [full(str(entry.text)) for entry in group]
        for how, names in allowed.items():
            with_imu = {full(IMU[0])} if how == "subscribe" else set()
            managed = {name.removeprefix("/managed") for name, _ in seen["managed"][how]}
            assert sorted(names) == sorted({name for name, _ in seen["everything"][how]} | with_imu | managed)


def test_a_managed_node_opens_what_the_page_says_besides(seen: dict[str, Opened]) -> None:
    page = (ROOT / "docs/pages/use/node.md").read_text(encoding="utf-8")
    for how, entries in seen["managed"].items():
        own = {name.removeprefix("/managed/geomid/") for name, _ in entries if name.startswith("/managed/geomid/")}
        own -= {name.removeprefix("/plain/geomid/") for name, _ in seen["defaults"][how]}
        assert len(own) == {"subscribe": 0, "publish": 1, "reply": 5}[how]
        assert all(f"`{name}`" in page for name in own)
