"""A session that starts from a model with effects predicts with them; its own estimate is such a model again."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands.test_robot_options import with_gripper
from model.robots import Reference, random_samples
from signals.sent import JointMessage, WrenchMessage

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import EffectEstimate
from geomid_ros.files.disk import write_json
from geomid_ros.files.models.effects_file import tilted_gravity
from geomid_ros.files.models.estimate_file import estimate_document
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.files.models.written_model import write_model
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.effects import KnownEffect, Quantity
from geomid_ros.model.effects.effect import FRICTION_DRIFT
from geomid_ros.model.effects.friction import CoulombFriction
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import GRAVITY, Robot
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import read_with_locked
from geomid_ros.session.session import Session, save
from geomid_ros.types import FloatArray

from .effects import PAYLOAD, effect
from .estimates import estimate_of, link_estimate
from .recordings import BAGS

ARM = read_urdf(BAGS / "arm3.urdf")
EXACT = 1e-9


def session_with(tmp_path: Path, known: Iterable[KnownEffect], **values: Any) -> Session:
    """A session of the arm from an estimate.json with the URDF's inertias and these effects."""
    configuration = Configuration({"model": str(tmp_path / "estimate.json"), **values}, "test")
    robot = Robot(ARM, cuts=[sensor.frame for sensor in configuration.sensors])
    inertias = {body.name: body.parameters for body in robot.bodies}
    write_model(tmp_path, MeasurementModel(robot, ()), ARM, inertias, known, GRAVITY)
    return Session(ARM, configuration, "arm3.urdf")


def predicted(session: Session, seed: int = 1) -> tuple[FloatArray, Any]:
    """Efforts ``(N, joints)`` of random motions at what is known, and the motions."""
    samples = random_samples(session.robot, seed, count=20)
    parameters = session.prior
    assert parameters is not None
    return session.model.predicted_efforts(samples, np.nan_to_num(parameters)), samples


@pytest.mark.parametrize("common", [[""], ["coulomb_friction", "effort_offset"]])
def test_effects_of_joints_are_predicted(tmp_path: Path, common: list[str]) -> None:
    effects = [
        effect("viscous_friction", "joint1", coefficient=0.3),
        effect("coulomb_friction", "joint1", level=0.6, smoothing=0.3),
        effect("stribeck_friction", "joint2", level=2.0, excess=1.0, speed=0.5),
        effect("coulomb_friction", "joint2", level=0.5),
        effect("rotor_inertia", "joint2", inertia=0.4),
        effect("spring", "joint3", stiffness=5.0, equilibrium=0.2),
        effect("effort_offset", "joint3", offset=0.7),
    ]
    found, samples = predicted(session_with(tmp_path, effects, effects=common))
    q, v, a = samples.position, samples.velocity, samples.acceleration
    sign = np.tanh(v[:, 1] / 0.02)
    _, expected = Reference(ARM).inverse_dynamics(samples, ["joint1", "joint2", "joint3"])
    expected[:, 0] += 0.3 * v[:, 0] + 0.6 * np.tanh(v[:, 0] / 0.3)
    expected[:, 1] += sign * (2.5 + np.exp(-((v[:, 1] / 0.5) ** 2))) + 0.4 * a[:, 1]
    expected[:, 2] += 5.0 * (q[:, 2] - 0.2) + 0.7
    np.testing.assert_allclose(found, expected, atol=EXACT * np.abs(expected).max())


@pytest.mark.parametrize("tilts", [{"tilt_x": 0.1, "tilt_y": -0.05}, {"tilt_y": -0.05}])
def test_gravity_and_payload_are_predicted(tilts: dict[str, float], tmp_path: Path) -> None:
    """An estimate may have a tilt about one axis alone."""
    tilt = effect("gravity_tilt", **tilts)
    session = session_with(tmp_path, [tilt, effect("payload", "link3", **PAYLOAD)], effects=[""])
    found, samples = predicted(session)
    straight = Robot(ARM)
    reference = Reference(ARM, gravity=tilted_gravity(GRAVITY, [tilt]).tolist())
    inertias = {body.name: body.parameters for body in straight.bodies}
    inertias["link3"] = inertias["link3"] + effect("payload", "link3", **PAYLOAD).body
    reference.set_inertias(inertias)
    _, expected = reference.inverse_dynamics(samples, straight.joint_names)
    np.testing.assert_allclose(found, expected, atol=EXACT * np.abs(expected).max())


def pushed(session: Session, stamps: FloatArray, effort: FloatArray) -> Any:
    """Samples of joints at rest with this effort at joint1 ``(N,)``."""
    names = session.robot.joint_names
    for stamp, value in zip(stamps, effort, strict=True):
        effort = [float(value), 0.0, 0.0]
        session.pipeline.push(JointMessage(round(1e9 * stamp), names, [0.0] * 3, [0.0] * 3, effort))
    samples = session.pipeline.collect()
    assert samples is not None
    return samples


@pytest.mark.parametrize("delay", [0.013, -0.02])
def test_efforts_are_freed_of_gain_and_delay(tmp_path: Path, delay: float) -> None:
    """measured(t) = gain true(t - delay), and messages are in halves of a newton metre."""
    known = [effect("effort_gain", "joint1", gain=1.25), effect("effort_delay", delay=delay)]
    session = session_with(tmp_path, known, **{"joint.joint1.effort_gain": 0.5})
    stamps = 1000.0 + 0.01 * np.arange(250)
    samples = pushed(session, stamps, 2.0 * 1.25 * np.sin(4.0 * (stamps - delay)))
    np.testing.assert_allclose(samples.effort[:, 0], np.sin(4.0e-9 * samples.stamps), atol=2e-3)


def test_wrenches_are_freed_of_their_offset(tmp_path: Path) -> None:
    """The offset is added to sign times what is reported."""
    offset = effect("wrench_offset", "/wrench", fx=1.0, tz=-2.0)
    sensors = [WrenchSensor("/wrench", "wrist_ft", "mounted", sign=-1.0), WrenchSensor("/other", "tool", "mounted")]
    configuration = Configuration({}, "test").with_sensors(sensors)
    session = session_with(tmp_path, [offset], **configuration.given_values)
    first, second = session.model.sensors
    assert first.offset == (1.0, 0.0, 0.0, 0.0, 0.0, -2.0)
    assert second.offset == (0.0,) * 6
    true = np.arange(1.0, 7.0)
    for index in range(150):
        stamp = 1_000_000_000_000 + 10_000_000 * index
        session.pipeline.push(JointMessage(stamp, session.robot.joint_names, [0.0] * 3, [], []))
        session.pipeline.push(WrenchMessage("/wrench", stamp, "wrist_ft", -(true + np.array(first.offset))))
        session.pipeline.push(WrenchMessage("/other", stamp, "tool", true))
    samples = session.pipeline.collect()
    assert samples is not None
    np.testing.assert_allclose(-samples.wrenches[:, 0], np.tile(true, (len(samples), 1)), atol=1e-9)
    np.testing.assert_allclose(samples.wrenches[:, 1], np.tile(true, (len(samples), 1)), atol=1e-9)


def estimated(session: Session) -> list[EffectEstimate]:
    """An estimate of the effects that is as good as what was known."""
    assert session.prior is not None
    values = session.prior[len(session.prior) - len(session.model.coefficients) :]
    return [
        EffectEstimate(
            name=c.effect.name, joint=c.place_name, parameters=c.parameters(float(value), 0.01), from_data=1.0
        )
        for c, value in zip(session.model.coefficients, np.nan_to_num(values, nan=1e-3), strict=True)
    ]


@pytest.mark.parametrize("common", [[""], ["viscous_friction", "coulomb_friction", "rotor_inertia", "effort_offset"]])
def test_an_estimate_from_a_model_is_the_model_again(tmp_path: Path, common: list[str]) -> None:
    known = [
        effect("coulomb_friction", "joint1", level=0.6, smoothing=0.3),
        effect("stribeck_friction", "joint2", level=2.0, excess=1.0, speed=0.5, smoothing=0.1),
        effect("spring", "joint3", stiffness=5.0, equilibrium=0.2),
        effect("effort_offset", "joint3", offset=0.7),
        effect("effort_gain", "joint3", gain=1.25),
        effect("effort_delay", delay=0.01),
        effect("gravity_tilt", tilt_x=0.1, tilt_y=0.0),
        effect("payload", "link3", **PAYLOAD),
        effect("backlash", "joint1", gap=0.01),
        effect("wrench_offset", "/wrench", fx=1.0),
    ]
    session = session_with(tmp_path, known, effects=common, candidates=[""])
    assert "backlash of joint1: not predicted" in session.loaded.not_predicted
    before, samples = predicted(session)
    links = tuple(
        replace(link_estimate(name, body.merged), parameters=p)
        for name, body, p in zip(
            session.model.body_names, session.robot.bodies, session.prior[:30].reshape(-1, 10), strict=True
        )
    )
    save(session, tmp_path / "again", estimate_of(*links, effects=tuple(estimated(session))))
    values = {"model": str(tmp_path / "again/estimate.json"), "effects": common, "candidates": [""]}
    again = Session(ARM, Configuration(values, "test"), "arm3.urdf")
    assert again.prior is not None
    np.testing.assert_allclose(again.prior[:30], session.prior[:30], rtol=1e-9)
    assert by_place(again) == pytest.approx(by_place(session), rel=1e-9)
    np.testing.assert_array_equal(again.robot.gravity, session.robot.gravity)
    held = ("effort_gain", "effort_delay", "gravity_tilt", "backlash", "wrench_offset")

    def kept(loaded: LoadedModel) -> dict[str, Any]:
        return {known.effect: known.parameters for known in loaded.effects if known.effect in held}

    assert kept(again.loaded) == kept(session.loaded) != {}
    found = again.model.predicted_efforts(samples, np.nan_to_num(again.prior))
    np.testing.assert_allclose(found, before, atol=0.05)


def test_beside_a_model_friction_is_as_sure_as_the_motion_it_was_found_in(tmp_path: Path) -> None:
    """The drift to other motions, which its std includes, would hide changes of friction."""
    coefficient = Quantity(0.3, 0.01, "N m s/rad")  # of an older file, without drift
    level, offset = Quantity(2.0, float(np.hypot(0.03, 2.0 * FRICTION_DRIFT)), "N m"), Quantity(0.7, 0.05, "N m")
    known = [
        KnownEffect("coulomb_friction", "joint1", "", {"level": level}),
        KnownEffect("effort_offset", "joint1", "", {"offset": offset}),
        KnownEffect("viscous_friction", "joint1", "", {"coefficient": coefficient}),
    ]
    session = session_with(tmp_path, known)
    places = {(c.effect.name, c.place_name): place for place, c in enumerate(session.model.coefficients)}
    deviations = session.loaded.coefficient_stds(session.model)[len(session.model.nominal_inertias) :]
    assert deviations[places["coulomb_friction", "joint1"]] == pytest.approx(0.03, rel=1e-3)
    assert deviations[places["effort_offset", "joint1"]] == pytest.approx(0.05, rel=1e-3)
    assert deviations[places["viscous_friction", "joint1"]] == pytest.approx(0.01)
    assert np.isnan(deviations[places["coulomb_friction", "joint2"]])


def by_place(session: Session) -> dict[tuple[str, str], float]:
    """The known coefficients, those that are not known as they were estimated."""
    return {(effect.name, effect.joint): effect.value for effect in estimated(session)}


def test_a_negative_excess_of_an_older_file_is_predicted_and_no_prior(tmp_path: Path) -> None:
    """Friction that sets in gradually was told as Stribeck friction once."""
    known = [effect("stribeck_friction", "joint2", level=2.0, excess=-1.0, speed=0.5)]
    session = session_with(tmp_path, known)
    samples = random_samples(session.robot, 1, count=20)
    assert session.prior is not None
    efforts = session.model.predicted_efforts(samples, np.nan_to_num(session.prior))
    rigid = session.model.predicted_efforts(samples, np.append(session.prior[:30], np.zeros(len(session.prior) - 30)))
    speeds = samples.velocity[:, 1]
    expected = (2.0 - np.exp(-((speeds / 0.5) ** 2))) * np.tanh(speeds / 0.02)
    np.testing.assert_allclose((efforts - rigid)[:, 1], expected, atol=1e-9)
    session.identifier.add(samples)
    assert all(one.value > 0.0 for one in session.identifier.solve().effects if one.name == "stribeck_friction")


def test_information_stands_where_the_links_of_the_robot_stand(tmp_path: Path) -> None:
    """Whatever their order in the file; of links that are not looked for it needs to say nothing. If it took other
    links for known, it is left."""
    names = ["link2", "link3", "link1"]
    found = estimate_of(*(link_estimate(name, merged) for name, merged in zip(names, [(), ("tool",), ()], strict=True)))
    by_name = dict(zip(names, np.split(found.information.rows, 3, axis=1), strict=True))
    values = {"model": str(tmp_path / "estimate.json")}
    write_json(tmp_path / "estimate.json", estimate_document(found, {}))
    for links in (["link1", "link2", "link3"], ["link1", "link3"]):
        session = Session(ARM, Configuration({**values, "links": links}, "test"), "arm3.urdf")
        known = session.loaded.information(session.model)
        assert known is not None
        np.testing.assert_allclose(known.rows, np.hstack([by_name[name] for name in links]), rtol=1e-6)
        np.testing.assert_allclose(known.residuals, found.information.residuals, rtol=1e-6)
    fewer = estimate_of(link_estimate("link3", ("tool",)), link_estimate("link1"))
    write_json(tmp_path / "estimate.json", estimate_document(fewer, {}))
    session = Session(ARM, Configuration(values, "test"), "arm3.urdf")
    assert session.loaded.information(session.model) is None


def test_joints_that_were_locked_for_the_model_are_locked_beside_it(tmp_path: Path) -> None:
    """No message named the fingers then: as in those recordings, they are part of the hand. Messages that name one are
    refused."""
    found = estimate_of(link_estimate("link3", ("tool", "finger1", "finger2")))
    write_json(tmp_path / "estimate.json", estimate_document(found, {}))
    configuration = Configuration({"model": str(tmp_path / "estimate.json")}, "test")
    heard = ["joint1", "joint2", "joint3"]

    def opened() -> Session:
        session, _ = read_with_locked(
            lambda own: Session(with_gripper(), own, "hand.urdf"),
            configuration,
            lambda session: session.received_joints.update(heard),
        )
        return session

    session = opened()
    assert list(session.robot.joint_names) == heard
    assert {"finger1", "finger2"} < set(session.robot.bodies[-1].merged)
    assert session.meaning["locked_joints"] == ["finger_joint1"]
    assert "'finger_joint1': locked at zero" in session.notes[0]
    heard.append("finger_joint1")
    with pytest.raises(InputError, match=r"joint 'finger_joint1' is missing.*\(--lock\)"):
        opened()


def test_of_several_shapes_the_known_one_counts(tmp_path: Path) -> None:
    """Of what nothing is known every shape may be there."""
    session = session_with(tmp_path, [effect("coulomb_friction", "joint1", level=0.6, smoothing=0.01)], effects=[""])
    shapes = [CoulombFriction(speed) for speed in (0.003, 0.01, 0.05)]
    model = MeasurementModel(session.robot, (), candidates=shapes)
    told = session.loaded.shape_mask(model)
    found = {(c.place_name, c.effect.smoothing) for c, is_told in zip(model.coefficients, told, strict=True) if is_told}
    others = {(joint, shape.smoothing) for joint in ("joint2", "joint3") for shape in shapes}
    assert found == {("joint1", 0.01)} | others
