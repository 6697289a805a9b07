"""``geomid_ros.identify``: what it accepts, and that it says the same as the command."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from commands.running import WRIST, done, identify, undrawn
from files.recordings import BAGS, QUICK

import geomid_ros
from geomid_ros.exports.handover import FileTest
from geomid_ros.files.models.posterior import read_remainder
from geomid_ros.simulation.options import Hidden, SimulationOptions
from geomid_ros.simulation.recording import simulate

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
BAG, URDF = BAGS / "arm3", BAGS / "arm3.urdf"


def document(*arguments: Any, **options: Any) -> dict[str, Any]:
    """What is found, as JSON has it, without how long it took."""
    found = json.loads(json.dumps(geomid_ros.identify(*arguments, **options).document))
    return {key: value for key, value in found.items() if key != "seconds"}


def test_it_says_the_same_as_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    options = ("--hold-out", "0.2", "--effects", "effort_offset", "--links", "link3,wrist_ft", "--known", "link3=1:0.1")
    printed = json.loads(done(*identify("arm3", *WRIST, *options, "--json", "--out", tmp_path), status=4))
    own = document(
        [BAG],
        URDF,
        wrench=WRIST[1],
        hold_out=0.2,
        effects="effort_offset",
        links=["link3", "wrist_ft"],
        known="link3=1:0.1",
    )
    assert own == {key: value for key, value in printed.items() if key not in ("seconds", "origin")}


@pytest.mark.usefixtures("found_only")
def test_descriptions_as_a_path_in_a_text_and_as_a_text() -> None:
    assert document(str(BAG), str(URDF), effects=[]) == document(BAG, URDF.read_text(), effects=[])


@pytest.mark.usefixtures("without_pictures")
def test_without_held_out_data_the_fitted_ones_are_judged_and_saved_though_the_bag_is_gone(tmp_path: Path) -> None:
    bag = shutil.copytree(BAG, tmp_path / "bag")
    found = geomid_ros.identify(bag, URDF, candidates=[], hold_out=0.0)
    assert list(found.held_out) == []
    assert found.document["rms"]["held_out"] is None
    assert list(found.rms.values()) == found.estimate.rms.tolist()
    assert list(found.rms_nominal.values()) == found.estimate.rms_nominal.tolist()
    shutil.rmtree(bag)
    files = {file.name for file in found.save(tmp_path / "out")}
    assert {"estimate.json", "posterior.npz", "report.html"} <= files
    assert any("posterior.npz" in note and "bag" in note for note in found.session.notes)
    assert read_remainder(tmp_path / "out" / "posterior.npz") is None


@pytest.mark.parametrize("hold_out", [0.3, 0.0])
def test_a_urdf_is_judged_with_its_own_friction(hold_out: float, tmp_path: Path) -> None:
    """Given as the URDF, an identified file has the error that it had alone, here and in the bounds of ``verify``."""
    (tmp_path / "given.urdf").write_text(geomid_ros.identify(BAG, URDF, candidates=[], hold_out=hold_out).urdf())
    found = geomid_ros.identify(BAG, tmp_path / "given.urdf", candidates=[], hold_out=hold_out)
    found.save(tmp_path / "out", report=False)
    assert found.rms_nominal == pytest.approx(dict(found.handover.given))
    checked = geomid_ros.verify(
        tmp_path / "out" / "estimate.json", validate=BAG, urdf=tmp_path / "given.urdf", require="rms<=urdf"
    )
    bounds = [float(outcome.bound.split()[1]) for outcome in checked.outcomes]
    # Its delay, and the shape of its friction, are the model's: a little less than alone, a fifth of that without any.
    assert bounds == pytest.approx(list(found.rms_nominal.values()), rel=0.4)


def test_friction_by_load_is_of_the_links_that_were_found(tmp_path: Path) -> None:
    """Those of the URDF are wrong by a third; other friction is no load. A loaded model predicts what was said."""
    planted = {
        "load_friction": {"coefficient": 0.2},
        "coulomb_friction": {"level": 3.0},
        "viscous_friction": {"coefficient": 4.0},
    }
    hidden = tuple(Hidden(effect, "joint2", None, parameters) for effect, parameters in planted.items())
    options = SimulationOptions(robot="arm3", seed=6, duration=12.0, longest_step=QUICK, inertia_error=0.3, hide=hidden)
    simulate(tmp_path / "bag", options)
    found = geomid_ros.identify(tmp_path / "bag", hold_out=0.0)
    sizes = {effect.name: effect.value for effect in found.effects if effect.joint == "joint2"}
    assert sizes["load_friction"] == pytest.approx(0.2, rel=0.03)
    assert sizes["coulomb_friction"] == pytest.approx(3.0, rel=0.03)
    assert sizes["viscous_friction"] == pytest.approx(4.0, rel=0.03)
    found.save(tmp_path / "out", report=False)
    checked = geomid_ros.verify(tmp_path / "out" / "estimate.json", validate=tmp_path / "bag")
    assert {name: rms["value"] for name, rms in checked.rms.items()} == pytest.approx(found.rms, rel=0.03)


def test_what_is_loaded_again_predicts_with_the_gains_that_were_found(tmp_path: Path) -> None:
    """Of the drives, to the last digit; the description without them."""
    shutil.copytree(BAG, tmp_path / "again")
    found = geomid_ros.identify(BAG, URDF, validate=tmp_path / "again")
    assert not np.allclose(found.estimate.predictor.drive_gains, 1.0, atol=1e-4)
    found.save(tmp_path / "out", report=False)
    checked = geomid_ros.verify(tmp_path / "out" / "estimate.json", validate=BAG, urdf=URDF)
    for channel, rms in checked.rms.items():
        assert rms["value"] == pytest.approx(found.rms[channel], rel=1e-9)
        assert rms["urdf"] == pytest.approx(found.rms_nominal[channel], rel=1e-9)


def test_shapes_are_found_from_any_folder_or_missed_in_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And what the plain URDF lacks is said beside what MuJoCo's file lacks."""
    pytest.importorskip("mujoco")
    monkeypatch.setattr(FileTest, "limited", property(lambda _: ["too plain"]))
    mesh = "<visual><geometry><mesh filename='{}'/></geometry></visual></link>"
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "a&b.obj").write_text(TETRAHEDRON)
    shapes = (mesh.format("meshes/a&amp;b.obj") + mesh.format("package://none/gone.stl")).replace("</link>", "", 1)
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(URDF.read_text().replace("</link>", shapes, 1))
    found = geomid_ros.identify(BAG, urdf, reader="mujoco", candidates=[])
    assert found.verdict.warnings.count("too plain") == 2
    found.save(tmp_path / "elsewhere" / "out", report=False)
    (said,) = [note for note in found.document["notes"] if " missing, " in note]
    missing = "identified.xml: 1 shape missing, the first of link 'base_link': the mesh 'package://none/gone.stl'"
    assert said.startswith(missing)
    exported = geomid_ros.export(tmp_path / "elsewhere" / "out" / "estimate.json", "mujoco")
    for text in (found.written.files["identified.xml"], exported.text):
        (file,) = [mesh.get("file", "") for mesh in ElementTree.fromstring(text).iter("mesh")]
        assert Path(file) == tmp_path / "meshes" / "a&b.obj"
    names = [mesh.get("filename") for mesh in ElementTree.fromstring(found.urdf()).iter("mesh")]
    assert names == [file, "package://none/gone.stl"]


REFUSED: dict[str, tuple[Callable[[], object], str]] = {
    "no bag": (lambda: geomid_ros.identify([], URDF), "no bag is given"),
    "a share": (
        lambda: geomid_ros.identify(BAG, URDF, hold_out=1.5),
        r"hold_out is 1.5, expected 0 <= hold_out <= 0.9",
    ),
    "a description": (lambda: geomid_ros.identify(BAG, "<sdf/>"), "robot description: not a URDF"),
    "no xacro": (lambda: geomid_ros.find_gap(BAG, URDF, xacro_args="a:=1"), "arguments for xacro are given"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_used_is_refused(case: str) -> None:
    act, message = REFUSED[case]
    with pytest.raises(geomid_ros.InputError, match=message):
        act()


def test_a_base_that_is_not_level_is_in_the_estimate_and_in_the_file() -> None:
    """The weight that a tilt turns is that of the links that were found, not of the URDF's."""
    tilt = np.array([0.02, -0.03])
    gravity = tuple((pin.exp3(np.append(tilt, 0.0)) @ [0.0, 0.0, -9.81]).tolist())
    found = geomid_ros.identify(BAG, URDF, gravity=gravity, reader="mujoco")
    effects = {name: effect for effect in found.effects for name in effect.parameters if effect.name == "gravity_tilt"}
    for name, true in zip(("tilt_x", "tilt_y"), tilt, strict=True):
        assert abs(effects[name].value - true) < 3.0 * effects[name].std < 0.03
    assert sum(found.handover.corrected.values()) < 1.2 * sum(found.rms.values())
    model, parameters = found.session.model, found.estimate.parameters
    level = np.where([False] * 30 + [c.effect.name == "gravity_tilt" for c in model.coefficients], 0.0, parameters)
    turned = model.with_gravity(model.gravity_at(parameters))
    for samples in found.judged:
        exact, linear, without = (
            m.predict(samples, p)[1] for m, p in ((turned, level), (model, parameters), (model, level))
        )
        assert np.linalg.norm(linear - exact) < 0.03 * np.linalg.norm(exact - without)
