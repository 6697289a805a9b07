"""Real set-ups: the ready configurations with the messages of robots whose bodies are known; one over DDS.

Elsewhere: descriptions that are late, changed or latched (test_description), stamps that jump (test_catalogue_streams).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from files.recordings import Recorded
from geometry_msgs.msg import WrenchStamped
from model.robots import urdf
from sensor_msgs.msg import JointState
from signals.feeding import completed
from std_msgs.msg import String
from test_configs import in_force

from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session, document
from geomid_ros.types import FloatArray

from .in_motion import COULOMB, InMotion, in_time, noisy
from .observer import latched
from .stage import Stage, description

CONFIG = Path(__file__).parents[2] / "config"
FAR = 6.0  # standard deviations; links have ten quantities each, and friction is not the only thing that is simplified


def links_of(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The links of an estimate, which has converged."""
    assert document["converged"], document["reason"]
    return {link["name"]: link for link in document["links"]}


def assert_masses_are_true(links: dict[str, dict[str, Any]], truth: dict[str, FloatArray]) -> None:
    """Of all links that are said to be told; the others must say so."""
    assert links.keys() == truth.keys()
    for name, link in links.items():
        if "mass" not in link["cannot_tell"]:
            assert abs(link["mass"] - truth[name][0]) < FAR * link["std"]["mass"] + 1e-3, name


def with_tool(text: str, parent: str, name: str = "tool", mass: float = 1.2) -> str:
    """A URDF with something fixed to a link."""
    return text.replace(
        "</robot>",
        f"""<link name="{name}"><inertial><origin xyz="0.01 -0.02 0.06"/><mass value="{mass}"/>
          <inertia ixx="{0.004 * mass}" ixy="0" ixz="0" iyy="{0.003 * mass}" iyz="0" izz="{0.002 * mass}"/>
        </inertial></link><joint name="{name}_joint" type="fixed"><origin xyz="0 0 0.02"/><parent link="{parent}"/>
          <child link="{name}"/></joint></robot>""",
    )


def identified(text: str, config: Path, items: Sequence[Recorded], **values: Any) -> dict[str, Any]:
    """The estimate from messages, all of which are taken, without ROS."""
    session = Session(text, Configuration.read(config).with_values({"candidates": [], **values}), config.name)
    for samples in completed(session.pipeline, (replace(item, topic=item.topic[1:]).parsed for item in items)):
        session.identifier.add(samples)
    assert not any(account.rejected or account.dropped for account in session.pipeline.ledger.topics.values())
    return document(session, session.identifier.solve())


def test_a_universal_robot(tmp_path: Path) -> None:
    """Currents, in its driver's order of joints, and the wrench in a frame that no URDF has."""
    text = with_tool(urdf("ur10_robot.urdf"), "tool0")
    robot = InMotion(text, duration=7.0, rate=125.0, seed=1, cuts=["tool0"], swing=0.8)
    gains = np.array([13.58, 14.30, 11.37, 11.24, 11.77, 11.77])
    currents = noisy(robot.efforts(), 0.3, seed=2) / gains
    wrench = noisy(-robot.carried("tool0"), 0.1, seed=3)
    topic, states = "/force_torque_sensor_broadcaster/wrench", robot.joint_states(currents, sorted(robot.joints))
    items = in_time(states, robot.wrenches(topic, "tool0_controller", wrench))
    found = identified(text, in_force(CONFIG / "ur.yaml", tmp_path), items)
    links = links_of(found)
    assert_masses_are_true(links, robot.truth)
    assert links["tool0"]["mass"] == pytest.approx(robot.truth["tool0"][0], rel=0.01)
    friction = [effect["value"] for effect in found["effects"] if effect["name"] == "coulomb_friction"]
    assert friction == pytest.approx(6 * [COULOMB], rel=0.2), "in N m, with the right gains"


def with_finger(text: str) -> str:
    """The small arm with a finger that slides on its tool; what sensors are fixed to is called as in ros2_control."""
    return text.replace("wrist_ft", "ft_frame").replace(
        "</robot>",
        """<link name="finger"><inertial><origin xyz="0 0 0.02"/><mass value="0.15"/>
          <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
        <joint name="finger_joint" type="prismatic"><origin xyz="0 0 0.1"/><parent link="tool"/><child link="finger"/>
          <axis xyz="1 0 0"/><limit lower="-0.05" upper="0.05" effort="20" velocity="0.2"/></joint></robot>""",
    )


def test_an_arm_under_ros2_control(stage: Stage) -> None:
    """In a namespace, over DDS; NaN where a joint has no effort; wheels that the description does not have."""
    text, observer, out = with_finger(description("arm3")), stage.observer, stage.folder / "out"
    robot = InMotion(text, duration=7.0, rate=100.0, seed=4, cuts=["ft_frame"])
    efforts = noisy(robot.efforts(), 0.05, seed=2)
    efforts[:, robot.joints.index("finger_joint")] = np.nan
    states = [
        item.changed(
            name=["left_wheel", *item.message.name],
            **{key: np.array([np.nan, *getattr(item.message, key)]) for key in ("position", "velocity", "effort")},
        )
        for item in robot.joint_states(efforts, sorted(robot.joints))
    ]
    topic, wrench = "force_torque_sensor_broadcaster/wrench", noisy(-robot.carried("ft_frame"), 0.05, seed=3)
    # The description is there before the node, as a robot_state_publisher keeps it.
    observer.node.create_publisher(String, "/cell/robot_description", latched(1)).publish(String(data=text))
    given = (f"output_folder:={out}", 'candidates:=[""]', "solve_period:=3600.0")
    arguments = ("--params-file", CONFIG / "ros2_control.yaml", "-r", "__ns:=/cell")
    chosen = (argument for value in given for argument in ("-p", value))
    stage.serving(stage.start("geomid_ros.ros.main", "--ros-args", *arguments, *chosen), "cell/geomid")
    arrays = observer.collect(DiagnosticArray, "/diagnostics")
    observer.diagnostics(lambda _, status: "no messages on" in status.message, "a robot", "cell/geomid")
    kinds = {"/joint_states": JointState, f"/{topic}": WrenchStamped}
    observer.publish(in_time(states, robot.wrenches(f"/{topic}", "ft_frame", wrench)), kinds, "/cell")
    wanted = {f"{name} accepted": str(len(states)) for name in ("joint_states", topic)}
    array = observer.diagnostics(lambda values, _: wanted.items() <= values.items(), str(wanted), "cell/geomid")
    values = {pair.key: pair.value for pair in array.status[0].values}
    refused = {key for key in values if " rejected: " in key or " dropped: " in key or key.endswith(" lost")}
    assert refused <= {"rows rejected: standing still", "rows rejected: not measured"}
    assert all(status.level != DiagnosticStatus.ERROR for other in arrays for status in other.status)
    assert values["joint_states noted: ignored, no moving joints of the robot: 'left_wheel'"] == "1"
    assert int(values["rows rejected: not measured"]) > 0, "the finger's equation"
    success, answer = observer.trigger("/cell/geomid/save")
    assert success, answer
    links = links_of(json.loads((out / "estimate.json").read_text()))
    assert_masses_are_true(links, robot.truth)
    carried_mass = sum(links[name]["mass"] for name in ("ft_frame", "finger"))
    assert carried_mass == pytest.approx(robot.truth["ft_frame"][0] + robot.truth["finger"][0], rel=0.01)


def test_a_quadruped() -> None:
    """Odometry of a base that turns about all axes, and four feet that carry it."""
    text = urdf("anymal_b_simple_description/robots/anymal.urdf")
    robot = InMotion(text, duration=6.0, rate=50.0, seed=1, floating_base=True)
    forces = robot.on_feet(["LF_FOOT", "RF_FOOT", "LH_FOOT", "RH_FOOT"])
    feet = [
        robot.wrenches(f"/{foot.lower()}/wrench", foot, noisy(force, 0.3, seed))
        for seed, (foot, force) in enumerate(forces.items())
    ]
    items = in_time(robot.joint_states(noisy(robot.efforts(forces), 0.1, seed=9)), robot.odometry(), *feet)
    links = links_of(identified(text, CONFIG / "legged.yaml", items, alike="none"))  # each of its links is another one
    assert_masses_are_true(links, robot.truth)
    # Its mass is what those of the legs leave of all, and nothing tells these.
    assert links["base"]["identified_moments"]
    assert total(links) == pytest.approx(sum(body[0] for body in robot.truth.values()), rel=0.01)


def test_a_quadruped_without_force_sensors() -> None:
    """An IMU in place of the odometry, and the efforts of the legs in place of sensors under the feet."""
    text = urdf("go2.urdf")
    robot = InMotion(text, duration=8.0, rate=50.0, seed=1, floating_base=True)
    feet = ["FL_foot", "FR_foot", "RL_foot", "RR_foot"]
    states = robot.joint_states(noisy(robot.efforts(robot.on_feet(feet)), 0.1, seed=9))
    found = identified(text, CONFIG / "quadruped.yaml", in_time(states, robot.imu("/imu", "imu")), contacts=feet)
    links = links_of(found)
    assert_masses_are_true(links, robot.truth)
    assert total(links) == pytest.approx(sum(body[0] for body in robot.truth.values()), rel=0.01)


def total(links: dict[str, dict[str, Any]]) -> float:
    """The mass of all links."""
    return float(sum(link["mass"] for link in links.values()))
