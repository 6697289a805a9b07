"""What ``find_gap`` writes is what it judged: loaded again, the files leave of unseen data what the table says."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from commands.running import found_only
from files.recordings import BAGS, QUICK, Recorded, altered

import geomid_ros
from geomid_ros.exports.model import read_model
from geomid_ros.files.models.estimate_file import EstimateFile, HandoverEntry
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.recording import simulate

JOINT = "joint2"
Change = Callable[[float, float, float, float], float]  # of position, velocity, effort and time [s]


@dataclass(frozen=True)
class Case:
    """How the measured effort of one joint is changed in the recording, and in the unseen one."""

    verdict: str
    change: Change
    unseen: Change
    names: tuple[str, ...] = ()
    depends_on: tuple[str, ...] = ()


def untouched(_q: float, _v: float, effort: float, _t: float) -> float:
    return effort


def rubbing(_q: float, v: float, effort: float, _t: float) -> float:
    return effort + 2.0 * v


def scaled(_q: float, _v: float, effort: float, _t: float) -> float:
    return 1.2 * (effort + 3.0)


def rough(q: float, _v: float, effort: float, _t: float) -> float:
    return effort + 2.0 * np.sin(9.0 * q + 1.0)


def creeping(_q: float, _v: float, effort: float, t: float) -> float:
    return effort + 0.2 * (t % 100.0)


CASES = [
    Case("named", scaled, scaled, ("effort_gain", "effort_offset")),
    Case("unexplained", rough, rough, depends_on=("position",)),
    Case("incomplete", untouched, creeping, depends_on=("time",)),
]


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two motions of one robot, whose URDF has wrong inertias and no effects."""
    pytest.importorskip("mujoco")
    folder = tmp_path_factory.mktemp("robot")
    options = SimulationOptions(robot="arm3", seed=5, duration=12.0, longest_step=QUICK, hide=())
    for motion in (1, 2):
        simulate(folder / str(motion), replace(options, motion_seed=motion))
    return folder / "1", folder / "2"


def changed(by: Change) -> Callable[[Recorded], Recorded]:
    def change(item: Recorded) -> Recorded:
        if item.topic != "/joint_states":
            return item
        message = item.message
        place, effort = list(message.name).index(JOINT), message.effort.copy()
        time = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        effort[place] = by(message.position[place], message.velocity[place], effort[place], time)
        return item.changed(effort=effort)

    return change


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.change.__name__ + " " + case.unseen.__name__)
def test_the_written_model_leaves_what_the_table_says(
    case: Case, recordings: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found_only(monkeypatch)
    bag = altered(recordings[0], tmp_path / "fitted", changed(case.change))
    unseen = altered(recordings[1], tmp_path / "unseen", changed(case.unseen))
    urdf = BAGS / "arm3.urdf"
    found = geomid_ros.find_gap(bag, urdf, validate=unseen)
    assert found.verdict == case.verdict
    told = (*found.findings, *(effect for effect in found.result.ordinary if effect.joint == JOINT))
    sizes = {effect.effect: effect.parameters for effect in told}
    assert sizes.keys() >= set(case.names)
    if case.change is scaled:
        offset = sizes["effort_offset"]["offset"]
        assert offset.value == pytest.approx(3.0, abs=0.2), "of the joint, if not of the gap"
    assert tuple(entry.depends_on for entry in found.result.unexplained) == case.depends_on
    found.save(tmp_path / "found")
    checked = geomid_ros.verify(tmp_path / "found/estimate.json", unseen, urdf, require="rms<100*floor")
    assert all(outcome.passed for outcome in checked.outcomes)
    times = [checked.rms[name]["value"] / checked.rms[name]["floor"] for name in found.result.channels]
    np.testing.assert_allclose(times, found.result.gap.after, rtol=0.05)
    if not case.names:
        return
    file = EstimateFile.read(tmp_path / "found/estimate.json")
    masses = {link["name"]: link["mass"] for link in file.document["links"]}
    assert {link.name: link.mass for link in file.handover["urdf"].links} == masses, "identify absorbs a gain"
    assert found.handover is not None
    assert found.handover.corrected[JOINT] < 0.5 * found.handover.alone[JOINT], "an offset found is beside the file"
    again = geomid_ros.find_gap(bag, urdf, validate=unseen, model=tmp_path / "found/estimate.json")
    # Of a joint whose gain was found the model predicts the efforts that were divided by it.
    gains = np.ones(len(found.result.channels))
    for finding in found.findings:
        if finding.effect == "effort_gain":
            gains[found.result.channels.index(finding.joint)] = finding.parameters["gain"].value
    said, left = found.result.gap.after * found.result.floor, again.result.gap.before * again.result.floor
    np.testing.assert_allclose(left * gains, said, rtol=0.02)


def test_dry_friction_has_the_shape_that_identify_finds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rest and reversals say how sharply it changes its sign; the workflow itself uses motion alone."""
    found_only(monkeypatch)
    given = BAGS / "arm3", BAGS / "arm3.urdf"
    identified = {e.joint: e.parameters for e in geomid_ros.identify(*given).effects if e.name == "coulomb_friction"}
    named = {f.joint: f.parameters for f in geomid_ros.find_gap(*given).findings if f.effect == "coulomb_friction"}
    sharp = {joint: parameters for joint, parameters in identified.items() if "smoothing" in parameters}
    assert sharp
    for joint, parameters in sharp.items():
        assert named[joint]["smoothing"].value == parameters["smoothing"].value


@pytest.fixture(scope="module")
def identified(recordings: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of an identification from the first motion. A URDF holds no rotor inertia: its links have another."""
    folder = tmp_path_factory.mktemp("identified")
    geomid_ros.identify(recordings[0], BAGS / "arm3.urdf", validate=recordings[1]).save(folder, report=False)
    return folder


def handover(folder: Path) -> dict[str, HandoverEntry]:
    """The models that descriptions hold, by their readers."""
    return dict(EstimateFile.read(folder / "estimate.json").handover)


def masses(entry: HandoverEntry) -> dict[str, float]:
    return {link.name: link.mass for link in entry.links}


@pytest.mark.parametrize("urdf", [None, BAGS / "arm3.urdf"], ids=["identified", "raw"])
def test_what_has_not_changed_is_written_as_it_was(
    urdf: Path | None, recordings: tuple[Path, Path], identified: Path, tmp_path: Path
) -> None:
    """Whichever description is given: what the model's own file holds is in the estimate."""
    found = geomid_ros.find_gap(recordings[1], urdf, model=identified / "estimate.json")
    assert not found.result.sure
    found.save(tmp_path, report=False)
    for name in ("identified.urdf", "effects.yaml"):
        assert (tmp_path / name).read_bytes() == (identified / name).read_bytes(), name
    own, before = EstimateFile.read(tmp_path / "estimate.json"), handover(identified)
    assert masses(before["urdf"]) != {link.name: link.mass for link in own.links}, "else nothing shows"
    assert own.handover.keys() == before.keys()
    given = {(e.effect, e.joint): e.parameters for e in EstimateFile.read(identified / "estimate.json").known_effects}
    for effect in own.known_effects:
        for key, quantity in given[effect.effect, effect.joint].items():
            written = effect.parameters[key]
            assert (written.value, written.std) == pytest.approx((quantity.value, quantity.std)), "as sure as before"
    for reader, entry in own.handover.items():
        assert masses(entry) == pytest.approx(masses(before[reader]), rel=1e-12), reader
        assert entry.effects == before[reader].effects, reader
    if urdf is None:
        assert found.handover is not None
        assert found.handover.alone == found.handover.given


def test_a_change_is_added_to_what_each_file_holds(
    recordings: tuple[Path, Path], identified: Path, tmp_path: Path
) -> None:
    bag = altered(recordings[1], tmp_path / "rubbing", changed(rubbing))
    found = geomid_ros.find_gap(bag, model=identified / "estimate.json")
    (finding,) = found.result.sure
    assert (finding.effect, finding.joint) == ("viscous_friction", JOINT)
    found.save(tmp_path / "found", report=False)
    change = finding.parameters["coefficient"].value - finding.was["coefficient"]
    assert change == pytest.approx(2.0, rel=0.05)
    before, after = handover(identified), handover(tmp_path / "found")
    assert after.keys() == before.keys()
    for reader, entry in after.items():
        assert masses(entry) == pytest.approx(masses(before[reader]), rel=1e-12), reader
        then, now = (
            {(own.effect, own.joint): own.parameters for own in each.effects} for each in (before[reader], entry)
        )
        rubs = finding.effect, finding.joint
        assert now.pop(rubs)["coefficient"].value - then.pop(rubs)["coefficient"].value == pytest.approx(change)
        assert now == then, reader


def test_a_model_without_fits_for_files_is_told(
    recordings: tuple[Path, Path], identified: Path, tmp_path: Path
) -> None:
    document = json.loads((identified / "estimate.json").read_text())
    del document["handover"]
    (tmp_path / "estimate.json").write_text(json.dumps(document))
    found = geomid_ros.find_gap(recordings[1], BAGS / "arm3.urdf", model=tmp_path / "estimate.json")
    assert any("has no fits for description formats" in note for note in found.session.notes)
    found.save(tmp_path / "found", report=False)
    written = handover(tmp_path / "found")
    assert masses(written["urdf"]) == {link["name"]: pytest.approx(link["mass"]) for link in document["links"]}


def test_from_a_urdf_descriptions_are_those_that_identify_fits(recordings: tuple[Path, Path], tmp_path: Path) -> None:
    """Within the limits of each format, unless something is sure that ``identify`` cannot find."""
    given = (altered(recordings[0], tmp_path / "fitted", changed(rubbing)), BAGS / "arm3.urdf")
    found = geomid_ros.find_gap(*given, validate=recordings[1])
    assert "viscous_friction" in {finding.effect for finding in found.result.sure}
    found.save(tmp_path / "gap")
    config = {"filter.cutoff": found.result.cutoff}
    geomid_ros.identify(*given, validate=recordings[1], config=config).save(tmp_path / "identified", report=False)
    files = [EstimateFile.read(tmp_path / folder / "estimate.json").handover for folder in ("gap", "identified")]
    assert files[0].keys() == files[1].keys()
    for reader, own in files[0].items():
        for link, other in zip(own.links, files[1][reader].links, strict=True):
            assert (link.name, link.mass) == (other.name, pytest.approx(other.mass, rel=1e-3)), reader
        values = [{(e.effect, e.joint): e.values for e in entry.effects} for entry in (own, files[1][reader])]
        assert ("viscous_friction", JOINT) in values[0].keys() <= values[1].keys(), reader
        for key, found_values in values[0].items():
            assert found_values == pytest.approx(values[1][key], rel=1e-3), (reader, key)


def test_friction_that_only_a_description_has_counts_once(
    recordings: tuple[Path, Path], identified: Path, tmp_path: Path
) -> None:
    """The estimate may have another kind in its place."""
    robot = ElementTree.parse(identified / "identified.urdf")
    dynamics = robot.find(f"joint[@name='{JOINT}']/dynamics")
    assert dynamics is not None
    dynamics.set("damping", "2.0")
    document = json.loads((identified / "estimate.json").read_text())
    rest = [e for e in document["effects"] if (e["name"], e["joint"]) != ("viscous_friction", JOINT)]
    urdf_rms = []
    for name, effects in {"whole": document["effects"], "without": rest}.items():
        folder = tmp_path / name
        folder.mkdir()
        (folder / "estimate.json").write_text(json.dumps({**document, "effects": effects}))
        robot.write(folder / "identified.urdf")
        read = [(effect.effect, effect.joint) for effect in read_model(folder / "estimate.json", "urdf").effects]
        assert read.count(("viscous_friction", JOINT)) == 1
        checked = geomid_ros.verify(folder / "estimate.json", recordings[1], folder / "identified.urdf")
        urdf_rms.append(checked.rms[JOINT]["urdf"])
    assert urdf_rms[0] == pytest.approx(urdf_rms[1], rel=1e-6)
    assert urdf_rms[0] > 0.5, "it has damping, and the robot none"


def test_beside_a_simulator_of_the_users_nothing_is_written_but_findings(
    recordings: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has the rest of the robot: what ``identify`` finds is no change of it."""
    found_only(monkeypatch)

    def moved(item: Recorded) -> Recorded:
        return item.changed(position=item.message.position + 1e-9) if item.topic == "/joint_states" else item

    bag = altered(recordings[0], tmp_path / "measured", changed(rubbing))
    twin = altered(recordings[0], tmp_path / "simulated", moved)
    found = geomid_ros.find_gap(bag, BAGS / "arm3.urdf", simulated=twin, hold_out=0.3)
    assert [(finding.effect, finding.joint) for finding in found.result.sure] == [("viscous_friction", JOINT)]
    found.save(tmp_path / "found", report=False)
    effects = EstimateFile.read(tmp_path / "found/estimate.json").handover["urdf"].effects
    assert [(e.effect, e.joint) for e in effects] == [("viscous_friction", JOINT)]
