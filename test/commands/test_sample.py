"""``geomid sample``: robots from a recording's posterior, for those who simulate, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yaml

from .running import geomid, refused

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 4 3\nf 1 2 4\nf 2 3 4\n"
FEW = ("-n", "12")


@pytest.fixture
def estimate(wrist: Path) -> Path:
    """The small arm with the sensor at its wrist."""
    return wrist / "estimate.json"


def robots(estimate: Path, out: Path, *more: str) -> list[dict]:
    """Drawn robots, as JSON."""
    geomid("sample", estimate, *FEW, "--for", "json", "--out", out, *more)
    found: list[dict] = json.loads((out / "robots.json").read_text())["robots"]
    return found


def test_mujoco_loads_the_robots_that_were_drawn(estimate: Path, tmp_path: Path) -> None:
    """Each with the bodies and joints that the JSON of the same seed says."""
    printed = geomid("sample", estimate, *FEW, "--for", "mujoco", "--out", tmp_path / "m")
    assert printed.exit_code == 0
    assert "ranges of ±20 %" in printed.stdout
    expected = robots(estimate, tmp_path / "j")
    files = sorted((tmp_path / "m").glob("robot_*.xml"))
    assert [file.name for file in files] == [f"robot_{number:02d}.xml" for number in range(1, 13)]
    assert f"{files[0]} to {files[-1].name}" in printed.stdout
    for file, robot in zip(files, expected, strict=True):
        model = mujoco.MjModel.from_xml_path(str(file))
        for link in robot["links"]:
            body = model.body(link["name"])
            assert body.mass[0] == pytest.approx(link["mass"], rel=1e-9)
            np.testing.assert_allclose(body.ipos, link["com"], rtol=0, atol=1e-9)
            np.testing.assert_allclose(np.sort(body.inertia), np.linalg.eigvalsh(link["inertia"]), rtol=1e-7)
        for effect in robot["effects"]:
            joint = {"viscous_friction": "damping", "coulomb_friction": "frictionloss", "rotor_inertia": "armature"}
            if effect["name"] in joint:
                said = getattr(model.joint(effect["joint"]), joint[effect["name"]])[0]
                assert said == pytest.approx(effect["value"], rel=1e-9)
    assert len({robot["links"][0]["mass"] for robot in expected}) == len(expected)


def test_the_user_s_own_mjcf_is_found_with_its_meshes_from_the_folder_of_the_robots(
    estimate: Path, tmp_path: Path
) -> None:
    own = tmp_path / "own"
    (own / "parts").mkdir(parents=True)
    (own / "parts/part.obj").write_text(TETRAHEDRON)
    text = geomid("export", estimate, "--for", "mujoco").stdout.replace(
        "<worldbody>", '<asset><mesh name="part" file="part.obj"/></asset>\n  <worldbody><!-- mine -->', 1
    )
    text = text.replace("<compiler ", '<compiler meshdir="parts" ', 1)
    (own / "robot.xml").write_text(text)
    geomid("sample", estimate, *FEW, "--for", "mujoco", "--into", own / "robot.xml", "--out", tmp_path / "out")
    for number, robot in enumerate(robots(estimate, tmp_path / "j"), 1):
        file = tmp_path / f"out/robot_{number:02d}.xml"
        model = mujoco.MjModel.from_xml_path(str(file))
        assert model.nmesh == 1
        assert "<!-- mine -->" in file.read_text()
        for link in robot["links"]:
            assert model.body(link["name"]).mass[0] == pytest.approx(link["mass"], rel=1e-9)


def test_ranges_hold_the_estimate_and_are_events_for_isaac_lab_beside_urdfs(estimate: Path, tmp_path: Path) -> None:
    geomid("sample", estimate, *FEW, "--for", "isaac", "--out", tmp_path)
    found = yaml.safe_load((tmp_path / "ranges.yaml").read_text())
    document = json.loads(estimate.read_text())
    for link in document["links"]:
        low, high = found["links"][link["name"]]["mass"]
        assert low < link["mass"] < high
        event = found["events"][f"mass_of_{link['name']}"]
        assert event["func"] == "isaaclab.envs.mdp.randomize_rigid_body_mass"
        assert event["params"]["mass_distribution_params"] == [low, high]
        shifts = found["events"][f"com_of_{link['name']}"]["params"]["com_range"]
        assert all(below < 0.0 < above for below, above in shifts.values())
    armature = found["events"]["parameters_of_joint1"]["params"]["armature_distribution_params"]
    (rotor,) = (e["range"] for e in found["effects"] if (e["effect"], e["joint"]) == ("rotor_inertia", "joint1"))
    assert armature == rotor
    urdfs = sorted(tmp_path.glob("robot_*.urdf"))
    before = [element.tag for element in ElementTree.parse(estimate.parent / "identified.urdf").iter()]
    for file, robot in zip(urdfs, robots(estimate, tmp_path / "j"), strict=True):
        model = pin.buildModelFromXML(file.read_text())
        masses = sum(link["mass"] for link in robot["links"] if link["name"] != "base_link")
        assert sum(inertia.mass for inertia in model.inertias[1:]) == pytest.approx(masses, rel=1e-6)
        assert [element.tag for element in ElementTree.parse(file).iter()] == before, "nothing else has changed"
    joints = [json.loads(file.read_text()) for file in tmp_path.glob("robot_*_isaac_joints.json")]
    drawn = [of_robot["joint1"]["armature"] for of_robot in joints]
    assert len(set(drawn)) == int(FEW[1])
    assert 0.5 * armature[0] < min(drawn) < max(drawn) < 2.0 * armature[1]


def test_ranges_are_as_wide_as_the_standard_deviations_say_and_wider_when_asked(estimate: Path, tmp_path: Path) -> None:
    """Twice as wide where the Gaussian lies inside what can exist; less than that where no body would have the mass."""
    widths = {}
    for spread in ("1", "2"):
        robots(estimate, tmp_path / spread, "--spread", spread)
        links = yaml.safe_load((tmp_path / spread / "ranges.yaml").read_text())["links"]
        widths[spread] = {name: high - low for name, (low, high) in ((n, own["mass"]) for n, own in links.items())}
    inside = {}
    for link in json.loads(estimate.read_text())["links"]:
        name, std = link["name"], link["std"]["mass"]
        assert widths["1"][name] == pytest.approx(2.0 * 1.96 * std, rel=0.15)
        assert widths["1"][name] < widths["2"][name] < 2.3 * widths["1"][name]
        inside[name] = 2.0 * 1.96 * std < 0.4 * link["mass"]
        if inside[name]:
            assert widths["2"][name] == pytest.approx(2.0 * widths["1"][name], rel=0.15)
    assert set(inside.values()) == {False, True}


def test_what_is_refused(estimate: Path, tmp_path: Path) -> None:
    alone = tmp_path / "alone"
    alone.mkdir()
    for name in ("estimate.json", "identified.urdf"):
        (alone / name).write_text((estimate.parent / name).read_text())
    draw = ("--for", "mujoco", "--out", tmp_path / "out")
    assert "posterior.npz (the uncertainty of the estimate) is missing in the same folder" in refused(
        "sample", alone / "estimate.json", *draw
    )
    assert "not an estimate.json" in refused("sample", alone / "identified.urdf", *draw)
    (alone / "posterior.npz").write_bytes((estimate.parent / "posterior.npz").read_bytes()[:-100])
    assert "cannot be read" in refused("sample", alone / "estimate.json", *draw)
    (alone / "posterior.npz").write_bytes((estimate.parent / "posterior.npz").read_bytes())
    document = json.loads(estimate.read_text())
    document["links"][-1]["com"][0] += 1e-4
    (alone / "estimate.json").write_text(json.dumps(document))
    assert "belongs to another estimate than" in refused("sample", alone / "estimate.json", *draw)
    assert "into is a file of MuJoCo's" in refused("sample", estimate, "--for", "isaac", "--into", "robot.xml")
    assert "0.0<x<=3.0" in refused("sample", estimate, *draw, "--spread", "4")
    assert not (tmp_path / "out").exists()
