"""The written MJCF in MuJoCo against pinocchio's dynamics of the URDF, and against the effects' formulas."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import pytest
from model.robots import Reference, fixed_base, random_samples, urdf, with_values
from scipy.spatial.transform import Rotation

from geomid_ros.files.models.mjcf import mjcf
from geomid_ros.files.models.urdf import read_urdf, with_effects
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

from .effects import PAYLOAD, effect
from .recordings import BAGS

EXACT = 1e-10  # relative: everything is written to the last bit
DIGITS = 1e-7  # relative: nine digits are written in a URDF
ROBOTS = ["arm7", "ur5_robot.urdf", "panda.urdf"]


def description(name: str) -> str:
    return read_urdf(BAGS / f"{name}.urdf") if name.startswith("arm") else urdf(name)


def compiled(text: str) -> Any:
    return mujoco.MjModel.from_xml_string(text)


def efforts(model: Any, samples: Samples, joints: Sequence[str]) -> FloatArray:
    """MuJoCo's inverse dynamics ``(N, joints)``."""
    data = mujoco.MjData(model)
    places = [model.joint(name).id for name in joints]
    found = np.zeros((len(samples), len(joints)))
    for index in range(len(samples)):
        data.qpos[places], data.qvel[places] = samples.position[index], samples.velocity[index]
        data.qacc[places] = samples.acceleration[index]
        mujoco.mj_inverse(model, data)
        found[index] = data.qfrc_inverse[places]
    return found


def without_stops(model: Any) -> Any:
    model.jnt_limited[:] = 0
    return model


def assert_equal(found: FloatArray, expected: FloatArray, tolerance: float) -> None:
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance * np.abs(expected).max())


@pytest.mark.parametrize("name", ROBOTS)
def test_dynamics_ranges_efforts_and_names_are_the_urdfs(name: str) -> None:
    robot, reference = Robot(description(name)), Reference(description(name))
    samples = random_samples(robot, 3)
    _, expected = reference.inverse_dynamics(samples, robot.joint_names)
    model = compiled(mjcf(robot, {}))
    for joint in robot.joints:
        own = reference.model.joints[reference.model.getJointId(joint.name)]
        limits = [reference.model.lowerPositionLimit[own.idx_q], reference.model.upperPositionLimit[own.idx_q]]
        np.testing.assert_array_equal(model.joint(joint.name).range, limits)
        assert model.actuator(joint.name).ctrlrange[1] == reference.model.effortLimit[own.idx_v]
    assert {body.name for body in map(model.body, range(1, model.nbody))} == {
        "world_link" if link == "world" else link for link in robot.tree.links
    }
    assert model.body_mass.sum() == pytest.approx(sum(own[0] for own in robot.tree.inertials.values()))
    assert_equal(efforts(without_stops(model), samples, robot.joint_names), expected, EXACT)


@pytest.fixture(scope="module")
def arm() -> Robot:
    return Robot(description("arm3"))


def test_joint_effects_follow_their_formulas(arm: Robot) -> None:
    samples = random_samples(arm, 6, count=50)
    q, v, a = samples.position[:, 1], samples.velocity[:, 1], samples.acceleration[:, 1]
    assert np.min(np.abs(v)) > 1e-3
    cases = [
        (effect("viscous_friction", "joint2", coefficient=0.7), 0.7 * v),
        (effect("rotor_inertia", "joint2", inertia=0.3), 0.3 * a),
        (effect("spring", "joint2", stiffness=11.0, equilibrium=0.4), 11.0 * (q - 0.4)),
    ]
    without = efforts(without_stops(compiled(mjcf(arm, {}))), samples, arm.joint_names)
    for known, expected in cases:
        found = efforts(without_stops(compiled(mjcf(arm, {}, [known]))), samples, arm.joint_names) - without
        assert_equal(found[:, 1], expected, EXACT)
        np.testing.assert_allclose(found[:, [0, 2]], 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "parameters"),
    [("coulomb_friction", {"level": 2.0}), ("stribeck_friction", {"level": 2.0, "excess": 1.0, "speed": 0.1})],
)
def test_dry_friction_is_exact_while_a_joint_moves(arm: Robot, name: str, parameters: dict[str, float]) -> None:
    """MuJoCo's friction is a constraint; it is at its limit when keeping the joint's velocity would take more."""
    data = mujoco.MjData(model := without_stops(compiled(mjcf(arm, {}, [effect(name, "joint2", **parameters)]))))
    rotor = model.joint("joint2").id
    for velocity in (-2.0, -0.3, 0.3, 2.0):
        mujoco.mj_resetData(model, data)
        data.qvel[rotor] = velocity
        mujoco.mj_forward(model, data)
        assert data.qfrc_constraint[rotor] == pytest.approx(-2.0 * np.sign(velocity), rel=1e-6)


@pytest.mark.parametrize("given", [None, (0.0, 1.0, -9.7)])
def test_a_tilt_turns_gravity(arm: Robot, given: tuple[float, ...] | None) -> None:
    straight = np.array(given or (0.0, 0.0, -9.81))
    tilt = effect("gravity_tilt", tilt_x=0.1, tilt_y=-0.2)
    model = compiled(mjcf(arm, {}, [tilt], gravity=None if given is None else straight))
    np.testing.assert_allclose(
        Rotation.from_rotvec([0.1, -0.2, 0.0]).apply(model.opt.gravity), straight, rtol=0.0, atol=1e-12
    )


@pytest.mark.parametrize("link", ["tool", "link2"])
def test_a_payload_is_what_pinocchio_makes_of_the_urdf_with_it(arm: Robot, link: str) -> None:
    payload = effect("payload", link, **PAYLOAD)
    samples = random_samples(arm, 7)
    loaded = Reference(with_effects(description("arm3"), [payload]))
    _, expected = loaded.inverse_dynamics(samples, arm.joint_names)
    _, empty = Reference(description("arm3")).inverse_dynamics(samples, arm.joint_names)
    model = without_stops(compiled(mjcf(arm, {}, [payload])))
    assert_equal(efforts(model, samples, arm.joint_names), expected, DIGITS)
    assert np.abs(expected - empty).max() > 1.0


def settled(model: Any, motor: str, effort: float) -> Any:
    """The state long after a link began to be pushed with this effort, while its motor holds still."""
    place = model.joint(motor).id
    model.opt.gravity[:] = 0.0
    model.dof_armature[place] = 1e9
    data = mujoco.MjData(model)
    data.qfrc_applied[place + 1] = effort  # on the link, behind the gear
    while data.time < 3.0:
        mujoco.mj_step(model, data)
    return data


def test_an_elastic_gear_gives_by_the_effort_over_its_stiffness(arm: Robot) -> None:
    """The link is pushed along, so the motor pulls back: tau is negative and the link ahead of the motor."""
    model = compiled(mjcf(arm, {}, [effect("joint_elasticity", "joint1", stiffness=2000.0)]))
    assert model.joint("joint1/elasticity").id == model.joint("joint1").id + 1
    data = settled(model, "joint1", 10.0)
    assert data.joint("joint1/elasticity").qpos[0] == pytest.approx(10.0 / 2000.0, rel=1e-3)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_backlash_gives_by_half_its_gap(arm: Robot, side: float) -> None:
    model = compiled(mjcf(arm, {}, [effect("backlash", "joint1", gap=0.02)]))
    for effort in (0.1, 0.3):
        place = settled(model, "joint1", effort * side).joint("joint1/backlash").qpos[0]
        assert 0.0 <= side * place - 0.01 < 2e-3 * effort, "its ends are a little soft"


def test_a_backlash_is_crossed_against_its_drag(arm: Robot) -> None:
    """The drag is so large that inertia does not matter: from one end to the other in gap drag / effort."""
    drag, gap, effort = 50.0, 0.02, 0.5
    model = compiled(mjcf(arm, {}, [effect("backlash", "joint1", gap=gap, drag=drag)]))
    model.opt.gravity[:] = 0.0
    hinge, motor = model.joint("joint1/backlash").dofadr[0], model.joint("joint1").dofadr[0]
    model.dof_armature[motor] = 1e6  # held
    data = mujoco.MjData(model)
    data.qpos[hinge] = -0.5 * gap
    data.qfrc_applied[hinge] = effort
    while data.qpos[hinge] < 0.5 * gap:
        mujoco.mj_step(model, data)
        assert data.time < 2.0 * gap * drag / effort
    assert data.time == pytest.approx(gap * drag / effort, rel=0.05)


def test_a_mounted_sensor_feels_the_weight_that_it_carries() -> None:
    robot = Robot(description("arm3"), cuts=["wrist_ft"])
    sensors = [WrenchSensor("/ft sensor", "wrist_ft", "mounted"), WrenchSensor("/floor", "link1", "external")]
    model = compiled(mjcf(robot, {}, sensors=sensors))
    assert model.nsensor == 2
    data = mujoco.MjData(model)
    mujoco.mj_inverse(model, data)
    mujoco.mj_rnePostConstraint(model, data)
    mujoco.mj_sensorAcc(model, data)
    still = with_values(fixed_base(np.zeros(1, int), *np.zeros((4, 1, 3))), wrenches=np.zeros((1, 1, 6)))
    (q,), (v,), (a,) = robot.configuration(still)
    robot.update_motion(q, v, a)
    rows = robot.wrench_rows(robot.subtree("wrist_ft"), "wrist_ft")
    expected = np.einsum("cbk,bk->c", rows, np.array([body.parameters for body in robot.bodies]))
    np.testing.assert_allclose(data.sensordata, expected, rtol=0.0, atol=EXACT * np.abs(expected).max())


ODD = """<robot name="odd -- one">
  <link name="world"/>
  <joint name="rail &amp; slide" type="prismatic"><origin xyz="0 0 1" rpy="0.1 0.2 0.3"/><parent link="world"/>
    <child link="carriage"/><axis xyz="1 2 2"/><limit lower="-1" upper="1" effort="0" velocity="1"/></joint>
  <link name="carriage"/>
  <joint name="turn" type="continuous"><parent link="carriage"/><child link="arm"/><axis xyz="0 3 0"/>
    <limit effort="7" velocity="1"/></joint>
  <link name="arm"><inertial><origin xyz="0.1 0 0.2"/><mass value="2"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/></inertial></link>
  <joint name="held" type="revolute"><origin xyz="0 0 0.3" rpy="0 1 0"/><parent link="arm"/><child link="hand"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="5" velocity="1"/></joint>
  <link name="hand"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
</robot>"""


def test_an_odd_robot() -> None:
    """Massless moving links, a slide on a skew axis, a joint without limits, one that was locked, odd names."""
    robot = Robot(ODD, locked_joints=["held"])
    samples = random_samples(robot, 8)
    model = compiled(mjcf(robot, {}, [effect("viscous_friction", "rail & slide", coefficient=2.0)]))
    assert [model.joint(index).name for index in range(model.njnt)] == ["rail & slide", "turn", "held"]
    assert list(model.jnt_limited) == [1, 0, 1]
    np.testing.assert_array_equal(model.actuator_ctrlrange, [[0.0, 0.0], [-7.0, 7.0], [-5.0, 5.0]])
    locked = ODD.replace('name="held" type="revolute"', 'name="held" type="fixed"')
    _, expected = Reference(locked).inverse_dynamics(samples, robot.joint_names)
    expected[:, 0] += 2.0 * samples.velocity[:, 0]
    assert_equal(efforts(without_stops(model), samples, robot.joint_names), expected, EXACT)


def test_a_floating_base_floats() -> None:
    robot = Robot(description("arm3"), floating_base=True)
    model = compiled(mjcf(robot, {}))
    assert model.nv == 9
    assert model.body_mass.sum() == pytest.approx(sum(body.parameters[0] for body in robot.bodies))
