"""The dashboard beside a real node: what its page is told, and that nobody else is, and nothing can be changed."""

from __future__ import annotations

import http.client
import json
import re
import signal
import socket
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from files.recordings import BAGS

from .processes import Process
from .stage import NO_CHOICE, WRIST, Stage, description
from .test_solving_process import children
from .waiting import PATIENCE

URDF = {"robot_description": description("arm3"), **WRIST, **NO_CHOICE}


class Reader:
    """What somebody on this machine gets to read."""

    def __init__(self, port: int) -> None:
        self.port = port

    def ask(self, path: str, method: str = "GET", host: str = "127.0.0.1") -> tuple[int, str]:
        """Status and text."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)
        connection.request(method, path, headers={"Host": f"{host}:{self.port}"})
        response = connection.getresponse()
        return response.status, response.read().decode()

    def state(self) -> dict[str, Any]:
        """The first that comes."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)
        connection.request("GET", "/events")
        response = connection.getresponse()
        assert response.headers["Content-Type"] == "text/event-stream"
        try:
            while not (line := response.readline().decode()).startswith("data: "):
                assert line, "the stream has ended"
            return dict(json.loads(line.removeprefix("data: ")))
        finally:
            connection.close()


def address(stage: Stage, process: Process, node: str = "geomid") -> int:
    """The port that a process says its dashboard has."""

    def find() -> int:
        assert process.running, process.output
        found = re.search(rf"Dashboard of /{node}: http://127\.0\.0\.1:(\d+)\n", process.output)
        return int(found[1]) if found else 0

    return stage.observer.wait_for(find, "the address of the dashboard", PATIENCE)


def is_listening(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def test_the_page_is_told_what_the_node_says_and_ends_with_it(stage: Stage) -> None:
    """So does the process that solves."""
    arrays = stage.observer.collect(DiagnosticArray, "/diagnostics")
    arguments = ("-r", "__ns:=/left", "-r", "joint_states:=/joint_states")
    node = stage.node({**URDF, "dashboard": True, "solve_period": 0.2}, *arguments, name="left/geomid")
    reader = Reader(address(stage, node, "left/geomid"))
    stage.spin_while(stage.play(BAGS / "arm3", 4.0, "--topic", "/wrench"))

    def seen() -> dict[str, Any] | None:
        state = reader.state()
        said = [status for array in arrays for status in array.status if status.name == "left/geomid: link3"]
        masses = {pair.value for status in said for pair in status.values if pair.key == "mass"}
        told = {f"{link['mass']:.6g}" for link in state["links"] if link["name"] == "link3"}
        return state if told and told <= masses else None

    state = stage.observer.wait_for(seen, "the mass of link3 on the page", PATIENCE)
    assert state["node"] == "left/geomid"
    assert {link["name"] for link in state["links"]} >= {"link2", "link3"}
    assert {channel["name"] for channel in state["channels"]} >= {"joint1", "joint2", "joint3"}
    for link in state["links"]:
        assert link["low"] < link["mass"] < link["high"]
    assert {topic["name"] for topic in state["topics"]} == {"joint_states", "/wrench"}

    started = children(node.pid)
    node.send(signal.SIGKILL)
    node.status()
    stage.observer.wait_for(lambda: not is_listening(reader.port), "the end of the dashboard")
    assert len(started) >= 2
    stage.observer.wait_for(lambda: not any(Path(f"/proc/{each}").exists() for each in started), "that of the solver")


def test_nobody_but_this_machine_is_answered_and_nothing_can_be_changed(stage: Stage) -> None:
    """In its graph it only listens. A port that is taken is said; without one another is taken."""
    dashboard = stage.start("geomid_ros", "dashboard", "--node", "/somebody/geomid")
    reader = Reader(address(stage, dashboard, "somebody/geomid"))
    status, page = reader.ask("/")
    assert status == 200
    assert "/somebody/geomid" in page
    assert reader.ask("/", host="localhost")[0] == 200
    for host in ("evil.example", "127.0.0.1.evil.example", "0.0.0.0", ""):
        for path in ("/", "/events"):
            assert reader.ask(path, host=host)[0] == 404, host
    for method in ("POST", "PUT", "DELETE", "PATCH"):
        assert reader.ask("/", method)[0] == reader.ask("/events", method)[0] == 405
    assert reader.ask("/../setup.py")[0] == reader.ask("/static/x")[0] == 404
    addresses = Path("/proc/net/tcp").read_text(encoding="ascii") + Path("/proc/net/tcp6").read_text(encoding="ascii")
    listening = re.findall(rf": ([0-9A-F]+):{reader.port:04X} [0-9A-F]+:0000 0A", addresses)
    assert listening == ["0100007F"]

    node = stage.observer.node
    opened = stage.observer.settled(
        lambda: [
            *node.get_publisher_names_and_types_by_node("geomid_dashboard", "/"),
            *node.get_subscriber_names_and_types_by_node("geomid_dashboard", "/"),
            *node.get_client_names_and_types_by_node("geomid_dashboard", "/"),
        ]
    )
    assert [name for name, _ in opened] == ["/parameter_events", "/diagnostics"]  # the first as every node of rclpy

    assert address(stage, stage.start("geomid_ros", "dashboard")) != reader.port
    third = stage.start("geomid_ros", "dashboard", "--port", str(reader.port))
    stage.observer.wait_for(lambda: not third.running, "its end", PATIENCE)
    assert third.status() == 2
    assert f"port {reader.port} of 127.0.0.1 is not available" in third.output
    assert dashboard.end() == 0, dashboard.output
    assert len(dashboard.output.splitlines()) == 1, dashboard.output
