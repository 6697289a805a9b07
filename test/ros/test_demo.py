"""``geomid demo``, faster than it is shown to people."""

from __future__ import annotations

import json

import pytest
from files.recordings import BAGS

from .stage import Stage


def test_the_demonstration(stage: Stage) -> None:
    demo = stage.start("geomid_ros", "demo", "--rate", "6", "--out", stage.folder / "out", fresh=True)
    stage.spin_while(demo)
    out = stage.folder / "out"
    assert {path.name for path in out.iterdir()} == {
        "estimate.json",
        "identified.urdf",
        "posterior.npz",
        "identification.png",
    }
    for path in out.iterdir():
        assert str(path) in demo.output
    truth = {link["name"]: link for link in json.loads((BAGS / "arm7.truth.json").read_text())["links"]}
    found = {link["name"]: link for link in json.loads((out / "estimate.json").read_text())["links"]}
    assert found["wrist_ft"]["mass"] == pytest.approx(truth["tool"]["mass"], rel=0.01)
    assert "offline gives the same masses within" in demo.output
