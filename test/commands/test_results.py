"""``geomid verify``: a model that was written before predicts a recording, or does not.

``geomid payload`` on the shipped bag: the tool is fixed to the last link, so nothing new is carried.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import geomid_ros

from .running import BAGS, WRIST, done, geomid, identify, read, refused, undrawn

BAG, URDF = BAGS / "arm3", BAGS / "arm3.urdf"
CHANNEL = "joint2"


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("model")
    with pytest.MonkeyPatch.context() as patch:
        undrawn(patch)
        done(*identify("arm3", *WRIST, "--hold-out", "0", "--out", out))
    return out / "estimate.json"


def verify(model: Path, *requirements: str) -> tuple[str | Path, ...]:
    required = [word for each in requirements for word in ("--require", each)]
    return ("verify", model, "--validate", BAG, "--urdf", URDF, *WRIST, *required)


def test_the_model_leaves_what_it_left_when_it_was_identified(model: Path) -> None:
    """On the same recording: numbers of the solver's own rows, which are made in another way."""
    found = geomid_ros.verify(model, BAG, URDF, wrench=WRIST[1])
    rms = read(model.parent)["rms"]
    for channel, numbers in found.rms.items():
        assert numbers["value"] == pytest.approx(rms["train"][channel], rel=0.02), channel
        if channel.startswith("joint"):  # of the wrench the model's offset is taken away before
            assert numbers["urdf"] == pytest.approx(rms["nominal"][channel], rel=0.02), channel
    assert found.passed
    assert repr(found).startswith("Verification of arm3: passed; RMS residual\n  joint1: value ")


def test_requirements_hold_or_do_not(model: Path) -> None:
    """Without any nothing passes or fails. The robot is that beside the model where no other is given."""
    output = done(*verify(model, "rms<2*floor", "rms<urdf", "total.mass>0", "from_data>=0"))
    assert "PASSED:" in output
    assert "FAILED" not in output
    assert output.count("rms<2*floor") == 9
    left = read(model.parent)["rms"]["train"][CHANNEL]
    result = geomid(*verify(model, f"{CHANNEL}.rms<{0.9 * left}", f"{CHANNEL}.rms<{1.1 * left}"))
    assert result.exit_code == 1
    assert result.stdout.count("passed") == 1
    assert "FAILED: 1 of 2 requirements hold" in " ".join(result.stdout.split())
    output = done("verify", model, "--validate", BAG, *WRIST)
    assert "NOT CHECKED: no requirement is given (--require)" in output
    assert "PASSED" not in output
    assert "identified.urdf" in output


def test_the_total_mass_is_that_of_the_whole_robot(model: Path) -> None:
    """As ``--known total=`` takes it: the base counts, too."""
    (total,) = geomid_ros.verify(model.parent, BAG, URDF, wrench=WRIST[1], require="total.mass<2*urdf").outcomes
    assert total.value == pytest.approx(3.0 + sum(link["mass"] for link in read(model.parent)["links"]))
    assert total.bound == f"< {2 * (3.0 + 2.2 + 1.7 + 1.0 + 0.5):.4g}"


def altered(model: Path, folder: Path, **entries: Any) -> Path:
    (folder / "altered.json").write_text(json.dumps(json.loads(model.read_text()) | entries))
    return folder / "altered.json"


def test_another_friction_is_noticed(model: Path, tmp_path: Path) -> None:
    effects = read(model.parent)["effects"]
    for effect in effects:
        if effect["name"] == "coulomb_friction" and effect["joint"] == CHANNEL:
            effect["value"] += 5.0
    result = geomid(*verify(altered(model, tmp_path, effects=effects), "rms<2*floor"))
    assert result.exit_code == 1
    failed = {line.split()[1] for line in result.stdout.splitlines() if line.rstrip().endswith("FAILED")}
    assert failed == {f"{CHANNEL}.rms"}


def test_a_doubtful_model_never_passes(model: Path, tmp_path: Path) -> None:
    doubtful = altered(model, tmp_path, verdict={"result": "doubtful", "reasons": ["its signs are reversed"]})
    result = geomid(*verify(doubtful, "rms<urdf"))
    assert result.exit_code == 1
    assert "its signs are reversed" in " ".join(result.stdout.split())
    assert "verdict is" not in result.stdout  # the heading says it
    assert "FAILED: no requirement is given (--require), doubtful" in geomid(*verify(doubtful)).stdout


def test_refusals(model: Path, tmp_path: Path) -> None:
    assert "Did you mean 'rms'" in refused(*verify(model, "rsm<2"))
    assert "missing.json" in refused("verify", tmp_path / "missing.json", "--validate", BAG, "--urdf", URDF)
    without = ("verify", model, "--validate", BAG, *WRIST, "--require", "rms<0.5*urdf")
    assert "--urdf" in refused(*without)
    assert "--validate" in geomid("verify", model).stderr


pytestmark = pytest.mark.usefixtures("without_pictures")


def test_an_estimate_stands_for_the_empty_recording(torques: Path, tmp_path: Path) -> None:
    found = json.loads(geomid("payload", torques / "estimate.json", BAGS / "arm3", "--frame", "tool", "--json").stdout)
    assert found["frame"] == "tool"
    assert found["quantities"]["mass"] < 0.05
    config = tmp_path / "payload.yaml"
    config.write_text("geomid: {ros__parameters: {payload: {gain: 0.2, frame: tool}}}", encoding="utf-8")
    both = json.loads(done("payload", BAG, BAG, "--urdf", URDF, "--config", config, "--json"))
    assert (found["gain"], both["gain"], both["frame"]) == (0.03, 0.2, "tool")
    assert both["quantities"]["mass"] < 0.05
    said = refused("payload", torques / "estimate.json", BAGS / "arm3", "--for", "ur", "--json")
    assert "--json and --for exclude each other" in said


def test_an_estimate_without_its_posterior_is_refused(torques: Path, tmp_path: Path) -> None:
    for name in ("estimate.json", "identified.urdf"):
        (tmp_path / name).write_bytes((torques / name).read_bytes())
    message = refused("payload", tmp_path / "estimate.json", BAGS / "arm3")
    assert f"{tmp_path / 'estimate.json'}: posterior.npz (the uncertainty of the estimate) is missing" in message
    assert "identify again" in message
