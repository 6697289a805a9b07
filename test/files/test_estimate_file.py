"""estimate.json: its keys, what it says, and starting from it again."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from geomid_ros.api.rebuild import tables
from geomid_ros.checks.causes import Cause, RecordingFault
from geomid_ros.checks.verdict import recording_verdict
from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import EffectEstimate
from geomid_ros.files.models.effects_file import by_parameter
from geomid_ros.files.models.estimate_file import EstimateFile, estimate_document, verdict_entry
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.files.models.written_model import write_model, written_model
from geomid_ros.files.schema import to_document
from geomid_ros.model.effects import Quantity, identified_effect
from geomid_ros.model.effects.friction import CoulombFriction
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import GRAVITY, Robot
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session

from .effects import PAYLOAD, effect
from .estimates import edited, estimate_of, link_estimate
from .recordings import BAGS

ARM = read_urdf(BAGS / "arm3.urdf")
EFFECT = EffectEstimate(
    name="coulomb_friction", joint="joint1", parameters={"level": Quantity(0.5, 0.05, "N m")}, from_data=0.9
)
ESTIMATE = estimate_of(link_estimate("link3", ("tool",), 1), link_estimate("link1", (), 2), effects=(EFFECT,))


def document(held_out: Any = None) -> dict[str, Any]:
    result: dict[str, Any] = json.loads(
        json.dumps(estimate_document(ESTIMATE, {"standing still": 4, "not measured": 0}, held_out), allow_nan=False)
    )
    return result


def test_the_document_says_what_the_estimate_says() -> None:
    result = document(np.array([0.7, np.nan]))
    assert (result["converged"], result["reason"], result["seconds"]) == (True, "gradient", 0.25)
    assert result["rows"] == {"accepted": 120, "set_aside": 3, "rejected": {"standing still": 4}}
    for written, link in zip(result["links"], ESTIMATE.links, strict=True):
        assert (written["name"], written["merged"], written["from_data"]) == (link.name, [*link.merged], link.from_data)
        assert (written["mass"], written["com"]) == (link.mass, link.com.tolist())
        assert written["inertia"] == link.inertia.tolist()
    assert (result["effects"][0]["value"], result["effects"][0]["from_data"]) == (EFFECT.value, EFFECT.from_data)
    assert result["rms"] == {
        "nominal": {"joint1": 1.0, "joint2": None},
        "train": {"joint1": 0.5, "joint2": None},
        "held_out": {"joint1": 0.7, "joint2": None},
    }


def test_units_are_those_of_the_joint() -> None:
    """Of a rail N and m, in a table, when read, and in a description's model."""
    rail = Robot(ARM.replace("revolute", "prismatic"))
    effects = [*map(identified_effect, ("viscous_friction", "spring", "effort_offset")), CoulombFriction(0.01)]
    model = MeasurementModel(rail, effects)
    estimate = estimate_of(
        *(link_estimate(name, seed=k) for k, name in enumerate(model.body_names)),
        effects=tuple(
            EffectEstimate(name=c.effect.name, joint=c.place_name, parameters=c.parameters(0.5, 0.1), from_data=0.9)
            for c in model.coefficients
        ),
    )
    units = {
        ("viscous_friction", "coefficient"): "N s/m",
        ("coulomb_friction", "level"): "N",
        ("coulomb_friction", "smoothing"): "m/s",
        ("spring", "stiffness"): "N/m",
        ("spring", "equilibrium"): "m",
        ("effort_offset", "offset"): "N",
    }
    result = estimate_document(estimate, {})
    found = {((row["effect"], row["parameter"]), row["unit"]) for row in tables(result)["effects"]}
    for known in (EstimateFile.of(result, "").known_effects, written_model(model, estimate, "mujoco").effects):
        found |= {((effect, name), q.unit) for (effect, _, name), q in by_parameter(known).items()}
    assert found == set(units.items())


def session_from(model: Path) -> Session:
    return Session(ARM, Configuration({"model": str(model)}, "test"), "arm3.urdf")


def of_another_robot(result: dict[str, Any]) -> None:
    for link in result["links"]:
        link["name"] = "leg_" + link["name"]
    result["information"]["links"] = [link["name"] for link in result["links"]]


NOT_FINITE = base64.b64encode(np.full(20, np.nan, "<f4").tobytes()).decode()
UNUSABLE: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "no links": (edited("links"), "no 'links'"),
    "no effects": (edited("effects"), "'effects'"),
    "another format": (edited("format", value=99), "format 99"),
    "information of other links": (edited("information", "rows", value="AAAAAA=="), "the information on 2 links"),
    "information in another order": (edited("information", "links", value=["link1", "link3"]), "in another order"),
    "a link twice": (edited("links", 1, "name", value="link3"), "two links 'link3'"),
    "a link merged with another one": (
        edited("links", 0, "merged", value=["hand"]),
        "'link3' was identified together with",
    ),
    "information that is not finite": (
        edited("information", "residuals", value=NOT_FINITE),
        "more precise than any measurement",
    ),
    "an impossible inertia": (
        edited("links", 0, "inertia", 0, value=[9.0, 0.0, 0.0]),
        "the inertia of link 'link3' is not physically consistent",
    ),
    "negative friction": (edited("effects", 0, "value", value=-0.1), "must be positive"),
    "an impossible smoothing": (
        edited("effects", 0, "smoothing", value=0.0),
        "smoothing of coulomb_friction at 'joint1' is 0, expected a number above 0",
    ),
    "a smoothing that is no number": (
        edited("effects", 0, "smoothing", value="slow"),
        "smoothing of coulomb_friction at 'joint1' is 'slow', expected a finite number",
    ),
    "an unknown effect": (edited("added", value=[{"effect": "springs"}]), r"added\[0\]: unknown effect 'springs'"),
    "an effect without its parameter": (
        edited("added", value=[{"effect": "effort_delay", "parameters": {}}]),
        r"added\[0\] \(effort_delay\): parameters: delay is not given",
    ),
    "an impossible delay": (
        edited("added", value=[to_document(effect("effort_delay", delay=2.0))]),
        r"added\[0\] .*delay is 2, expected a number .*below 1",
    ),
    "a payload of another robot": (
        edited("added", value=[to_document(effect("payload", "hand", **PAYLOAD))]),
        "unknown link with a payload 'hand'.*link3",
    ),
    "another robot": (of_another_robot, "another robot.*leg_link3.*link1, link2, link3"),
}


@pytest.mark.parametrize("case", UNUSABLE)
def test_an_estimate_that_cannot_be_used_is_refused(case: str, tmp_path: Path) -> None:
    edit, message = UNUSABLE[case]
    result = document()
    edit(result)
    path = tmp_path / "estimate.json"
    path.write_text(json.dumps(result))
    with pytest.raises(InputError, match=f"estimate.json: .*{message}"):
        session_from(path)


@pytest.mark.parametrize("text", ["", "[]", "[" * 100_000, "\x00"])
def test_what_is_no_json_object_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "estimate.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"estimate.json: "):
        session_from(path)


REVERSED = RecordingFault(cause=Cause(kind="sign", sentence="the efforts are reversed"))
SHIFTED = RecordingFault(cause=Cause(kind="order", sentence="two joints are exchanged"))


def written(folder: Path, *findings: RecordingFault) -> Path:
    """The model of the small arm from a recording with these findings."""
    robot = Robot(ARM)
    inertias = {body.name: body.parameters for body in robot.bodies}
    write_model(folder, MeasurementModel(robot, ()), ARM, inertias, (), GRAVITY, findings=findings)
    return folder / "estimate.json"


def test_a_model_of_a_doubtful_recording_is_told_first_with_all_reasons(tmp_path: Path) -> None:
    model = written(tmp_path, REVERSED, SHIFTED)
    entry = json.loads(model.read_text())["verdict"]
    assert entry == verdict_entry(recording_verdict([REVERSED, SHIFTED]), [REVERSED, SHIFTED])
    first = session_from(model).review.warnings(verdict=recording_verdict((), warnings=["something else"]))[0]
    assert first == f"{model}: this model's verdict is 'doubtful': {REVERSED.sentence}; {SHIFTED.sentence}"


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ({"converged": True, "reason": "gradient"}, ""),
        ({"converged": False, "reason": "300 steps"}, "'not converged': 300 steps"),
        ({"verdict": verdict_entry(recording_verdict((), "300 steps"), ())}, "did not converge: 300 steps"),
        ({"verdict": verdict_entry(recording_verdict([REVERSED], "300 steps"), ())}, "reversed; the solver did not"),
        ({"verdict": {"result": "doubtful"}}, "no reason is given"),
    ],
)
def test_what_speaks_against_an_estimate(document: dict[str, Any], said: str) -> None:
    sentence = EstimateFile.of({"links": [], "effects": [], **document}, "a.json").warning
    assert bool(sentence) == bool(said)
    assert said in sentence


@pytest.mark.parametrize("entry", ["doubtful", {"result": "fine"}, {}])
def test_what_is_no_verdict_is_refused(entry: object) -> None:
    with pytest.raises(InputError, match=r"a\.json: "):
        assert EstimateFile.of({"links": [], "effects": [], "verdict": entry}, "a.json").warning
