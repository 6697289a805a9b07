"""``geomid gap``: what is hidden in a recording comes out at the other end, and what cannot be judged is refused."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from files.gaps import gap_result
from files.recordings import BAGS, QUICK, Recorded, altered, recorded, write_bag

from geomid_ros.commands.recording_results import show_gap
from geomid_ros.files.models.effects_file import read_sidecar
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.effects import KnownEffect, Quantity
from geomid_ros.model.robot import Robot
from geomid_ros.simulation.options import Hidden, SimulationOptions
from geomid_ros.simulation.recording import simulate

from .running import done, geomid, refused

URDF = BAGS / "arm3.urdf"
LEVEL = 1.0  # of the friction that is hidden at joint2 [N m]
MODEL = {"estimate.json", "identified.urdf", "identified.xml", "effects.yaml"}
FILES = {"gap.json", "findings.csv", "report.html", *MODEL}
Arguments = Sequence[str | Path]


def robot(bag: Path, *hide: Hidden, **options: Any) -> Path:
    """A recording of the small arm in which ``hide`` is hidden."""
    pytest.importorskip("mujoco")
    usual: dict[str, Any] = {"robot": "arm3", "seed": 5, "duration": 12.0, "longest_step": QUICK, "commands": True}
    simulate(bag, SimulationOptions(**usual, hide=hide, **options))
    return bag


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("gap")


@pytest.fixture(scope="module")
def rubbing(folder: Path) -> Path:
    return robot(folder / "rubbing", Hidden("coulomb_friction", "joint2", LEVEL))


@pytest.fixture(scope="module")
def found(folder: Path, rubbing: Path) -> tuple[Path, str]:
    """The folder of results of that recording, and what was printed."""
    out = folder / "new/out"
    return out, done("gap", rubbing, "--urdf", URDF, "--out", out, "--command", "/joint_commands")


def read(out: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((out / "gap.json").read_text())
    return document


def test_what_was_hidden_is_found_and_the_gap_shrinks_on_data_that_were_not_fitted(found: tuple[Path, str]) -> None:
    """Also where the written model is simulated again."""
    document = read(found[0])
    finding = document["findings"][0]
    assert finding["joint"] == "joint2"
    assert finding["parameters"]["level"]["value"] == pytest.approx(LEVEL, rel=0.05)
    assert finding["parameters"]["level"]["unit"] == "N m"
    before, after = document["gap"]["before"], document["gap"]["after"]
    assert set(before) == set(after) == {"joint1", "joint2", "joint3"}
    assert after["joint2"] < 0.1 * before["joint2"]
    for how in ("resimulated", "closed_loop"):
        assert document[how]["after"]["joint2"] < 0.3 * document[how]["before"]["joint2"], how
    assert "Resimulation in closed" in found[1]


def test_the_terminal_and_the_page_say_the_same(found: tuple[Path, str]) -> None:
    out, text = found
    assert {path.name for path in out.iterdir()} == FILES
    assert all(name in text.partition(f"Written to {out}: ")[2] for name in FILES)
    page = (out / "report.html").read_text()
    said = " ".join(text.partition("Findings")[0].split()[1:])
    sentence, sure, what = said.partition(" Sure: ")
    assert sentence.startswith("Found: ")
    assert sentence in page
    assert f"<li>{sure.strip()} {what}</li>" in page
    assert "Resimulation" in page
    assert re.search(r"Findings \(sure ones .* %, sure ", " ".join(text.split()))
    assert re.search(r">sure\b", page)
    assert "confident" not in text
    assert text.count("95 % interval") == 0, "numbers that the table has are not repeated with other deviations"


def test_the_written_model_has_what_was_found(found: tuple[Path, str]) -> None:
    out, _ = found
    level = read(out)["findings"][0]["parameters"]["level"]["value"]
    assert "robot: arm3\n" in (out / "effects.yaml").read_text()
    sidecar = {(effect.effect, effect.joint): effect for effect in read_sidecar(out / "effects.yaml")}
    assert sidecar["coulomb_friction", "joint2"].parameters["level"].value == pytest.approx(level, rel=0.05)
    estimate, robot = EstimateFile.read(out / "estimate.json"), Robot(read_urdf(out / "identified.urdf"))
    assert robot.described_dynamics["joint2", "dynamics/friction"] == pytest.approx(level, rel=0.05)
    written = {link.name: link.mass for link in estimate.handover["urdf"].links}
    assert written == pytest.approx({body.name: body.parameters[0] for body in robot.bodies}, rel=1e-8)


def test_what_identify_finds_is_printed_by_joint(capsys: pytest.CaptureFixture[str]) -> None:
    """In the order of the robot's joints, whichever was found first."""
    sizes = {"joint2": 2.5, "joint1": 1.5}
    offsets = [KnownEffect("effort_offset", name, "", {"offset": Quantity(v, 0.1, "N m")}) for name, v in sizes.items()]
    result = replace(gap_result("named", ["joint1", "joint2"]), ordinary=tuple(offsets))
    review = SimpleNamespace(findings=(), warnings=tuple)
    session = SimpleNamespace(review=review, notes=())
    found: Any = SimpleNamespace(result=result, session=session, handover=None, simulated=(), not_simulated="")
    show_gap(found)
    table = capsys.readouterr().out.partition("of the written model (sure ones, and those of identify)")[2]
    head = r"[^A-Z]*effort[^A-Z]*offset[^A-Z]*\[N m\][^A-Z]*"
    assert re.match(head + r"joint1 +1.50 ± 0.10\s+joint2 +2.50 ± 0.10", table)


@pytest.mark.usefixtures("found_only")
def test_the_model_of_a_doubtful_recording_is_marked_so(tmp_path: Path) -> None:
    parameters = tmp_path / "reversed.yaml"
    parameters.write_text("/**: {ros__parameters: {effort_gain: -1.0}}")
    result = geomid("gap", BAGS / "arm3", "--urdf", URDF, "--config", parameters, "--out", tmp_path / "out")
    assert result.exit_code == 4, result.output
    verdict = EstimateFile.read(tmp_path / "out/estimate.json").document["verdict"]
    assert (verdict["result"], verdict["causes"]) == ("doubtful", read(tmp_path / "out")["causes"])
    assert result.stdout.lstrip().startswith("DOUBTFUL: ")


def test_where_nothing_is_hidden_coloured_noise_is_no_effect(tmp_path: Path) -> None:
    bag = robot(tmp_path / "bag", inertia_error=0.0, noise_time=0.05)
    text = done("gap", bag, "--urdf", URDF, "--out", tmp_path / "out")
    assert text.startswith("NO GAP  No gap found")
    assert "Findings" not in text
    assert "No gap found" in (tmp_path / "out/report.html").read_text()
    assert read(tmp_path / "out")["findings"] == []


def test_beside_a_model_a_joint_may_be_without_efforts(torques: Path, tmp_path: Path) -> None:
    def silent(item: Recorded) -> Recorded:
        if item.topic != "/joint_states":
            return item
        return item.changed(
            effort=np.where([name == "joint2" for name in item.message.name], np.nan, item.message.effort)
        )

    arguments = "--urdf", URDF, "--model", torques / "estimate.json", "--out", tmp_path / "out"
    done("gap", altered(BAGS / "arm3", tmp_path / "bag", silent), *arguments, "--no-report")
    assert not (tmp_path / "out/report.html").exists()
    judged = {name for name, size in read(tmp_path / "out")["floor"].items() if size is not None}
    assert judged == {"joint1", "joint3"}
    assert not read(tmp_path / "out")["findings"]


# --- What is refused ---


def joints(**fields: object) -> Callable[[Recorded], Recorded]:
    """Changes joint messages."""
    return lambda item: item.changed(**fields) if item.topic == "/joint_states" else item


def standing(folder: Path) -> Arguments:
    """The small arm's recording of a robot that never moves."""
    still = joints(position=np.array([0.1, 0.2, 0.3]), velocity=np.zeros(3))
    return altered(BAGS / "arm3", folder / "still", still), "--urdf", URDF, "--hold-out", "0.1"


def without_efforts(folder: Path) -> Arguments:
    return altered(BAGS / "arm3", folder / "silent", joints(effort=np.array([]))), "--urdf", URDF


@pytest.mark.usefixtures("found_only")
def test_what_the_users_simulator_knows_is_no_gap(folder: Path, rubbing: Path) -> None:
    """The robot has the friction and a spring; its simulator moves the same way, with the friction alone."""
    measured = robot(folder / "both", Hidden("coulomb_friction", "joint2", LEVEL), Hidden("spring", "joint3", 0.5))
    out = folder / "with a simulator"
    done("gap", measured, "--urdf", URDF, "--simulated", rubbing, "--out", out)
    named = {(finding["effect"], finding["joint"]) for finding in read(out)["findings"]}
    assert named == {("spring", "joint3")}
    assert read(out)["findings"][0]["parameters"]["stiffness"]["value"] == pytest.approx(0.5, rel=0.05)


def cut(folder: Path, seconds: float) -> Path:
    items = recorded(BAGS / "arm3")
    end = items[0].time + seconds * 1e9
    return write_bag(folder / "cut", [item for item in items if item.time < end])


def twin(make: Callable[[Path], Path | str]) -> Callable[[Path], Arguments]:
    return lambda folder: (BAGS / "arm3", "--urdf", URDF, "--simulated", make(folder))


def other_motion(folder: Path) -> Path:
    def moved(item: Recorded) -> Recorded:
        return item.changed(position=-item.message.position, velocity=-item.message.velocity)

    return altered(BAGS / "arm3", folder / "mirrored", lambda i: moved(i) if i.topic == "/joint_states" else i)


def without_names(folder: Path) -> Path:
    return altered(BAGS / "arm3", folder / "renamed", joints(name=["a", "b", "c"]))


CASES: dict[str, tuple[Callable[[Path], Arguments], str]] = {
    "too short for the filter": (lambda f: (cut(f, 0.3), "--urdf", URDF), r"cut: no usable samples. it is shorter"),
    "too short to say anything": (lambda f: (cut(f, 2.5), "--urdf", URDF), r"cut: too short: .*record half a minute"),
    "without motion": (standing, r"still: no joint moves: record a motion"),
    "without efforts": (without_efforts, r"silent: no effort is measured.*joint1, joint2, joint3"),
    "no held-out data": (
        lambda _: (BAGS / "arm3", "--urdf", URDF, "--hold-out", "0"),
        r"no held-out data: hold out.*--hold-out.*--validate",
    ),
    "no such topic of commands": (
        lambda _: (BAGS / "arm3", "--urdf", URDF, "--command", "/cmd"),
        r"arm3: has no topic /cmd; --command names another",
    ),
    "no such simulation": (twin(lambda f: f / "nowhere"), "nowhere: no such bag"),
    "more simulations than bags": (
        lambda _: (BAGS / "arm3", "--urdf", URDF, *2 * ("--simulated", BAGS / "arm3")),
        "2 recordings of a simulator for 1 bags: give --simulated once for each bag",
    ),
    "a simulation of another robot": (twin(without_names), r"renamed: no usable samples.*'joint1' is missing"),
    "a shorter simulation": (
        twin(lambda f: cut(f, 5.0)),
        r"cut: 4.\d s of simulation for the 7.\d s of .*arm3. Record",
    ),
    "a simulation of another motion": (twin(other_motion), r"mirrored: joint 'joint\d' moves otherwise than in .*arm3"),
    "a simulation without efforts": (twin(lambda f: without_efforts(f)[0]), r"silent: no effort is measured"),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_refused(case: str, tmp_path: Path) -> None:
    make, message = CASES[case]
    out = tmp_path / "out"
    text = refused("gap", *make(tmp_path), "--out", out)
    assert re.search(message, text), text
    assert not out.exists()
