"""``geomid payload`` on the shipped bag: the tool is fixed to the last link, so nothing new is carried."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from commands.running import BAGS, done, geomid, refused

pytestmark = pytest.mark.usefixtures("without_pictures")


def test_an_estimate_stands_for_the_empty_recording(torques: Path) -> None:
    found = json.loads(geomid("payload", torques / "estimate.json", BAGS / "arm3", "--frame", "tool", "--json").stdout)
    assert found["frame"] == "tool"
    assert found["quantities"]["mass"] < 0.05
    urdf = BAGS / "arm3.urdf"
    both = json.loads(done("payload", BAGS / "arm3", BAGS / "arm3", "--urdf", urdf, "--frame", "tool", "--json"))
    assert both["quantities"]["mass"] < 0.05


def test_an_estimate_without_its_posterior_is_refused(torques: Path, tmp_path: Path) -> None:
    for name in ("estimate.json", "identified.urdf"):
        (tmp_path / name).write_bytes((torques / name).read_bytes())
    message = refused("payload", tmp_path / "estimate.json", BAGS / "arm3")
    assert f"{tmp_path / 'estimate.json'}: there is no posterior.npz beside it" in message
    assert "identify again" in message
