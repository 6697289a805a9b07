"""``geomid identify`` on the shipped bags: the truth is found, and the options do what they say."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from files.recordings import BAGS, QUICK, Recorded, altered, recorded
from rich.console import Console
from test_new_effect import with_wrench

from geomid_ros.commands.terminal import plain_table
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.effects import DEFAULT_CANDIDATES, DEFAULT_EFFECTS, effect_class
from geomid_ros.model.robot import Robot
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.recording import simulate

from .running import NO_CHOICE, WRIST, done, found_only, geomid, identify, link, read, refused

pytestmark = pytest.mark.usefixtures("found_only")

ROBOT = "arm7"
TABLES = {"links.csv", "effects.csv", "channels.csv"}
DRAWN = {"identification.png", "report.html"}
FILES = {"estimate.json", "identified.urdf", "effects.yaml", "posterior.npz", *DRAWN, *TABLES}
TOOL_MASS = 0.01  # relative error of the tool's mass, measured by the wrist's sensor
EXPLAINED = 0.5  # at least so much of the URDF's error on held-out data is gone
WRITTEN = 1e-8  # relative: the URDF has nine digits


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Folder and output of an identification with the wrist's sensor."""
    out = tmp_path_factory.mktemp("run") / "new/out"
    return out, done(*identify(ROBOT, *WRIST, "--out", out))


def test_without_a_report_nothing_is_drawn(tmp_path: Path) -> None:
    script = (
        "import sys\n"
        "from contextlib import suppress\n"
        "from geomid_ros.commands import main\n"
        "with suppress(SystemExit):\n"
        "    main()\n"
        "sys.exit('matplotlib' in sys.modules)"
    )
    arguments = identify("arm3", *NO_CHOICE, "--no-report", "--out", tmp_path)
    subprocess.run([sys.executable, "-c", script, *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)
    assert {path.name for path in tmp_path.iterdir()} == FILES - DRAWN


def test_the_tool_is_found_and_held_out_data_are_predicted_better(run: tuple[Path, str]) -> None:
    """On data that were not used: the table's column of what remains."""
    out, output = run
    truth = {entry["name"]: entry for entry in json.loads((BAGS / f"{ROBOT}.truth.json").read_text())["links"]}
    tool = link(read(out), "wrist_ft")
    assert tool["mass"] == pytest.approx(truth["tool"]["mass"], rel=TOOL_MASS)
    assert tool["merged"] == ["tool"]
    assert abs(tool["mass"] - truth["tool"]["mass"]) < 5.0 * tool["std"]["mass"]
    lines = map(str.rstrip, output.partition("residual on held-out data")[2].splitlines())
    rows = [line.split() for line in lines if " % " in line]
    assert len(rows) == 13
    assert all(float(row[row.index("%") - 1]) <= 100.0 * (1.0 - EXPLAINED) for row in rows), output


def test_the_estimate_is_whole_and_written_as_is_said(run: tuple[Path, str]) -> None:
    out, text = run
    assert {path.name for path in out.iterdir()} == FILES
    assert all(name in text.partition(f"Written to {out}: ")[2] for name in FILES)
    document = read(out)
    account = document["messages"]["joint_states"]
    count = account["received"]
    assert (account["accepted"], account["rejected"]) == (count, {})
    assert f"joint_states: {count} of {count} messages used" in text
    assert count == sum(item.topic == "/joint_states" for item in recorded(BAGS / ROBOT))
    assert document["verdict"] == {"result": "usable", "reasons": [], "causes": []}
    assert document["converged"] is True
    assert document["rows"]["accepted"] > 1000
    assert document["rms"]["held_out"].keys() == document["rms"]["nominal"].keys()
    joints = Robot(read_urdf(BAGS / f"{ROBOT}.urdf")).joint_names
    at_joints = [name for name in DEFAULT_EFFECTS if effect_class(name).place == "joint"]
    of_joints = {(name, joint) for name in at_joints for joint in joints}
    found = {(entry["name"], entry["joint"]) for entry in document["effects"]}
    assert of_joints <= found
    assert {name for name, _ in found - of_joints} <= set(DEFAULT_CANDIDATES)
    others = {(entry["effect"], entry["joint"]) for entry in document["added"]}
    assert {("wrench_offset", "/wrench"), *(("drive_gain", joint) for joint in joints)} <= others
    assert {name for name, _ in others} <= {"wrench_offset", "drive_gain", *DEFAULT_CANDIDATES}
    for entry in document["links"]:
        assert 0.0 <= entry["from_data"] <= 1.0
        assert entry["min_eigenvalue_ratio"] > 0.0
        assert np.linalg.eigvalsh(entry["inertia"])[0] > 0.0
    bodies = {body.name: body for body in Robot(read_urdf(out / "identified.urdf"), cuts=["wrist_ft"]).bodies}
    for entry in document["handover"]["urdf"]["links"]:
        body = bodies[entry["name"]]
        assert body.merged == ()
        assert body.parameters[0] == pytest.approx(entry["mass"], rel=WRITTEN)
        np.testing.assert_allclose(body.parameters[1:4], entry["mass"] * np.array(entry["com"]), atol=1e-8)


@pytest.fixture(scope="module")
def second(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Another motion of the small arm."""
    pytest.importorskip("mujoco")
    bag = tmp_path_factory.mktemp("second") / "bag"
    simulate(
        bag,
        SimulationOptions(
            robot="arm3", seed=2, motion_seed=7, duration=5.0, longest_step=QUICK, wrench_frame="wrist_ft"
        ),
    )
    return bag


def small(tmp_path: Path, *arguments: str | Path, status: int = 0) -> dict[str, Any]:
    """The printed estimate of the small arm, checked to be the written one."""
    with pytest.MonkeyPatch.context() as patch:
        found_only(patch)
        document: dict[str, Any] = json.loads(
            done(*identify("arm3", "--out", tmp_path, "--json", *arguments), status=status)
        )
    assert document == read(tmp_path)
    return document


def test_other_bags_to_validate_on(second: Path, tmp_path: Path) -> None:
    """All of the bag is identified from, and all of the other is tested on."""
    whole = small(tmp_path / "whole", *NO_CHOICE, "--hold-out", "0")
    validated = small(tmp_path / "validated", *NO_CHOICE, "--validate", second)
    assert validated["links"] == whole["links"]
    held_out, nominal = validated["rms"]["held_out"], validated["rms"]["nominal"]
    assert held_out.keys() == nominal.keys()
    assert all(held_out[channel] < nominal[channel] for channel in nominal)


def test_links_that_are_not_named_keep_their_inertia(tmp_path: Path) -> None:
    document = small(tmp_path, *NO_CHOICE, "--links", "link3, link2")
    assert [entry["name"] for entry in document["links"]] == ["link2", "link3"]
    bodies = {body.name: body for body in Robot(read_urdf(tmp_path / "identified.urdf")).bodies}
    nominal = {body.name: body for body in Robot(read_urdf(BAGS / "arm3.urdf")).bodies}
    np.testing.assert_array_equal(bodies["link1"].parameters, nominal["link1"].parameters)


def test_a_urdf_that_can_be_no_robot_s_is_refused_before_anything_is_solved(tmp_path: Path) -> None:
    """With inertias in g mm^2 a solve would take minutes, and say nothing."""
    text = (BAGS / "arm3.urdf").read_text()
    spoilt = re.sub(r'( i[xyz][xyz]=)"([^"]+)"', lambda found: f'{found[1]}"{1e9 * float(found[2])}"', text)
    (tmp_path / "arm3.urdf").write_text(spoilt)
    message = refused("identify", BAGS / "arm3", "--urdf", tmp_path / "arm3.urdf", "--out", tmp_path / "out")
    assert message.startswith(str(tmp_path / "arm3.urdf"))
    assert "g mm^2" in message
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("in_a_step")
def test_the_node_s_file_says_the_same_as_options(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(
        """/**:
  ros__parameters:
    use_sim_time: true
    effects: [viscous_friction, coulomb_friction, effort_offset]
    candidates: []
    gamma: 1e-3
    known: ["total=9:0.5", "link2+link3=4:1"]
    wrenches: [wrist]
    wrench: {wrist: {topic: /wrench, frame: wrist_ft}}
    sigma: {wrench.fx: 0.1}
"""
    )
    from_file = small(tmp_path / "a", "--config", tmp_path / "robot.yaml", status=3)
    assert from_file["gamma"] == 1e-3
    assert from_file["sigma"]["wrench/fx"] == 0.1
    assert len(from_file["effects"]) == 9
    weighed = {entry["name"]: entry["given"] for entry in from_file["known"]}
    assert weighed == {"total": 9.0, "link2 + link3": 4.0}
    assert from_file["verdict"]["reasons"][0] == f"the solver did not converge: {from_file['reason']}"
    options_win = small(tmp_path / "b", "--config", tmp_path / "robot.yaml", "--effects", "none", *WRIST, status=4)
    assert options_win["effects"] == []
    assert options_win["sigma"].keys() == from_file["sigma"].keys()


def tables(text: str) -> tuple[str, str]:
    """What is printed of effects of the joints, and of other effects."""
    table, _, others = text.partition("Joint effects")[2].partition("RMS of the residual")[0].partition("Other effects")
    return table, others


def test_the_shape_of_dry_friction_stands_beside_its_level(run: tuple[Path, str]) -> None:
    """Where it is not the usual one; it is no other effect for that."""
    out, text = run
    table, others = tables(text)
    shapes = [entry["smoothing"] for entry in read(out)["effects"] if "smoothing" in entry]
    assert shapes
    assert "smoothing" in table
    assert all(f" {smoothing:g} " in table for smoothing in shapes)
    assert "Coulomb friction" not in others


def test_weighed_masses_and_an_effect_of_two_numbers_are_told(tmp_path: Path) -> None:
    """All joints have Stribeck friction, and it is among the others, once, with its speed."""
    weighed = ("--known", "total=9:0.5", "--known", "link2+link3=4:1")
    effects = "viscous_friction,coulomb_friction,rotor_inertia,effort_offset,stribeck_friction"
    text = done(*identify("arm3", *WRIST, *NO_CHOICE, *weighed, "--effects", effects, "--out", tmp_path))
    table, others = tables(text)
    assert "stribeck" not in table
    assert others.count("Stribeck friction") == 3
    assert "weighed [kg]" in text
    known = {entry["name"]: entry for entry in read(tmp_path)["known"]}
    assert list(known) == ["total", "link2 + link3"]
    masses = {entry["name"]: entry["mass"] for entry in read(tmp_path)["links"]}
    assert known["link2 + link3"]["mass"] == pytest.approx(masses["link2"] + masses["link3"], rel=1e-12)
    assert f"9.000 ± 0.500 {known['total']['mass']:.3f} ± {known['total']['std']:.3f}" in " ".join(text.split())


@pytest.mark.parametrize("width", [80, 60, 40])
def test_a_narrow_table_keeps_names_and_numbers_whole(width: int) -> None:
    """What was cut is another number. Columns without room continue below, after what the rows are called."""
    title, rows, numbers = "Joint effects of an arm", ("elbow_joint", "wrist"), range(8)
    table = plain_table(title, ["joint", "what"], [f"friction {number}" for number in numbers])
    table.add_column("not identified")
    for name in rows:
        table.add_row(name, "at_rest", *(f"{12.5 + number:.3g} ± 1e+01" for number in numbers), "everything")
    output = StringIO()
    Console(width=width, file=output).print(table)
    printed = output.getvalue().splitlines()
    assert printed[0] == title
    assert all(len(line) <= width for line in printed)
    for name in rows:
        text = "   ".join(line for line in printed if line.startswith(f" {name} "))
        assert all(f" {12.5 + number:.3g} ± 1e+01 " in text for number in numbers)
        assert "   everything" in text
        assert text.count("at_rest") == text.count(f" {name}   ") > 1
    title, output = "Resimulation in short windows (error in units of the noise)", StringIO()
    Console(width=60, file=output).print(plain_table(title, ["channel"], ["before", "after"]))
    assert output.getvalue().startswith(f"{title}\n"), "as wide as the console at least"


def test_an_effect_that_only_some_joints_have(tmp_path: Path) -> None:
    """The model knows it at one joint, and it is not identified everywhere: it is among the others."""
    small(tmp_path / "a", "--effects", "viscous_friction", status=4)
    document = read(tmp_path / "a")
    document["effects"] = [entry for entry in document["effects"] if entry["joint"] == "joint2"]
    (tmp_path / "a/estimate.json").write_text(json.dumps(document))
    options = ("--model", tmp_path / "a/estimate.json", "--effects", "coulomb_friction")
    text = done(*identify("arm3", *options, "--out", tmp_path / "b"))
    found = {(entry["name"], entry["joint"]) for entry in read(tmp_path / "b")["effects"]}
    assert found == {("viscous_friction", "joint2"), *(("coulomb_friction", f"joint{k}") for k in (1, 2, 3))}
    table, others = tables(text)
    cells = {line.split()[0]: line.count("±") for line in map(str.strip, table.splitlines()) if "±" in line}
    assert cells == {"joint1": 2, "joint2": 2, "joint3": 2}, "with the gains of the drives"
    assert "Viscous friction" in others
    assert "at joint2" in others


def offsets(document: dict[str, Any]) -> dict[str, float]:
    """Those of the wrench sensor, by axis."""
    (found,) = (entry for entry in document["added"] if entry["effect"] == "wrench_offset")
    return {name: float(quantity["value"]) for name, quantity in found["parameters"].items()}


def test_an_offset_of_the_sensor_is_found_by_default(wrist: Path, tmp_path: Path) -> None:
    """Added to a recording: the tool weighs the same, and the offsets differ by what was added."""
    planted = dict(zip(("fx", "fy", "fz", "tx", "ty", "tz"), (3.0, -2.0, 16.0, 0.4, -0.3, 0.2), strict=True))

    def off(item: Recorded) -> Recorded:
        added = np.array([*planted.values()])
        return item.changed(wrench=with_wrench(item.message.wrench, added)) if item.topic == "/wrench" else item

    bag = altered(BAGS / "arm3", tmp_path / "bag", off)
    done("identify", bag, "--urdf", BAGS / "arm3.urdf", *WRIST, "--out", tmp_path / "out")
    before, after = read(wrist), read(tmp_path / "out")
    assert link(after, "wrist_ft")["mass"] == pytest.approx(link(before, "wrist_ft")["mass"], rel=TOOL_MASS)
    for axis, size in planted.items():
        assert offsets(after)[axis] - offsets(before)[axis] == pytest.approx(size, abs=0.02)


def test_a_reversed_sensor_is_named_and_its_rows_are_left_out(tmp_path: Path) -> None:
    """The reaction wrench is no body's weight."""
    result = geomid(*identify("arm3", "--wrench", "/wrench:wrist_ft:-mounted", *NO_CHOICE, "--out", tmp_path))
    assert result.exit_code == 4, result.output
    (cause,) = read(tmp_path)["verdict"]["causes"]
    assert cause["kind"] == "wrench"
    assert cause["settings"] == {"wrench.sensor0.sign": 1.0}
    assert read(tmp_path)["rows"]["rejected"]["wrench doubtful: /wrench"] > 0
    told = " ".join(result.stdout.partition("joint_states: ")[0].split())
    assert told.startswith("DOUBTFUL: the wrench sensor /wrench: its sign is reversed")
    assert "no minus before the role" in told


def test_a_doubtful_model_to_start_from_is_told_first(torques: Path, tmp_path: Path) -> None:
    model = tmp_path / "before.json"
    model.write_text(json.dumps(read(torques) | {"verdict": {"result": "not converged", "reasons": ["300 steps"]}}))
    said = f"{model}: this model's verdict is 'not converged': 300 steps"
    text = done(*identify("arm3", "--model", model, *NO_CHOICE, "--out", tmp_path / "out"))
    first, second, *_ = text.partition("joint_states:")[0].split("Warning: ")
    assert first.startswith("USABLE  Predicts efforts")
    assert second.startswith(f"{model}"[:20])
    assert "".join(said.split()) in "".join(text.partition("joint_states:")[0].split())
    assert read(tmp_path / "out")["warnings"][0] == said
    assert read(tmp_path / "out")["verdict"]["result"] == "usable"


@pytest.mark.usefixtures("in_a_step")
def test_a_fit_that_did_not_converge_says_so_first(tmp_path: Path) -> None:
    result = geomid(*identify("arm3", "--out", tmp_path))
    assert result.exit_code == 3, result.output
    assert result.stdout.lstrip().startswith("NOT CONVERGED: the solver did not converge: ")
