"""The node's parameters: checked at the start, described, and changed while it runs as far as they may be."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from files.recordings import BAGS
from numpy.typing import NDArray
from rcl_interfaces.msg import ParameterDescriptor, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter as RosParameter
from rclpy.signals import SignalHandlerOptions
from signals.feeding import completed

from geomid_ros.errors import InputError
from geomid_ros.ros.node import GeomidNode
from geomid_ros.session.configuration import AT_START, PARAMETERS, Configuration
from geomid_ros.session.session import Session

from .processes import Process
from .rig import FLAT_WRIST
from .stage import KINDS, NO_CHOICE, WRIST, Stage, description, messages

HALF = messages()[:800]
ARM3 = description("arm3")
SINGLE = [parameter for parameter in PARAMETERS if "*" not in parameter.name]


def sensor(**described: Any) -> dict[str, Any]:
    return {"wrenches": ["ft"], "wrench": {"ft": described}}


NODE, RELAY = "geomid_ros.ros.main", "geomid_ros.ros.feedforward"
HEAVIEST = {"urdf": str(BAGS / "arm3.urdf"), "heaviest_payload": 2.0}
# A program, its parameters and what the one message must hold.
REFUSED: dict[str, tuple[str, dict[str, Any], tuple[str, ...]]] = {
    "unknown": (NODE, {"gama": 0.5}, ("unknown parameter 'gama'", "Did you mean 'gamma'", "solve_period")),
    "empty list": (NODE, {"links": []}, ('an empty list is written as [""]',)),
    "topic": (NODE, sensor(frame="tool", topic="not a topic"), ("not a topic", "Invalid topic")),
    "model": (NODE, {"model": "/nowhere.json"}, ("/nowhere.json: the model cannot be read",)),
    "frame": (NODE, {**sensor(frame="hand"), "robot_description": ARM3}, ("unknown link 'hand'", "wrist_ft")),
    "type": (RELAY, {"tolerance": "x"}, ("tolerance is 'x', expected a number",)),
    "tolerance": (RELAY, {"tolerance": 0}, ("tolerance is 0, expected 0 < tolerance < 1",)),
    "name": (RELAY, {**HEAVIEST, "controller": "bad-name"}, ("controller: not a name in ROS",)),
    "misspelt": (RELAY, {"heaviest_paylod": 2.0}, ("Did you mean 'heaviest_payload'",)),
    "no value": (RELAY, {"model": []}, ("a parameter has no value",)),
    "payload": (RELAY, {**HEAVIEST, "heaviest_payload": np.nan}, ("heaviest_payload is nan, expected a number",)),
    "link": (RELAY, {**HEAVIEST, "link": "hand"}, ("unknown link 'hand'",)),
}
# Arguments that are not for ROS, of either program.
ARGUMENTS = ((NODE, "--params-file x.yaml"), (NODE, "--help"), (RELAY, "--model estimate.json"))


def test_what_cannot_be_used_is_refused_with_one_message(stage: Stage) -> None:
    """Status 2, what is wrong, what would be right. All at once: starting takes its time."""
    started: dict[str, Process] = {}
    for case, (module, parameters, _) in REFUSED.items():
        started[case] = stage.node(parameters, module=module, ready=False, fresh=not started)
    missing = stage.start(NODE, "--ros-args", "--params-file", stage.folder / "nowhere.yaml")
    others = {
        argument: stage.start(module, *argument.split(), "--ros-args", "-p", "use_sim_time:=false")
        for module, argument in ARGUMENTS
    }
    for case, (_, _, parts) in REFUSED.items():
        process = started[case]
        assert process.status() == 2, f"{case}: {process.output}"
        (line,) = [line for line in process.output.splitlines() if re.match("geomid_(node|feedforward): ", line)]
        for part in parts:
            assert part in line, f"{case}: {line}"
    assert missing.status() == 2
    assert "nowhere.yaml" in missing.output
    for argument, process in others.items():
        assert process.status() == 2, f"{argument}: {process.output}"
        assert f": {argument}: not an argument of ROS; parameters go behind --ros-args" in process.output


def test_a_node_that_is_refused_is_gone_at_once(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not when the interpreter is taken down: there ROS's threads may wait for it, and it for them."""

    def refuse(_: GeomidNode) -> None:
        stage.observer.wait_for(lambda: "geomid" in names(), "the node")
        raise InputError("refused")

    names = stage.observer.node.get_node_names
    monkeypatch.setattr("geomid_ros.ros.node.read_parameters", refuse)
    rclpy.init(domain_id=stage.domain, signal_handler_options=SignalHandlerOptions.NO)
    try:
        with pytest.raises(InputError, match="refused") as kept:
            GeomidNode()
        stage.observer.wait_for(lambda: "geomid" not in names(), "its end")
    finally:
        rclpy.shutdown()
    assert kept.traceback, "which holds the node"


# Variables of the environment, ROS arguments, and what the one message must hold.
CANNOT_START: dict[str, tuple[dict[str, str], tuple[str, ...], tuple[str, ...]]] = {
    "no keystore": ({"ROS_SECURITY_KEYSTORE": "{folder}/nowhere"}, (), ("{folder}/nowhere",)),
    "empty keystore": ({"ROS_SECURITY_KEYSTORE": "{folder}"}, (), ("ROS_SECURITY_KEYSTORE is {folder}",)),
    "parameter": ({}, ("-p", "x"), ("'-p x'",)),
    "QoS": ({}, ("-p", "qos_overrides./joint_states.subscription.reliability:=good"), ("'joint_states'", "`good`")),
}


def test_ros_that_cannot_start_is_refused_with_one_message(
    stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Status 2 and what is wrong or missing, from the node and the player; no traceback."""
    (tmp_path / "enclaves").mkdir()
    enforced = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}
    started: dict[str, list[Process]] = {}
    for case, (variables, arguments, _) in CANNOT_START.items():
        with monkeypatch.context() as patch:
            for name, value in ({} if arguments else {**enforced, **variables}).items():
                patch.setenv(name, value.format(folder=tmp_path))
            fresh = not started  # of the first case, as a user starts them
            started[case] = [stage.node({}, *arguments, ready=False, fresh=fresh)]
            if not arguments:
                started[case].append(stage.play(BAGS / "arm3", fresh=fresh))
    for case, (_, _, parts) in CANNOT_START.items():
        for process in started[case]:
            assert process.status() == 2, f"{case}: {process.output}"
            (line,) = [line for line in process.output.splitlines() if line.startswith(("geomid_node: ", "Error: "))]
            for part in parts:
                assert part.format(folder=tmp_path) in line, f"{case}: {line}"
            assert "Traceback" not in process.output


def get(stage: Stage, names: list[str], namespace: str = "") -> list[ParameterValue]:
    request = GetParameters.Request(names=names)
    return list(stage.observer.call(GetParameters, f"{namespace}/geomid/get_parameters", request).values)


def described(stage: Stage, names: list[str]) -> list[ParameterDescriptor]:
    request = DescribeParameters.Request(names=names)
    return list(stage.observer.call(DescribeParameters, "/geomid/describe_parameters", request).descriptors)


def test_parameters_are_described(stage: Stage) -> None:
    """Every one of the table, with its range; integers serve as real numbers."""
    stage.node({"gamma": 1, "joint": {"joint1": {"effort_gain": 2}}, "sigma": {"joint1": 0.5}})
    listed = stage.observer.call(ListParameters, "/geomid/list_parameters", ListParameters.Request()).result.names
    names = [parameter.name for parameter in SINGLE]
    assert set(names) | {"joint.joint1.effort_gain", "sigma.joint1"} <= set(listed)
    for parameter, answer in zip(SINGLE, described(stage, names), strict=True):
        assert answer.description == parameter.description
        assert answer.read_only == (parameter.change == AT_START)
        assert parameter.change in answer.additional_constraints
        ranges = [(entry.from_value, entry.to_value) for entry in answer.floating_point_range]
        assert ranges == ([] if parameter.minimum is None else [(parameter.minimum, parameter.maximum)])
    answers = described(stage, ["joint.joint1.effort_gain", "sigma.joint1"])
    assert [bool(answer.description and answer.floating_point_range) for answer in answers] == [True, True]
    (gamma,) = get(stage, ["gamma"])
    assert gamma.integer_value == 1
    wrenches, frame = RosParameter("wrenches", value=["ft"]), RosParameter("wrench.ft.frame", value="tool")
    assert "wrench.ft.frame is not given" in change(stage, "wrenches", ["ft"])
    both = SetParametersAtomically.Request(parameters=[wrenches.to_parameter_msg(), frame.to_parameter_msg()])
    assert stage.observer.call(SetParametersAtomically, "/geomid/set_parameters_atomically", both).result.successful


def change(stage: Stage, name: str, value: str | float | bool | list[str]) -> str:
    """Set a parameter; empty, or why it is refused."""
    parameter = RosParameter(name, value=value).to_parameter_msg()
    request = SetParameters.Request(parameters=[parameter])
    (result,) = stage.observer.call(SetParameters, "/geomid/set_parameters", request).results
    assert result.successful == (not result.reason)
    return str(result.reason)


def saved_masses(stage: Stage, out: Path) -> NDArray[np.float64]:
    success, message = stage.observer.trigger("/geomid/save")
    assert success, message
    return np.array([link["mass"] for link in json.loads((out / "estimate.json").read_text())["links"]])


@pytest.fixture
def out(stage: Stage, tmp_path: Path) -> Path:
    """Folder of a node that has taken half of a recording."""
    folder = tmp_path / "out"
    stage.node({**WRIST, **NO_CHOICE, "robot_description": ARM3, "output_folder": str(folder), "gamma": 0.01})
    stage.observer.publish(HALF, KINDS)
    stage.fed({"joint_states": len(HALF) // 2})
    return folder


def test_the_weight_of_the_prior_changes_while_the_node_runs(stage: Stage, out: Path) -> None:
    """From the same rows: with much weight the estimate is the URDF, and back it is what it was."""
    nominal = Session(ARM3, Configuration({"wrenches": ["wrist"], **FLAT_WRIST}), "arm3").model.nominal_inertias[::10]
    before = saved_masses(stage, out)
    assert np.max(np.abs(before / nominal - 1.0)) > 0.05
    assert "expected a number from 0" in change(stage, "gamma", -1) or "range" in change(stage, "gamma", -1.0)
    assert "nowhere" in change(stage, "known", ["nowhere=1:0.1"])
    assert change(stage, "gamma", 1e6) == ""
    np.testing.assert_allclose(saved_masses(stage, out), nominal, rtol=1e-2)
    assert "gamma is now 1000000.0, and was 0.01" in stage.processes[0].output
    assert change(stage, "gamma", 0.01) == ""
    np.testing.assert_allclose(saved_masses(stage, out), before, rtol=1e-6)


def test_what_rows_depend_on_changes_after_stop_and_reset(stage: Stage, out: Path) -> None:
    """Until then, and for what never changes, the reason says that it is read-only. What does not fit the robot changes
    nothing."""
    for name, value in (("filter.cutoff", 2.0), ("effort_gain", 2.0), ("floating_base", True)):
        reason = change(stage, name, value)
        assert "read-only" in reason
        assert "~/reset" in reason
    assert "read-only" in change(stage, "dashboard", value=True)
    assert stage.observer.trigger("/geomid/stop")[0]
    assert "read-only" in change(stage, "effort_gain", 2.0), "there are rows"
    assert "read-only" in change(stage, "joint.joint1.effort_gain", 2.0), "there are rows"
    assert "Did you mean 'effort_gain'" in change(stage, "efort_gain", 2.0)
    assert stage.observer.trigger("/geomid/reset")[0]
    stage.observer.diagnostics(lambda values, _: values["rows made"] == "0", "no rows")
    assert "unknown link 'hand'" in change(stage, "wrench.wrist.frame", "hand")
    assert get(stage, ["wrench.wrist.frame"])[0].string_value == "wrist_ft"
    assert "expected a number from" in change(stage, "joint.joint1.effort_gain", 1e7)
    gains = {"effort_gain": 2.0, "joint.joint1.effort_gain": 1.0}  # as its default, and unlike the others
    assert [change(stage, name, gain) for name, gain in gains.items()] == ["", ""]
    assert "a cutoff of 300 Hz is too high for data at" in change(stage, "filter.cutoff", 300.0)
    assert described(stage, ["joint.joint1.effort_gain"])[0].floating_point_range
    assert stage.observer.trigger("/geomid/start")[0]
    stage.observer.publish(HALF, KINDS)
    stage.fed({"joint_states": len(HALF)})
    success, message = stage.observer.trigger("/geomid/save")
    assert success, message
    configuration = Configuration({**gains, "gamma": 0.01, "candidates": [], "wrenches": ["wrist"], **FLAT_WRIST})
    twin = Session(ARM3, configuration, "arm3")
    for samples in completed(twin.pipeline, (item.parsed for item in HALF)):
        twin.identifier.add(samples)
    document = json.loads((out / "estimate.json").read_text())
    assert document["rows"]["accepted"] == twin.identifier.rows
    masses = [link["mass"] for link in document["links"]]
    np.testing.assert_allclose(masses, [link.mass for link in twin.identifier.solve().links], rtol=1e-6)
