"""What changes in the whole model changes in each file, whose own model has the same effects in other places."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from files.effects import PAYLOAD, effect
from files.gaps import gap_result
from files.recordings import BAGS

from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.files.models.written_model import WrittenModel, fitted_model_of, with_shifted_parameters, write_model
from geomid_ros.gap.result import GapResult
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import GRAVITY, Robot
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.gap import gap_session
from geomid_ros.session.session import Session
from geomid_ros.session.written_simulation import nominal_inertias, write_found
from geomid_ros.types import FloatArray

ARM = read_urdf(BAGS / "arm3.urdf")
ROBOT = Robot(ARM)
BODIES = {body.name: body.parameters for body in ROBOT.bodies}


def session_of(folder: Path, urdf: str = ARM) -> Session:
    """That of the model in a folder."""
    return gap_session(urdf, Configuration({"model": str(folder / "estimate.json")}, "test"), "arm3.urdf")


def found(session: Session, bodies: dict[str, FloatArray], coefficients: FloatArray, **others: Any) -> GapResult:
    """Findings that end with these bodies and coefficients."""
    inertias = np.array([bodies[name] for name in session.model.body_names])
    result, names = gap_result("no gap", ROBOT.joint_names), session.model.body_names
    return replace(result, bodies=names, inertias=inertias, coefficients=coefficients, **others)


CUBE = pseudo_inertia.assemble(np.array(0.5), np.array([0.1, 0.0, 0.0]), 1e-3 * np.eye(3))


def test_a_link_is_heavier_and_lighter_in_each_file_by_what_it_is_in_the_model(tmp_path: Path) -> None:
    """In a file of which another link has its mass, it is what it is in the model: no body weighs less than nothing."""
    first, second, third = BODIES
    fitted = WrittenModel({**BODIES, second: 0.01 * BODIES[second], third: 1.5 * BODIES[third]}, ())
    write_model(tmp_path, MeasurementModel(ROBOT, ()), ARM, BODIES, (), GRAVITY, fitted={"urdf": fitted})
    session = session_of(tmp_path)
    now = {**BODIES, second: 0.5 * BODIES[second], third: BODIES[third] + CUBE}
    coefficients = np.full(len(session.model.coefficients), np.nan)
    write_found(tmp_path / "found", session, found(session, now, coefficients))
    file = EstimateFile.read(tmp_path / "found/estimate.json")
    written = fitted_model_of(file, "urdf")
    assert written is not None
    expected = {first: BODIES[first], second: now[second], third: 1.5 * BODIES[third] + CUBE}
    for name, own in expected.items():
        np.testing.assert_allclose(written.inertias[name], own, atol=1e-12, err_msg=name)
        np.testing.assert_allclose(file.inertias[name], now[name], atol=1e-12, err_msg=name)
    in_urdf = {body.name: body.parameters[0] for body in Robot(read_urdf(tmp_path / "found/identified.urdf")).bodies}
    assert in_urdf == pytest.approx({name: own[0] for name, own in expected.items()}, rel=1e-8)
    shapes = ElementTree.fromstring(ARM).findall("link/*/geometry")
    assert len(ElementTree.parse(tmp_path / "found/identified.xml").findall(".//geom")) == len(shapes) > 0


@pytest.mark.parametrize("fitted", [False, True])
def test_friction_that_a_file_cannot_say_is_folded_once(tmp_path: Path, fitted: bool) -> None:
    """A file that was fitted for its format has it already; one that was not has all of it anew."""
    effects = [
        effect("viscous_friction", "joint1", coefficient=2.0),
        effect("quadratic_friction", "joint1", coefficient=0.5),
    ]
    folded = {("joint1", "dynamics/damping"): 0.4}
    write_model(tmp_path, MeasurementModel(ROBOT, ()), ARM, BODIES, effects, GRAVITY, folded=folded)
    if not fitted:
        document = json.loads((tmp_path / "estimate.json").read_text())
        del document["handover"]
        (tmp_path / "estimate.json").write_text(json.dumps(document))
    session = session_of(tmp_path)
    assert session.prior is not None
    coefficients = session.prior[len(session.model.nominal_inertias) :]
    write_found(tmp_path / "found", session, found(session, BODIES, coefficients, folded=folded))
    joint = ElementTree.parse(tmp_path / "found/identified.urdf").find("joint[@name='joint1']/dynamics")
    assert joint is not None
    assert float(joint.attrib["damping"]) == pytest.approx(2.4)


@pytest.mark.parametrize("written", [False, True])
def test_a_model_with_a_payload_is_that_of_its_own_description_and_of_the_given_one(
    tmp_path: Path, written: bool
) -> None:
    name = next(reversed(BODIES))
    write_model(tmp_path, MeasurementModel(ROBOT, ()), ARM, BODIES, [effect("payload", name, **PAYLOAD)], GRAVITY)
    urdf = read_urdf(tmp_path / "identified.urdf" if written else BAGS / "arm3.urdf")
    session = session_of(tmp_path, urdf)
    nominal = dict(zip(session.model.body_names, nominal_inertias(session), strict=True))
    for link, own in (BODIES | {name: BODIES[name] + effect("payload", name, **PAYLOAD).body}).items():
        np.testing.assert_allclose(nominal[link], own, rtol=1e-12, err_msg=link)


@pytest.mark.parametrize("other", ["payload", "effort_gain"])
def test_from_a_urdf_a_file_is_that_of_identify_with_payloads_alone(tmp_path: Path, other: str) -> None:
    """Of links that had it: the file's are lighter by as much. A gain is in all that ``identify`` finds: then the file
    is the model."""
    first, second, third = BODIES
    given = gap_session(ARM, Configuration({}), "arm3.urdf")
    session = given.again({"effects": ["viscous_friction"], "candidates": []})
    coefficients = np.array([2.0, 3.0, 4.0])
    loaded = {**BODIES, third: BODIES[third] + CUBE}
    links = [SimpleNamespace(name=name, parameters=own) for name, own in loaded.items()]
    within = {"urdf": np.concatenate([1.1 * loaded[first], loaded[second], loaded[third], coefficients])}
    estimate = SimpleNamespace(links=links, within=within, parameters=within["urdf"], effects=())
    sure = effect("payload", third, **PAYLOAD) if other == "payload" else effect("effort_gain", "joint1", gain=1.2)
    friction = effect("viscous_friction", "joint2", coefficient=5.0)
    result = found(given, BODIES, np.zeros(0), ordinary=(sure, friction))
    identified: Any = SimpleNamespace(session=session, estimate=estimate)
    write_found(tmp_path, given, result, identified=identified)
    entry = EstimateFile.read(tmp_path / "estimate.json").handover["urdf"]
    masses, damping = {link.name: link.mass for link in entry.links}, {e.joint: e.values for e in entry.effects}
    own = {name: body[0] for name, body in BODIES.items()}
    beside = yaml.safe_load((tmp_path / "effects.yaml").read_text())["effects"]
    (listed,) = (each for each in beside if each["effect"] == "viscous_friction")
    assert listed["parameters"]["coefficient"]["value"] == 5.0
    assert listed.get("alone") == ({"coefficient": 3.0} if other == "payload" else None)
    if other == "payload":
        lighter = 1.1 * own[first], own[second], own[third]
        assert masses == pytest.approx(dict(zip(BODIES, lighter, strict=True)))
        assert [e.effect for e in entry.effects].count("payload") == 1
        assert damping["joint2"]["coefficient"] == 3.0
    else:
        assert masses == pytest.approx(own)
        assert damping["joint2"]["coefficient"] == 5.0


def test_friction_that_shrinks_is_never_less_than_nothing() -> None:
    friction = effect("coulomb_friction", "joint1", level=0.2)
    assert with_shifted_parameters(friction, {"level": -0.5}).parameters["level"].value == 0.0
    assert with_shifted_parameters(friction, {"level": -0.05}).parameters["level"].value == pytest.approx(0.15)
    assert WrittenModel({}, (with_shifted_parameters(friction, {"level": -0.5}), friction)).representable_in(
        ("urdf",)
    ).effects == (friction,)
