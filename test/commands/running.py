"""Running commands in this process."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from files.recordings import BAGS
from matplotlib.figure import Figure

from geomid_ros.commands import root
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import EstimatorSettings, estimate
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.model.measurement_model import MeasurementModel

WRIST = ("--wrench", "/wrench:wrist_ft:mounted")
# To choose among effects takes most of an identification's time.
NO_CHOICE = ("--candidates", "none")


def geomid(*arguments: str | Path) -> Result:
    """Run ``geomid`` with these arguments."""
    return CliRunner().invoke(root, [str(argument) for argument in arguments], prog_name="geomid")


def done(*arguments: str | Path, status: int = 0) -> str:
    """What a command prints that must succeed, or end with another exit status."""
    result = geomid(*arguments)
    assert result.exit_code == status, result.output
    assert result.stderr == ""
    return str(result.stdout)


def refused(*arguments: str | Path) -> str:
    """The one message, without a traceback, of a command that must end with status 2."""
    result = geomid(*arguments)
    assert result.exit_code == 2, result.output
    assert isinstance(result.exception, SystemExit), result.exception
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    assert sum(line.startswith("Error: ") for line in result.stderr.splitlines()) == 1
    message = result.stderr.partition("Error: ")[2]
    assert 0 < len(message.splitlines()) <= 2, message
    return str(message)


def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let results be written without pictures, where nobody looks at them: to draw takes longer than all the rest."""
    monkeypatch.setattr("geomid_ros.report.drawing.draw_identification", lambda *_: Figure((1.0, 1.0)))
    monkeypatch.setattr("geomid_ros.api.gap.write_gap_page", lambda *_: None)
    monkeypatch.setattr("geomid_ros.report.excitation.motion_figure", lambda *_: Figure((1.0, 1.0)))


def as_estimated(
    model: MeasurementModel, summary: RowSummary, settings: EstimatorSettings, *others: Any, **_: Any
) -> Estimate:
    """The estimate, also in place of a fit for each file, which takes as long again."""
    found = estimate(model, summary, replace(settings, files={}), *others)
    return replace(found, within=dict.fromkeys(settings.files, found.parameters))


def found_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let nothing be made of what is found, where nobody looks at it: it takes as long as to find it."""
    undrawn(monkeypatch)
    monkeypatch.setattr("geomid_ros.estimation.identifier.estimate", as_estimated)
    monkeypatch.setattr("geomid_ros.api.identify.Identification._remainder", lambda *_: None)
    monkeypatch.setattr("geomid_ros.api.gap.simulate_again", lambda *_: ([], "nobody looks at it"))


def identify(robot: str, *arguments: str | Path) -> tuple[str | Path, ...]:
    """The arguments that identify a shipped robot from its shipped bag, before others."""
    return ("identify", BAGS / robot, "--urdf", BAGS / f"{robot}.urdf", *arguments)


def read(out: Path) -> dict[str, Any]:
    """The estimate in a folder."""
    document: dict[str, Any] = json.loads((out / "estimate.json").read_text())
    return document


def link(document: dict[str, Any], name: str) -> dict[str, Any]:
    """A link of an estimate."""
    found: dict[str, Any] = next(entry for entry in document["links"] if entry["name"] == name)
    return found
