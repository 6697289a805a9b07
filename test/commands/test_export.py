"""``geomid export``: from a recording to a controller's payload, and what is refused."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from files.recordings import BAGS

from .running import done, geomid, refused


def payload(output: str) -> tuple[float, np.ndarray, np.ndarray]:
    (called,) = (line for line in output.splitlines() if line.startswith("set_target_payload("))
    mass, com, inertia = ast.literal_eval(called.removeprefix("set_target_payload"))
    return mass, np.array(com), np.array(inertia)


def test_the_tool_of_a_recording_becomes_a_payload(wrist: Path) -> None:
    """The true one, within a few of the standard deviations that stand beside it."""
    document = json.loads((wrist / "estimate.json").read_text())
    (std,) = (link["std"] for link in document["links"] if link["name"] == "wrist_ft")
    truth = {link["name"]: link for link in json.loads((BAGS / "arm3.truth.json").read_text())["links"]}["tool"]
    output = done("export", wrist / "estimate.json", "--for", "ur", "--frame", "tool", "--links", "wrist_ft")
    mass, com, inertia = payload(output)
    assert abs(mass - truth["mass"]) < 4.0 * std["mass"]
    assert np.all(np.abs(com - truth["com"]) < 4.0 * np.array(std["com"]))
    order = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])
    assert np.all(np.abs(inertia - np.array(truth["inertia"])[order]) < 4.0 * np.array(std["inertia"])[order])
    assert f"{mass:.5g} ± {std['mass']:.2g}" in output


def test_what_the_torques_alone_do_not_show_is_refused(torques: Path) -> None:
    message = refused("export", torques / "estimate.json", "--for", "ur", "--frame", "wrist_ft")
    assert "'link3' was identified as one body with tool" in message
    message = refused("export", torques / "estimate.json", "--for", "franka", "--frame", "wrist_ft", "--links", "link3")
    assert "the data hardly identify" in message
    numbers = torques / "identified.urdf"
    assert "not known" in done("export", numbers, "--for", "franka", "--frame", "link3")


def test_a_doubtful_model_is_refused_unless_it_is_forced(wrist: Path, tmp_path: Path) -> None:
    document = json.loads((wrist / "estimate.json").read_text())
    document["verdict"] |= {"result": "doubtful", "reasons": ["the efforts are reversed", "gravity is missing"]}
    model = tmp_path / "estimate.json"
    model.write_text(json.dumps(document))
    (tmp_path / "identified.urdf").write_text((wrist / "identified.urdf").read_text())
    options = ("--for", "ur", "--frame", "tool", "--links", "wrist_ft")
    message = refused("export", model, *options)
    assert "this model's verdict is 'doubtful': the efforts are reversed; gravity is missing" in message
    assert "--force" in message
    result = geomid("export", model, *options, "--force")
    assert result.exit_code == 0
    said = f"Warning: {model}: this model's verdict is 'doubtful': the efforts are reversed; gravity is missing\n"
    assert result.stderr == said
    assert result.output.startswith(said)
    assert result.stdout == done("export", wrist / "estimate.json", *options)


def written(estimate: Path, reader: str) -> dict[str, list[dict[str, Any]]]:
    """Links and effects as they were fitted for a reader: moveit's are those of a URDF."""
    entries = json.loads(estimate.read_text())["handover"]
    entry: dict[str, list[dict[str, Any]]] = entries[reader.replace("moveit", "urdf")]
    return entry


def test_the_identified_urdf_has_the_friction_that_was_fitted_for_it(torques: Path) -> None:
    """As pinocchio reads it; and what it cannot hold is said."""
    robot = pin.buildModelFromXML((torques / "identified.urdf").read_text())
    effects = written(torques / "estimate.json", "urdf")["effects"]
    for name, found in {"viscous_friction": robot.damping, "coulomb_friction": robot.friction}.items():
        expected = np.zeros(3)
        for known in (known for known in effects if known["effect"] == name):
            (parameter,) = known["parameters"].values()
            expected[robot.joints[robot.getJointId(known["joint"])].idx_v] = parameter["value"]
        assert np.all(expected)
        np.testing.assert_allclose(found, expected, rtol=1e-8)
    printed = (torques / "printed").read_text()
    assert "Note: identified.urdf: the file cannot represent rotor inertia" in printed


def test_a_file_of_ones_own_is_printed_with_what_was_identified(torques: Path, tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    estimate, own = torques / "estimate.json", tmp_path / "own.xml"
    own.write_text(geomid("export", BAGS / "arm3.urdf", "--for", "mujoco").stdout)
    result = geomid("export", estimate, "--for", "mujoco", "--into", own)
    assert result.exit_code == 0
    found = mujoco.MjModel.from_xml_string(result.stdout)
    for link in written(estimate, "mjcf_joints")["links"]:
        assert found.body(link["name"]).mass[0] == pytest.approx(link["mass"])
    assert geomid("export", estimate, "--for", "drake", "--into", own).exit_code == 2
    own.write_text("<mujoco>")
    assert "MuJoCo cannot read this model" in refused("export", estimate, "--for", "mujoco", "--into", own)


def test_what_is_asked_for_must_make_sense(tmp_path: Path) -> None:
    urdf = BAGS / "arm3.urdf"
    assert "Did you mean 'tool'?" in refused("export", urdf, "--for", "ur", "--frame", "tol")
    assert "unknown link 'grip'" in refused("export", urdf, "--for", "ur", "--frame", "tool", "--links", "tool,grip")
    assert "'wrist_ft' is not a separate body: it has no mass" in refused(
        "export", urdf, "--for", "ur", "--frame", "tool", "--links", "wrist_ft"
    )
    for wrong, said in (
        (["--links", "tool"], "frame is missing"),
        (["--without", urdf], "frame is missing"),
        (["--frame", "tool", "--links", "tool", "--without", urdf], "links and without exclude each other"),
        (["--into", "robot.xml"], "into is a file of MuJoCo's"),
    ):
        assert said in refused("export", urdf, "--for", "gazebo", *wrong)
    impossible = tmp_path / "impossible.urdf"
    impossible.write_text(re.sub('izz="[^"]*"', 'izz="9"', urdf.read_text(), count=1))
    assert "'geomid prior URDF --mass KG'" in refused("export", impossible, "--for", "mujoco")
    assert "not an MJCF" in refused("export", urdf, "--for", "mujoco", "--into", urdf)
    both = ("--into", "robot.xml", "--frame", "tool")
    assert "into and frame exclude each other" in refused("export", urdf, "--for", "mujoco", *both)
