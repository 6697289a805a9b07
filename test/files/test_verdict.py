"""The verdict of an ``estimate.json`` is told wherever the estimate is used."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.checks.verdict import recording_verdict
from geomid_ros.errors import InputError
from geomid_ros.files.models.estimate_file import EstimateFile, verdict_entry
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.files.models.written_model import write_model
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.robot import GRAVITY, Robot
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session

from .recordings import BAGS

ARM = read_urdf(BAGS / "arm3.urdf")
REVERSED = Finding(cause=Cause(kind="sign", sentence="the efforts are reversed"))
SHIFTED = Finding(cause=Cause(kind="order", sentence="two joints are exchanged"))


def written(folder: Path, *findings: Finding) -> Path:
    """The model of the small arm from a recording with these findings."""
    robot = Robot(ARM)
    inertias = {body.name: body.parameters for body in robot.bodies}
    write_model(folder, MeasurementModel(robot, ()), ARM, inertias, (), GRAVITY, findings=findings)
    return folder / "estimate.json"


def session(model: Path) -> Session:
    return Session(ARM, Configuration({"model": str(model)}), "arm3.urdf")


def test_a_model_of_a_doubtful_recording_is_told_first_with_all_reasons(tmp_path: Path) -> None:
    model = written(tmp_path, REVERSED, SHIFTED)
    entry = json.loads(model.read_text())["verdict"]
    assert entry == verdict_entry(recording_verdict([REVERSED, SHIFTED]), [REVERSED, SHIFTED])
    first = session(model).warnings(verdict=recording_verdict((), warnings=["something else"]))[0]
    assert first == f"{model}: this model's verdict is 'doubtful': {REVERSED.sentence}; {SHIFTED.sentence}"


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ({}, ""),
        ({"converged": True, "reason": "gradient"}, ""),
        ({"converged": False, "reason": "300 steps"}, "'not converged': 300 steps"),
        ({"verdict": verdict_entry(recording_verdict((), "300 steps"), ())}, "did not converge: 300 steps"),
        ({"verdict": verdict_entry(recording_verdict([REVERSED], "300 steps"), ())}, "reversed; the solver did not"),
        ({"verdict": {"result": "doubtful"}}, "no reason is given"),
    ],
)
def test_what_speaks_against_an_estimate(document: dict[str, Any], said: str) -> None:
    sentence = EstimateFile.of({"links": [], "effects": [], **document}, "a.json").doubt
    assert bool(sentence) == bool(said)
    assert said in sentence


@pytest.mark.parametrize("entry", ["doubtful", None, {"result": "fine"}, {"result": "usable", "reasons": "none"}, {}])
def test_what_is_no_verdict_is_refused(entry: object) -> None:
    with pytest.raises(InputError, match=r"a\.json: "):
        assert EstimateFile.of({"links": [], "effects": [], "verdict": entry}, "a.json").doubt
