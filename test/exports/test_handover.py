"""A description is judged as its reader loads it: what is in the file counts, not what was meant."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from files.recordings import BAGS, QUICK
from model.robots import random_samples, urdf, with_values
from model.test_contacts import bent

import geomid_ros
from geomid_ros.api.identify import Identification
from geomid_ros.errors import InputError
from geomid_ros.estimation.effect_selection import held_columns
from geomid_ros.exports.descriptions import DescriptionFiles, described
from geomid_ros.exports.handover import (
    DescriptionTest,
    FileTest,
    ReadBack,
    _added,
    evaluate_description,
    read_mjcf_back,
    read_urdf_back,
)
from geomid_ros.exports.model import read_model
from geomid_ros.exports.posterior_samples import sample_robots
from geomid_ros.files.models.mjcf import mjcf
from geomid_ros.files.models.readers import READERS
from geomid_ros.files.models.urdf import for_drake, with_inertials
from geomid_ros.files.models.written_model import written_model
from geomid_ros.model.effects import EFFECTS, KnownEffect, Quantity
from geomid_ros.model.effects.friction import SMOOTHINGS, CoulombFriction, ViscousFriction
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session, save
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.recording import simulate
from geomid_ros.types import FloatArray

mujoco = pytest.importorskip("mujoco")

WRITTEN = [reader for reader in READERS if reader != "mjcf_joints"]


@cache
def found() -> Identification:
    return geomid_ros.identify(BAGS / "arm3", BAGS / "arm3.urdf")


def handed(reader: str) -> DescriptionTest:
    return DescriptionTest(found().session, found().estimate, reader)


def expected(result: Identification, reader: str) -> dict[str, float]:
    """What the parameters that were fitted for a reader leave, errors of sensors apart, by the model's own rows."""
    session, parameters = result.session, result.estimate.within[reader].copy()
    first = len(session.model.nominal_inertias)
    for index, coefficient in enumerate(session.model.coefficients):
        if coefficient.effect.is_sensor_error:
            parameters[first + index] = 0.0
    rms = session.rms(result.judged, parameters)
    return dict(zip((channel.name for channel in session.model.channels), rms.tolist(), strict=True))


@pytest.mark.parametrize("reader", WRITTEN)
def test_what_is_loaded_is_what_was_fitted(reader: str) -> None:
    judged = handed(reader).evaluate(found().judged, found().rms)
    for name, alone in expected(found(), reader).items():
        assert judged.alone[name] == pytest.approx(alone, rel=1e-4)


def test_friction_of_a_file_counts_on_the_base_of_legs_that_stand() -> None:
    """As the same friction does in the model's own rows: the test of a file adds its efforts to them."""
    values = {"imu.frame": "imu", "contacts": ["FL_foot:0.022", "FR_foot:0.022"], "effects": ["viscous_friction"]}
    session = Session(urdf("go2.urdf"), Configuration(values, "test"), "go2.urdf")
    samples, nominal = bent(session.robot, seed=2), session.model.nominal_parameters
    standing = np.random.default_rng(3).random((len(samples), 2)) < 0.6
    samples = replace(with_values(samples, effort=samples.velocity), standing=standing)
    viscous = [0.3 * (c.effect.name == "viscous_friction") for c in session.model.coefficients]
    friction = np.append(session.model.nominal_inertias, viscous)
    found = session.rms([samples], nominal[:, None], added=lambda samples: 0.3 * samples.velocity[:, :, None])
    np.testing.assert_allclose(found[:, 0], session.rms([samples], friction))


def test_what_is_loaded_is_what_was_fitted_with_a_joint_locked(tmp_path: Path) -> None:
    """It moves in the files, so that what is behind it has a mass; at zero, all is as it was fitted. Friction that the
    URDF has where nothing moves is not added to the model."""
    (tmp_path / "damped.urdf").write_text(
        (BAGS / "arm3.urdf").read_text().replace('type="fixed">', 'type="fixed"><dynamics damping="0.3"/>')
    )
    result = geomid_ros.identify(BAGS / "arm3", tmp_path / "damped.urdf", lock=["joint3"], reader="mujoco")
    assert replace(result, reader="urdf").handover.added == ()
    result.save(tmp_path, report=False)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "identified.xml"))
    assert model.njnt == 3
    assert np.all(model.body_subtreemass > 0.0)
    robot = pin.buildModelFromUrdf(str(tmp_path / "identified.urdf"))
    assert np.linalg.eigvalsh(pin.crba(robot, robot.createData(), pin.neutral(robot)))[0] > 1e-6
    (drawn,) = sample_robots(tmp_path / "estimate.json", 1, 0, 1.0)
    assert len(Robot(drawn.urdf).bodies) == 3
    for name, alone in expected(result, "mujoco").items():
        assert result.handover.alone[name] == pytest.approx(alone, rel=1e-4)


@cache
def rich() -> Identification:
    """With springs, in whose rest the offsets are, and couplings of two joints."""
    effects = ["viscous_friction", "coulomb_friction", "effort_offset", "spring", "coupled_viscous_friction"]
    effects.append("coupled_coulomb_friction")
    return geomid_ros.identify(BAGS / "arm3", BAGS / "arm3.urdf", effects=effects, reader="moveit")


@pytest.mark.parametrize("reader", ["mujoco", "gazebo"])
def test_springs_rest_and_couplings_are_loaded_as_they_were_fitted(reader: str) -> None:
    """What the file holds: all of it in an MJCF, all but couplings for Gazebo; no offset is left to a sensor."""
    result = DescriptionTest(rich().session, rich().estimate, reader)
    parameters = rich().estimate.within[reader]
    names = [c.effect.name for c in rich().session.model.coefficients]
    coupled = [parameters[30 + k] for k, name in enumerate(names) if name.startswith("coupled")]
    assert np.any(coupled) == (reader == "mujoco")
    assert not [effect for effect in result.model.effects if effect.effect == "effort_offset"]
    rms = rich().session.rms(rich().judged, parameters)
    assert [*result.evaluate(rich().judged, rich().rms).alone.values()] == pytest.approx(rms.tolist(), rel=1e-4)


def test_what_a_file_holds_beyond_the_estimate_is_said() -> None:
    """Of the estimate's effects the file of MuJoCo holds all; a spring that only its own fit has is named."""
    estimate, session = rich().estimate, rich().session
    kept = tuple(effect for effect in estimate.effects if (effect.name, effect.joint) != ("spring", "joint2"))
    assert len(kept) < len(estimate.effects)
    for effects, note in ((estimate.effects, ""), (kept, "identified.xml: the file adds spring of joint2")):
        judged = DescriptionTest(session, replace(estimate, effects=effects), "mujoco").evaluate((), rich().rms)
        assert judged.note == note
        assert judged.entry["added"] == ["spring of joint2"] * bool(note)
    heavy = replace(estimate, links=tuple(replace(link, parameters=1e3 * link.parameters) for link in estimate.links))
    judged = DescriptionTest(session, heavy, "mujoco").evaluate((), rich().rms)
    assert judged.note.startswith("identified.xml: the file has other masses instead: 'link1' ")
    assert len(judged.bent) == 3


def test_a_deviation_beside_a_value_is_that_of_this_value() -> None:
    """A file's own fit has others, which are not known; values that it kept have the estimate's."""
    estimate, model = found().estimate, found().session.model
    stds = {(effect.name, effect.joint): effect.std for effect in estimate.effects}
    for within in ({}, {"urdf": 1.1 * estimate.parameters}):
        for effect in written_model(model, replace(estimate, within=within), "urdf").effects:
            std = next(iter(effect.parameters.values())).std
            assert math.isnan(std) if within else std == stds[effect.effect, effect.joint]


def test_drake_gets_no_link_without_a_mass() -> None:
    """It would take it for one of 1 kg."""
    empty = '<inertial><mass value="0"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    urdf = f'<robot name="r"><link name="a">{empty}</link><link name="b">{empty.replace("0", "2", 1)}</link></robot>'
    assert for_drake(urdf, [], "r") == urdf.replace(empty, "")


def test_mujoco_itself_needs_these_efforts() -> None:
    """Its inverse dynamics, its dry friction apart, which is a constraint of another law near standstill."""
    samples = Samples.concatenate(list(found().judged)).select(slice(0, 400, 40))
    model = mujoco.MjModel.from_xml_string(handed("mujoco").files["identified.xml"])
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS | mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    names = found().session.robot.joint_names
    places = [model.joint(name).dofadr[0] for name in names]
    read = read_mjcf_back(handed("mujoco").files["identified.xml"], found().session.robot)
    for name in names:
        read.attributes[name, "joint/frictionloss"] = 0.0
    predicted = predicted_by(read, samples)
    for index in range(len(samples)):
        data.qpos[places], data.qvel[places] = samples.position[index], samples.velocity[index]
        data.qacc[places] = samples.acceleration[index]
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(data.qfrc_inverse[places], predicted[index], rtol=1e-3, atol=2e-3)


def test_a_number_that_is_wrong_in_the_file_shows() -> None:
    """The text that is written is judged, not the parameters that it was made from."""
    session = found().session
    text = handed("urdf").files["identified.urdf"]
    wrong = re.sub(r'damping="[^"]*"', 'damping="10"', text)
    samples = Samples.concatenate(list(found().judged))
    right, bad = (
        np.std(predicted_by(read_urdf_back(session.read_robot(each, "file"), "urdf"), samples) - samples.effort, axis=0)
        for each in (text, wrong)
    )
    assert np.all(bad > 2.0 * right)


def judged_file(found: float) -> FileTest:
    """Of channel a worse than what it is from, of b as good; ``found``: of all that was found, at a."""
    alone, corrected, given = {"a": 2.0, "b": 1.0}, {"a": 1.2, "b": 1.0}, {"a": 1.0, "b": 1.0}
    everything = {"a": found, "b": 1.0}
    files = {"alone": alone, "corrected": corrected, "given": given}
    return FileTest("f.urdf", "pinocchio", **files, full_rms=everything, omissions=("spring of a",), fuller=("mujoco",))


def test_a_file_worse_than_what_it_is_from_says_so_with_the_channel() -> None:
    judged = judged_file(found=1.1)
    (sentence,) = judged.worse
    assert not judged.limited
    assert sentence.startswith("f.urdf predicts 'a' (RMS 2 instead of 1) worse than the given description")
    assert "by the full estimate, too" in sentence
    assert "cannot represent" not in sentence, "another format has the same"
    offsets = replace(judged_file(found=1.1), corrected={"a": 0.9, "b": 1.0})
    assert not offsets.worse, "an error of a sensor is no part of the robot"
    (sentence,) = offsets.limited
    assert "(RMS 2 instead of 1) worse than the given description, but not with the sensor errors" in sentence
    assert "--for" not in sentence, "no description holds them"


def test_what_a_file_cannot_say_casts_no_doubt_on_a_result_that_predicts_better() -> None:
    """It is told once, as the file's user has to know it: as a warning if it matters, else as a note."""
    limited = judged_file(found=0.9)
    assert not limited.worse
    assert not limited.note
    (lost,) = limited.limited
    assert lost == (
        "f.urdf leaves 110 % of the given description's error, the estimate 95 %; f.urdf predicts 'a' (RMS 2 instead "
        "of 1) worse than the given description: the file cannot represent spring of a; --for mujoco holds more of them"
    )
    harmless = replace(limited, alone=limited.full_rms, corrected=limited.full_rms)
    assert not harmless.limited
    assert harmless.note == "f.urdf: the file cannot represent spring of a; estimate.json has them"
    assert "no format holds more" in replace(limited, fuller=()).limited[0]
    added = replace(harmless, added=("spring of b",))
    assert added.note == "f.urdf: the file adds spring of b and cannot represent spring of a; estimate.json has them"


@pytest.mark.parametrize(
    ("effects", "reader", "fuller"),
    [
        ((), "urdf", ()),
        (("rotor_inertia",), "urdf", ("isaac", "drake", "mujoco")),
        (("rotor_inertia",), "drake", ()),  # others hold as much, not more
        (("rotor_inertia", "viscous_friction", "coulomb_friction"), "drake", ("isaac", "mujoco")),
        (("presliding",), "urdf", ()),  # no format holds it
    ],
)
def test_formats_that_hold_more_are_named(effects: tuple[str, ...], reader: str, fuller: tuple[str, ...]) -> None:
    known = [KnownEffect(e, "joint1", "", {f.name: Quantity(1.0) for f in EFFECTS[e].parameters}) for e in effects]
    description = DescriptionFiles(handed(reader).files[handed(reader).name], [])
    judged = evaluate_description(found().session, reader, description, (), found().rms, known)
    assert judged.fuller == fuller


@pytest.mark.parametrize(("rms", "tells"), [(1.9, False), (2.1, True)])
def test_a_file_that_loses_most_of_what_the_estimate_gained_says_so(rms: float, tells: bool) -> None:
    """Though it is better than what it is from at every channel: RMS 4 there, 1 of the estimate."""
    one = {"a": 1.0, "b": math.nan}
    given, file = ({name: factor * value for name, value in one.items()} for factor in (4.0, rms))
    judged = FileTest("f.urdf", "pinocchio", alone=file, corrected=file, given=given, full_rms=one)
    assert bool(judged.limited) == tells


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_the_urdf_beside_another_file_is_tested_too(factor: float) -> None:
    estimate = found().estimate
    within = {**estimate.within, "urdf": factor * estimate.within["urdf"]}
    result = replace(found(), reader="mujoco", estimate=replace(estimate, within=within))
    bad = [warning for warning in result.verdict.warnings if warning.startswith("identified.urdf ")]
    assert len(bad) == (factor > 1.0)
    assert all(warning.endswith("; identified.xml holds more of them") for warning in bad)
    assert result.verdict.word == "usable", "the file that was asked for is as good as before"


@pytest.mark.parametrize("reader", WRITTEN)
def test_what_is_exported_later_is_what_was_fitted_then(reader: str, tmp_path: Path) -> None:
    save(found().session, tmp_path, found().estimate)
    model = read_model(tmp_path / "estimate.json", reader)
    assert model.fitted
    written = written_model(found().session.model, found().estimate, reader, found().session.loaded.effects)
    for name, parameters in written.inertias.items():
        assert model.bodies[name].mass == pytest.approx(parameters[0], rel=1e-9)
    said = {(effect.effect, effect.joint): effect for effect in model.effects}
    for effect in written.effects:
        there = said[effect.effect, effect.joint]
        assert {n: q.value for n, q in there.parameters.items()} == pytest.approx(
            {n: q.value for n, q in effect.parameters.items()}
        )
    kept = np.allclose(list(written.inertias.values()), [link.parameters for link in found().links])
    assert all(model.bodies[name].has_std == kept for name in written.inertias)
    text = described(model, reader, [], {}).text
    assert dynamics(text) == dynamics(handed(reader).files[handed(reader).name])


def dynamics(description: str) -> list[dict[str, str]]:
    """Attributes of all joints."""
    return [element.attrib for element in ElementTree.fromstring(description).iter("dynamics")]


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    save(found().session, tmp_path, found().estimate)
    return tmp_path / "estimate.json"


def test_an_earlier_estimate_is_exported_as_not_fitted(saved: Path) -> None:
    """Its description has the estimate's own inertias."""
    document = json.loads(saved.read_text())
    del document["handover"]
    saved.write_text(json.dumps(document))
    inertias = {link.name: link.parameters for link in found().links}
    merged = [name for link in found().links for name in link.merged]
    saved.with_name("identified.urdf").write_text(with_inertials(found().session.urdf, inertias, merged))
    assert not read_model(saved, "mujoco").fitted


def test_a_model_for_a_reader_has_the_links_of_the_estimate(saved: Path) -> None:
    document = json.loads(saved.read_text())
    document["handover"]["mujoco"]["links"][0]["name"] = "other"
    saved.write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"handover for mujoco: its links are link2, link3, other; expected link1"):
        read_model(saved, "mujoco")


def test_moveit_reads_what_is_written_for_any_reader_of_a_urdf() -> None:
    assert rich().written.files == DescriptionTest(rich().session, rich().estimate, "urdf").files
    assert rich().document["handover"]["urdf"]["file"] == "identified.urdf"


def predicted_by(read: ReadBack, samples: Samples) -> FloatArray:
    """The joints' efforts ``(N, joints)`` by a description."""
    model = found().session.model
    _, predicted = model.predict(samples, read.parameters(model))
    return predicted[:, model.layout.efforts] + read.efforts(model.robot, samples)


def test_dry_friction_of_a_slide_is_sharp_in_files() -> None:
    """It may slide no faster than the usual smoothing. Fitted and loaded in one shape, that of a turning joint is its
    usual one."""
    text = (BAGS / "arm3.urdf").read_text().replace('name="joint3" type="revolute"', 'name="joint3" type="prismatic"')
    robot = Robot(
        text.replace('name="joint3" type="prismatic">', 'name="joint3" type="prismatic"><dynamics friction="3"/>')
    )
    read = ReadBack("mujoco", {}, {("joint2", "joint/frictionloss"): 2.0, ("joint3", "joint/frictionloss"): 3.0})
    speeds = np.outer(np.linspace(-0.03, 0.03, 7), np.ones(3))
    samples = with_values(random_samples(robot, 1, count=7), velocity=speeds)
    sharp, usual = np.tanh(speeds[:, 0] / SMOOTHINGS[0]), np.tanh(speeds[:, 0] / CoulombFriction.smoothing)
    np.testing.assert_allclose(read.efforts(robot, samples), np.column_stack([0.0 * usual, 2.0 * usual, 3.0 * sharp]))
    model = MeasurementModel(robot, [ViscousFriction()], candidates=CoulombFriction.grid())
    effects = [model.coefficients[k - len(model.nominal_inertias)].effect for k in model.described_shapes.values()]
    dry = [effect.smoothing for effect in effects if isinstance(effect, CoulombFriction)]
    assert dry == [CoulombFriction.smoothing, CoulombFriction.smoothing, SMOOTHINGS[0]]
    held = held_columns(model, np.arange(model.dimension), ("urdf",))
    assert np.sum(model.described_parameters[30:]) == model.described_parameters[max(held)] == 3.0
    assert sorted(held.tolist()) == [*range(30), *sorted(model.described_shapes.values())]


@pytest.mark.parametrize("ratio", [1.0, -1.0])
def test_mujoco_feels_a_coupling_at_both_joints(ratio: float) -> None:
    parameters = {"coefficient": Quantity(0.3, 0.1, "N m s/rad"), "ratio": Quantity(ratio, 0.0, "-")}
    coupling = KnownEffect("coupled_viscous_friction", "joint2+joint3", "", parameters)
    robot = found().session.robot
    text = mjcf(robot, {}, [coupling])
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qvel[:3] = 0.1, 0.4, 0.7
    mujoco.mj_forward(model, data)
    motor = 0.3 * (0.4 + ratio * 0.7)
    np.testing.assert_allclose(data.qfrc_damper[:3], [0.0, -motor, -ratio * motor], atol=1e-12)
    read = read_mjcf_back(text, robot)
    assert read.attributes["joint2+joint3", "tendon/coef"] == ratio
    assert read.attributes["joint2+joint3", "tendon/damping"] == pytest.approx(0.3)


def test_under_the_recorded_commands_the_written_robot_is_where_the_measured_one_is(tmp_path: Path) -> None:
    recording = SimulationOptions(robot="arm3", seed=5, duration=8.0, longest_step=QUICK, hide=(), commands=True)
    simulate(tmp_path / "bag", recording)
    result = geomid_ros.identify(tmp_path / "bag", BAGS / "arm3.urdf", reader="mujoco", command="joint_commands")
    tracking = result.tracking
    assert tracking is not None
    assert tracking.rms.keys() == {"joint1", "joint2", "joint3"}
    assert tracking.total < 2e-3


def test_a_file_may_add_a_coupling_of_moving_joints() -> None:
    """But nothing at a joint that does not move."""
    attributes = {("a+b", "tendon/damping"): 1.0, ("a+fixed", "tendon/damping"): 1.0, ("fixed", "joint/damping"): 1.0}
    assert _added(ReadBack("mujoco", {}, attributes), (), ("a", "b")) == ("coupled viscous friction of a+b",)
