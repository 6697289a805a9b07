"""Whole descriptions, in the software that they are for, against geomid's own prediction."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
from files.effects import PAYLOAD, effect
from files.recordings import BAGS
from model.robots import random_samples
from scipy.spatial.transform import Rotation

from geomid_ros.errors import InputError
from geomid_ros.exports.descriptions import DESCRIPTIONS, described, patch_user_mjcf
from geomid_ros.exports.model import ExportModel, read_model
from geomid_ros.exports.payload import each_link
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.files.models.mjcf import mjcf
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.files.models.written_model import write_model
from geomid_ros.model.effects import KnownEffect, identified_effect
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

mujoco = pytest.importorskip("mujoco")

URDF = read_urdf(BAGS / "arm3.urdf")
JOINTS = ("joint1", "joint2", "joint3")
EFFECTS = [
    *(effect("viscous_friction", joint, coefficient=0.4 + k) for k, joint in enumerate(JOINTS)),
    *(effect("coulomb_friction", joint, level=1.2 + k) for k, joint in enumerate(JOINTS)),
    *(effect("rotor_inertia", joint, inertia=0.3 + 0.1 * k) for k, joint in enumerate(JOINTS)),
]
NAMES = ("viscous_friction", "coulomb_friction", "rotor_inertia")
SPRING = effect("spring", "joint2", stiffness=3.0, equilibrium=0.5)
DIGITS = 1e-6  # [N m]: nine digits are written in a URDF


def written(folder: Path, effects: list[KnownEffect], urdf: str = URDF) -> ExportModel:
    """The small arm, its links scaled, with these effects."""
    robot = Robot(urdf)
    inertias = {body.name: (1.3 + 0.1 * k) * body.parameters for k, body in enumerate(robot.bodies)}
    write_model(folder, MeasurementModel(robot, ()), urdf, inertias, effects, robot.gravity)
    return read_model(folder / "estimate.json")


def exported(model: ExportModel, tool: str, packages: dict[str, Path] | None = None) -> str:
    return described(model, tool, each_link(model), packages or {}).text


def predicted(model: ExportModel) -> tuple[Samples, FloatArray]:
    """Samples, and geomid's own efforts at an estimate."""
    robot = Robot(URDF)
    own = MeasurementModel(robot, [identified_effect(name) for name in NAMES])
    parameters = LoadedModel.read(model.source).parameters(own)
    assert parameters is not None
    samples = random_samples(robot, 11)
    return samples, own.predict(samples, parameters)[1]


def motions(samples: Samples) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    return zip(samples.position, samples.velocity, samples.acceleration, strict=True)


def in_mujoco(text: str, samples: Samples) -> FloatArray:
    """Inverse dynamics, dry friction by its sign."""
    model = mujoco.MjModel.from_xml_string(text)
    model.jnt_limited[:] = 0
    level = model.dof_frictionloss.copy()
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    rows = []
    for data.qpos[:], data.qvel[:], data.qacc[:] in motions(samples):
        mujoco.mj_inverse(model, data)
        rows.append(data.qfrc_inverse.copy())
    return np.array(rows) + level * np.tanh(samples.velocity / 0.02)


def test_mujoco_predicts_what_geomid_does(tmp_path: Path) -> None:
    model = written(tmp_path, EFFECTS)
    samples, expected = predicted(model)
    np.testing.assert_allclose(in_mujoco(exported(model, "mujoco"), samples), expected, atol=DIGITS)


@pytest.mark.parametrize("tool", ["urdf", "moveit", "isaac", "gazebo", "drake"])
def test_pinocchio_predicts_what_geomid_does(tool: str, tmp_path: Path) -> None:
    """By urdfdom, with the rotors from geomid's file, as a URDF cannot say them, nor one for Drake the dry friction."""
    model = written(tmp_path, EFFECTS)
    samples, expected = predicted(model)
    robot = pin.buildModelFromXML(exported(model, tool))
    rotors = np.array([known.parameters["inertia"].value for known in EFFECTS[6:]])
    dry = np.array([known.parameters["level"].value for known in EFFECTS[3:6]])
    np.testing.assert_allclose(robot.friction, 0.0 if tool == "drake" else dry)
    data = robot.createData()
    found = [
        pin.rnea(robot, data, q, v, a) + robot.damping * v + dry * np.tanh(v / 0.02) + rotors * a
        for q, v, a in motions(samples)
    ]
    np.testing.assert_allclose(found, expected, atol=DIGITS)


def test_drake_has_rotors_at_the_actuators(tmp_path: Path) -> None:
    """One of its own for a joint that has none, and no second value where there was one."""
    own = (
        '<transmission name="t"><type>transmission_interface/SimpleTransmission</type><joint name="joint2"/>'
        '<actuator name="m2"><mechanicalReduction>1</mechanicalReduction>'
        '<drake:rotor_inertia xmlns:drake="http://drake.mit.edu" value="9"/></actuator></transmission></robot>'
    )
    model = written(tmp_path, EFFECTS, URDF.replace("</robot>", own))
    root = ET.fromstring(exported(model, "drake"))
    found = {}
    for transmission in root.findall("transmission"):
        joint, actuator = transmission.find("joint"), transmission.find("actuator")
        assert joint is not None
        assert actuator is not None
        found[joint.get("name")] = [(child.tag, child.get("value")) for child in actuator if child.get("value")]
    tags = [f"{{http://drake.mit.edu}}{name}" for name in ("rotor_inertia", "gear_ratio")]
    assert found == {
        joint: list(zip(tags, (value, "1"), strict=True))
        for joint, value in zip(JOINTS, ("0.3", "0.4", "0.5"), strict=True)
    }


def test_drake_predicts_what_geomid_does(tmp_path: Path) -> None:
    """All but dry friction, which it ignores."""
    missing = "needs Drake: pip install -r requirements-bench.txt"
    parsing = pytest.importorskip("pydrake.multibody.parsing", reason=missing)
    plants = pytest.importorskip("pydrake.multibody.plant", reason=missing)
    trees = pytest.importorskip("pydrake.multibody.tree", reason=missing)
    smooth = [known for known in EFFECTS if known.effect != "coulomb_friction"]
    model = written(tmp_path, [*smooth, *(effect("coulomb_friction", joint, level=1e-9) for joint in JOINTS)])
    samples, expected = predicted(model)
    plant = plants.MultibodyPlant(time_step=0.0)
    parsing.Parser(plant).AddModelsFromString(exported(model, "drake"), "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    plant.Finalize()
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -9.81])
    context = plant.CreateDefaultContext()
    for motion, efforts in zip(motions(samples), expected, strict=True):
        plant.SetPositions(context, motion[0])
        plant.SetVelocities(context, motion[1])
        forces = trees.MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        np.testing.assert_allclose(plant.CalcInverseDynamics(context, motion[2], forces), efforts, atol=DIGITS)


LOAD = effect("load_friction", "joint3", coefficient=0.1)
CANNOT = {
    "urdf": {"rotor inertia of joint2", "spring of joint2"},
    "moveit": {"rotor inertia of joint2", "spring of joint2"},
    "isaac": {"spring of joint2"},
    "gazebo": {"rotor inertia of joint2"},
    "drake": {"Coulomb friction of joint2", "spring of joint2"},
    "mujoco": set[str](),
}


@pytest.mark.parametrize("tool", DESCRIPTIONS)
def test_what_a_format_cannot_say_is_said(tool: str, tmp_path: Path) -> None:
    at_two = [known for known in EFFECTS if known.joint == "joint2"]
    whole = described(written(tmp_path, [*at_two, SPRING, LOAD]), tool, [], {})
    sentence = whole.omissions[0]
    said = {*sentence.removeprefix("Not representable here: ").split("; ")}
    assert said == CANNOT[tool] | {"load friction of joint3"}
    assert sentence in whole.text
    assert any("ignores <dynamics>" in each for each in whole.omissions) == (tool == "isaac")
    springs = {child.tag: child.text for own in ET.fromstring(whole.text).iter("gazebo") for child in own}
    assert springs == ({"springStiffness": "3", "springReference": "0.5"} if tool == "gazebo" else {})


def test_shapes_come_along_as_far_as_their_meshes_are_found(tmp_path: Path) -> None:
    mesh = "<visual><geometry><mesh filename='package://none/{}'/></geometry></visual></link>"
    (tmp_path / "there.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    head, _, tail = URDF.partition("</link>")
    (tmp_path / "unread.dae").touch()
    names = ("there.obj", "gone.stl", "unread.dae", "unread.dae")
    both = "".join(map(mesh.format, names)).replace("</link>", "", len(names) - 1)
    model = written(tmp_path, [], head + both + tail)
    whole = described(model, "mujoco", [], {"none": tmp_path})
    compiled = mujoco.MjModel.from_xml_string(whole.text)
    shapes = len(re.findall("<(?:visual|collision)>", URDF))
    assert (compiled.ngeom, compiled.nmesh) == (shapes + 1, 1)
    (said,) = whole.omissions
    first = ET.fromstring(URDF).find("link")
    assert first is not None
    assert said.startswith(f"3 shapes missing, the first of link '{first.get('name')}': the mesh 'package://none/gone")
    cylinders = [compiled.geom_size[g] for g in range(compiled.ngeom) if compiled.geom_bodyid[g] == 1]
    np.testing.assert_allclose(cylinders[0][:2], [0.07, 0.05])


def numbers(element: ET.Element, key: str, default: str) -> FloatArray:
    return np.array([float(part) for part in element.get(key, default).split()])


def turned_frames(text: str) -> str:
    """The same robot in an MJCF whose bodies have other frames and inertials, and which stands elsewhere."""
    random = np.random.default_rng(3)
    root = ET.fromstring(text)

    def turn(body: ET.Element, parent: FloatArray) -> None:
        own = np.eye(4)
        own[:3, :3], own[:3, 3] = Rotation.random(random_state=random).as_matrix(), random.normal(size=3)
        placed = np.eye(4)
        position, quaternion = numbers(body, "pos", "0 0 0"), numbers(body, "quat", "1 0 0 0")
        placed[:3, :3], placed[:3, 3] = Rotation.from_quat(np.roll(quaternion, -1)).as_matrix(), position
        here = np.linalg.inv(parent) @ placed @ own
        body.set("pos", " ".join(map(repr, here[:3, 3].tolist())))
        body.set("quat", " ".join(map(repr, np.roll(Rotation.from_matrix(here[:3, :3]).as_quat(), 1).tolist())))
        for joint in body.findall("joint"):
            axis = own[:3, :3].T @ numbers(joint, "axis", "")
            joint.set("axis", " ".join(map(repr, axis.tolist())))
            joint.set("pos", " ".join(map(repr, (-own[:3, :3].T @ own[:3, 3]).tolist())))
        for inertial in body.findall("inertial"):
            inertial.attrib = {"mass": "1", "pos": "0 0 0", "diaginertia": "1 1 1"}
        for child in body.findall("body"):
            turn(child, own)

    (base,) = root.findall("worldbody/body")
    elsewhere = np.eye(4)
    elsewhere[:3, :3], elsewhere[:3, 3] = Rotation.from_euler("z", 1.0).as_matrix(), (1.0, 2.0, 3.0)
    turn(base, elsewhere)
    base.set("name", "pedestal")
    return ET.tostring(root, encoding="unicode")


def test_into_a_file_of_the_users_own(tmp_path: Path) -> None:
    """Whatever frames its bodies have, it moves as the estimate says; what is not identified stays."""
    model = written(tmp_path, EFFECTS)
    own = tmp_path / "own.xml"
    text = turned_frames(mjcf(Robot(URDF), {})).replace("<actuator>", "<!-- mine -->\n  <actuator>")
    own.write_text(text)
    whole = patch_user_mjcf(model, own)
    samples, expected = predicted(model)
    np.testing.assert_allclose(in_mujoco(whole.text, samples), expected, atol=DIGITS)
    assert whole.omissions == []
    kept = re.compile(r"<inertial [^>]*/>|<joint [^>]*>")
    assert kept.sub("", whole.text) == kept.sub("", text)


def test_a_spring_in_degrees_and_what_others_count_in(tmp_path: Path) -> None:
    model = written(tmp_path, [SPRING])
    degrees = mjcf(Robot(URDF), {}).replace('angle="radian"', 'angle="degree"')
    own = tmp_path / "own.xml"
    degrees = re.sub('limited="true" range="[^"]*"|inertiafromgeom="false"', "", degrees)
    own.write_text(re.sub('(<body name="tool"[^>]*)/>', r'\1><geom size="0.1"/></body>', degrees))
    whole = patch_user_mjcf(model, own)
    compiled = mujoco.MjModel.from_xml_string(whole.text)
    joint = compiled.joint("joint2")
    np.testing.assert_allclose([joint.stiffness[0], joint.qpos_spring[0]], [3.0, 0.5])
    assert "tool" in model.bodies["link3"].merged
    assert compiled.body("tool").mass[0] == 0.0
    assert compiled.body("link3").mass[0] == pytest.approx(model.bodies["link3"].mass)
    assert any("tool" in sentence for sentence in whole.omissions)


BOX = '<inertial pos="0 0 0" mass="0.8" diaginertia="1 1 1"/>'
OWN = [
    ('inertiafromgeom="false"', 'inertiafromgeom="true"', "mass of link2 31.3"),
    ("</body>", f'<body name="box">{BOX}</body></body>', "mass of box 0.8 instead of 0"),
    ('<joint name="joint2"', '<joint stiffness="25" name="joint2"', "stiffness of joint2 25 instead of 0"),
    ("<joint solref", '<joint stiffness="25" solref', "stiffness of joint1 25 instead of 0"),
    ('gravity="0.0 0.0 -9.81"', 'gravity="0 0 0"', "gravity [0.0, 0.0, 0.0] instead of [0.0, 0.0, -9.81]"),
    (
        "<option",
        '<option><flag gravity="disable"/></option><option',
        "gravity [0.0, 0.0, 0.0] instead of [0.0, 0.0, -9.81]",
    ),
]


@pytest.mark.parametrize(("there", "own", "said"), OWN)
def test_what_of_the_users_own_remains_is_said(there: str, own: str, said: str, tmp_path: Path) -> None:
    model, path = written(tmp_path, EFFECTS), tmp_path / "own.xml"
    text = mjcf(Robot(URDF), {}).replace(there, own, 1)
    path.write_text(
        re.sub('(<body name="link2".*?<inertial[^>]*/>)', r'\1<geom size="0.1955"/>', text, flags=re.DOTALL)
    )
    (sentence,) = patch_user_mjcf(model, path).omissions
    assert said in sentence


def test_a_spring_of_a_joint_that_slides_by_its_class(tmp_path: Path) -> None:
    """Where angles are in degrees, its rest is in metres."""
    path, urdf = tmp_path / "own.xml", URDF.replace('name="joint2" type="revolute"', 'name="joint2" type="prismatic"')
    text = mjcf(Robot(urdf), {}).replace('type="slide"', 'class="rail"').replace('angle="radian"', "")
    path.write_text(text.replace("<default>", '<default><default class="rail"><joint type="slide"/></default>'))
    joint = mujoco.MjModel.from_xml_string(patch_user_mjcf(written(tmp_path, [SPRING], urdf), path).text).joint(
        "joint2"
    )
    np.testing.assert_allclose([joint.stiffness[0], joint.qpos_spring[0]], [3.0, 0.5])


def test_friction_of_a_users_joint_that_follows_is_its_masters(tmp_path: Path) -> None:
    urdf = URDF.replace(
        '<joint name="joint3" type="revolute">', '<joint name="joint3" type="revolute"><mimic joint="joint2"/>'
    )
    path = tmp_path / "own.xml"
    path.write_text(mjcf(Robot(urdf), {}).replace("<joint solref", '<joint damping="9" armature="8" solref'))
    whole = patch_user_mjcf(written(tmp_path, EFFECTS[1:2], urdf), path)
    compiled = mujoco.MjModel.from_xml_string(whole.text)
    assert compiled.joint("joint3").damping[0] == 0.0
    assert "damping of joint3" not in whole.omissions[-1]


@pytest.mark.parametrize("tool", DESCRIPTIONS)
@pytest.mark.parametrize("factor", [1.3, 0.4])
def test_a_joint_that_was_locked_moves_its_link(factor: float, tool: str, tmp_path: Path) -> None:
    """The link has its inertial, or, if that is more than was identified, its share."""
    robot = Robot(URDF, locked_joints=["joint3"])
    inertias = {body.name: factor * body.parameters for body in robot.bodies}
    write_model(tmp_path, MeasurementModel(robot, ()), URDF, inertias, [], robot.gravity)
    model, whole = read_model(tmp_path / "estimate.json"), Robot(URDF)
    last = whole.bodies[-1].parameters[0]
    expected = [1.3 * robot.bodies[1].parameters[0] - last, last] if factor > 1.0 else None
    text = exported(model, tool)
    if tool == "mujoco":
        compiled = [mujoco.MjModel.from_xml_string(each) for each in (text, (tmp_path / "identified.xml").read_text())]
        moved = [[m.body(name).subtreemass[0] for name in whole.body_names] for m in compiled]
        masses = [[first - second, second] for _, first, second in moved]
        assert [m.njnt for m in compiled] == [3, 3]
    else:
        masses = [[body.parameters[0] for body in Robot(text).bodies[1:]]]
    for found in masses:
        assert len(found) == 2
        assert sum(found) == pytest.approx(factor * robot.bodies[1].parameters[0])
        assert min(found) > 0.0
        assert expected is None or found == pytest.approx(expected)


TAKEN = (
    '<link name="link3_payload"/><joint name="link3_payload" type="fixed"><parent link="link3"/>'
    '<child link="link3_payload"/></joint></robot>'
)


@pytest.mark.parametrize(("end", "name"), [("</robot>", "link3_payload"), (TAKEN, "link3_payload_")])
def test_a_payload_is_carried_by_its_link(end: str, name: str, tmp_path: Path) -> None:
    """Its link has another name if the robot has one of this name."""
    urdf, own = URDF.replace("</robot>", end), tmp_path / "own.xml"
    model = written(tmp_path, [effect("payload", "link3", **PAYLOAD)], urdf)
    own.write_text(mjcf(Robot(URDF), {}))
    mass = mujoco.MjModel.from_xml_string(patch_user_mjcf(model, own).text).body("link3").mass[0]
    assert mass == pytest.approx(model.bodies["link3"].mass + PAYLOAD["mass"])
    assert model.bodies[name].std[0] == pytest.approx(PAYLOAD["mass"] / 10.0)


TEXT = mjcf(Robot(URDF), {})
BODY = TEXT[TEXT.index("<body") : TEXT.rindex("</worldbody>")]


@pytest.mark.parametrize(
    ("own", "said"),
    [
        (TEXT.replace('name="joint3"', 'name="joint3" pos="0.1 0.1 0.1"', 1), r"with all joints at zero.*\(joint3\)"),
        (
            re.sub(r'name="(link\d|tool)"', r'name="other_\1"', TEXT),
            "has none of the bodies link1, link2, link3",
        ),
        (TEXT.replace(BODY, '<include file="part.xml"/>'), "'link1' is not in this file itself"),
        (TEXT.replace("<worldbody>", '<worldbody><geom size="1" size="1"/>'), "(not valid XML|MuJoCo cannot read)"),
    ],
    ids=["another posture", "other names", "an included file", "an attribute twice"],
)
def test_a_file_of_another_robot_or_that_only_mujoco_can_read_is_refused(own: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "part.xml").write_text(f"<mujoco>{BODY}</mujoco>")
    (tmp_path / "own.xml").write_text(own)
    with pytest.raises(InputError, match=f"own.xml.*{said}"):
        patch_user_mjcf(written(tmp_path, EFFECTS), tmp_path / "own.xml")
