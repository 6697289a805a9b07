"""Two results of one robot: equal halves are alike, what was planted is named, another robot is refused."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from commands.running import done, found_only, refused
from files.recordings import BAGS, recorded, write_bag
from report.pages import Page

import geomid_ros
from geomid_ros.files.models.urdf import with_inertials
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects.effect import FRICTION_DRIFT

ARM7, LINK = BAGS / "arm7.urdf", "link6"


def heavier(urdf: Path, link: str, factor: float) -> str:
    """A description in which a link has more mass, where it was."""

    def more(match: re.Match[str]) -> str:
        return re.sub(r'(<mass value=")([^"]+)', lambda mass: f"{mass[1]}{factor * float(mass[2])!r}", match[0])

    return re.sub(rf'<link name="{link}">.*?</link>', more, urdf.read_text(), flags=re.DOTALL)


def mass_of(urdf: Path, link: str) -> float:
    found = re.search(rf'<link name="{link}">.*?<mass value="([^"]+)"', urdf.read_text(), re.DOTALL)
    assert found
    return float(found[1])


def identified(folder: Path, bag: Path) -> Path:
    """The estimate.json of a recording."""
    with pytest.MonkeyPatch.context() as patch:
        found_only(patch)
        geomid_ros.identify(bag, ARM7, candidates=[]).save(folder)
    return folder / "estimate.json"


@pytest.fixture(scope="module")
def halves(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Estimates of both halves of the shipped recording."""
    folder, messages = tmp_path_factory.mktemp("halves"), recorded(BAGS / "arm7")
    middle = (messages[0].time + messages[-1].time) // 2
    parts = [[m for m in messages if m.time < middle], [m for m in messages if m.time >= middle]]
    first, second = (
        identified(folder / f"result{k}", write_bag(folder / f"half{k}", part)) for k, part in enumerate(parts)
    )
    return first, second


def rigid_efforts(urdf: str, states: list[Any]) -> np.ndarray:
    """Efforts of rigid bodies in the motion of joint messages, in the order of their names."""
    model = pin.buildModelFromXML(urdf)
    data, order = model.createData(), [states[0].name.index(name) for name in model.names[1:]]
    stamps = np.array([state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec for state in states])
    position, velocity = (np.array([getattr(each, key)[order] for each in states]) for key in ("position", "velocity"))
    motion = position, velocity, np.gradient(velocity, stamps - stamps[0], axis=0)
    return np.array([pin.rnea(model, data, *row) for row in zip(*motion, strict=True)])[:, np.argsort(order)]


@pytest.fixture(scope="module")
def planted(halves: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Estimates of a robot, and of the same with a link that weighs a fifth more in the recording's other half."""
    folder, messages = tmp_path_factory.mktemp("planted"), recorded(halves[1].parent.with_name("half1"))
    states = [item.message for item in messages if item.topic == "/joint_states"]
    more = iter(rigid_efforts(heavier(ARM7, LINK, 1.2), states) - rigid_efforts(ARM7.read_text(), states))
    loaded = [m.changed(effort=m.message.effort + next(more)) if m.topic == "/joint_states" else m for m in messages]
    return halves[0], identified(folder / "result", write_bag(folder / "bag", loaded))


def test_halves_of_a_recording_are_alike(halves: tuple[Path, Path], tmp_path: Path) -> None:
    found = geomid_ros.compare(*halves)
    assert not found.differing
    assert not found.compared.changed
    assert not found.compared.not_compared
    assert found.status == 0
    printed = done("compare", *halves, "--out", tmp_path)
    assert "Nothing differs beyond the joint 95 % intervals." in printed
    held_out = json.loads(halves[0].read_text())["rms"]["held_out"]
    assert {error.name: error.first for error in found.errors} == held_out
    assert not any(note.startswith("only") for note in found.notes)


def test_what_only_one_result_has_is_said(halves: tuple[Path, Path], tmp_path: Path) -> None:
    """Effects, and a link of other parts, which is left out."""
    first, document = halves[0], json.loads(halves[1].read_text())
    effects = [effect for effect in document["effects"] if effect["name"] != "rotor_inertia"][1:]
    links = document["links"]
    links[-1] |= {"merged": ["another_tool"], "mass": 10.0 * links[-1]["mass"]}
    other = changed_copy(halves[1], tmp_path / "other", effects=effects, links=links)
    found = geomid_ros.compare(first, other)
    only = f"only {first} has rotor inertia at 7 places, viscous friction of joint1"
    assert only in found.notes
    assert found.compared.not_compared == ("link7",)
    assert "link7" not in {each.place for each in found.compared.differences}
    printed = done("compare", first, other, "--out", tmp_path)
    assert f"Note: {only}"[:40] in printed
    assert "Not compared: link7" in printed


def test_a_mass_that_was_changed_is_named(planted: tuple[Path, Path], tmp_path: Path) -> None:
    """That link, none other, and by as much as it was; on the page, too."""
    found = geomid_ros.compare(*planted)
    (changed,) = found.compared.changed
    assert changed.link == LINK
    assert abs(changed.mass.value - 0.2 * mass_of(ARM7, LINK)) < 4.0 * changed.mass.std
    assert changed.sentence in repr(found)
    page = Page(found.report(tmp_path / "compare.html").read_text(encoding="utf-8"))
    assert f"{changed.mass.value:+.3g} ± {1.96 * changed.mass.std:.2g} kg" in page.text
    assert all(str(path) in page.text for path in planted)
    assert f"All {len(found.compared.differences)} numbers" in page.text
    assert not {"script", "iframe", "link"} & {tag for tag, _ in page.elements}
    back = geomid_ros.compare(*reversed(planted))
    assert back.compared.changed[0].link == LINK
    assert back.compared.changed[0].mass.value < 0.0


def urdf_of(estimate: Path, path: Path) -> Path:
    """The robot's description with an estimate's inertias; links that are counted in weigh nothing."""
    links = json.loads(estimate.read_text())["links"]
    inertias = {
        link["name"]: pseudo_inertia.assemble(*(np.array(link[key]) for key in ("mass", "com", "inertia")))
        for link in links
    }
    merged = [name for link in links for name in link["merged"]]
    path.write_text(with_inertials(ARM7.read_text(), inertias, merged))
    return path


def test_a_result_is_as_a_urdf_with_its_inertias_but_for_a_number_that_was_changed(
    halves: tuple[Path, Path], tmp_path: Path
) -> None:
    """Its standard deviation is five percent."""
    own = urdf_of(halves[0], tmp_path / "own.urdf")
    found = geomid_ros.compare(halves[0], own)
    assert not found.differing
    links = [each for each in found.compared.differences if not each.effect]
    assert len(links) == 70
    assert all(each.first and abs(each.value) <= 1e-6 * max(each.first.std, abs(each.first.value)) for each in links)
    (tmp_path / "other.urdf").write_text(heavier(own, "link7", 1.5))
    found = geomid_ros.compare(halves[0], tmp_path / "other.urdf")
    assert [(each.place, each.parameter) for each in found.differing] == [("link7", "mass")]
    (tmp_path / "flat.urdf").write_text(re.sub(r' (i[xyz]{2})="[^"]*"', r' \1="0"', own.read_text()))
    found = geomid_ros.compare(halves[0], tmp_path / "flat.urdf")
    assert any("not physically consistent, moments are raised: base_link, link1, " in note for note in found.notes)
    assert not any(each.parameter == "mass" for each in found.differing)


def test_the_error_of_the_urdf_that_was_identified_from_is_stated(halves: tuple[Path, Path], tmp_path: Path) -> None:
    channels = json.loads(halves[0].read_text())["channels"]
    found = geomid_ros.compare(ARM7, halves[0])
    assert {e.name: (e.first, e.second) for e in found.errors} == {
        row["channel"]: (row["urdf"], row["identified"]) for row in channels
    }
    (tmp_path / "other.urdf").write_text(heavier(ARM7, LINK, 1.5))
    assert all(np.isnan(e.first) for e in geomid_ros.compare(tmp_path / "other.urdf", halves[0]).errors)


def test_both_predict_a_recording(halves: tuple[Path, Path]) -> None:
    """As 'verify' does: a result by its model, a URDF without friction by its inertias alone. The identified URDF has
    friction, but lacks offsets and rotor inertias: worse than the estimate, better than no friction."""
    bag = BAGS / "arm7"
    found, own = (geomid_ros.compare(halves[0], u, bag=bag) for u in (ARM7, halves[0].with_name("identified.urdf")))
    verified = geomid_ros.verify(halves[0], bag, ARM7).rms
    assert {e.name: e.first for e in found.errors} == pytest.approx({name: v["value"] for name, v in verified.items()})
    assert {e.name: e.second for e in found.errors} == pytest.approx({name: v["urdf"] for name, v in verified.items()})
    assert str(bag) in found.judged_on
    for bare, error in zip(found.errors, own.errors, strict=True):
        assert error.first < error.second < bare.second, error.name


def changed_copy(estimate: Path, folder: Path, **entries: Any) -> Path:
    """An estimate that says something else."""
    shutil.copytree(estimate.parent, folder)
    document = json.loads(estimate.read_text()) | entries
    (folder / "estimate.json").write_text(json.dumps(document))
    return folder / "estimate.json"


def test_another_robot_is_refused_by_name(halves: tuple[Path, Path], tmp_path: Path) -> None:
    arm3 = BAGS / "arm3.urdf"
    message = refused("compare", halves[0], arm3, "--out", tmp_path)
    assert f"{arm3}: a model of another robot than {halves[0]}. Links of {arm3}: " in message
    links = json.loads(halves[1].read_text())["links"]
    links[-1]["merged"] = ["another_tool"]
    other = changed_copy(halves[1], tmp_path / "arm3", robot="arm3", links=links)
    message = refused("compare", halves[0], other, "--out", tmp_path)
    assert re.search(r"\('arm3'\): a model of another robot than \S+ \('arm7'\)", message), message


def test_what_is_no_result_is_refused(halves: tuple[Path, Path], tmp_path: Path) -> None:
    assert "neither is an estimate.json" in refused("compare", ARM7, ARM7, "--out", tmp_path)
    (tmp_path / "empty.json").write_text("{}")
    assert "not a model as geomid writes it" in refused(
        "compare", halves[0], tmp_path / "empty.json", "--out", tmp_path
    )
    links = json.loads(halves[0].read_text())["links"]
    links[0]["std"] = {"mass": "much"}
    wrong = changed_copy(halves[0], tmp_path / "wrong", links=links)
    assert "links[0].std.com is not given" in refused("compare", halves[0], wrong, "--out", tmp_path)
    bare = ARM7.read_text()
    for link in ("link7", "flange", "tool"):  # neither at the link nor at those that are fixed to it
        bare = re.sub(rf'(<link name="{link}">.*?)<inertial>.*?</inertial>', r"\1", bare, count=1, flags=re.DOTALL)
    (tmp_path / "bare.urdf").write_text(bare)
    message = refused("compare", halves[0], tmp_path / "bare.urdf", "--out", tmp_path)
    assert "link 'link7' has no <inertial>" in message


def test_friction_that_drifted_differs(halves: tuple[Path, Path], tmp_path: Path) -> None:
    """By no more than its own standard deviation, which holds the drift to any motion."""
    both = []
    for number, factor in enumerate((1.0, 1.2)):
        effects = json.loads(halves[0].read_text())["effects"]
        level = next(each for each in effects if each["name"] == "coulomb_friction" and each["joint"] == "joint2")
        level["value"] *= factor
        level["std"] = level["value"] * float(np.hypot(0.01, FRICTION_DRIFT))
        both.append(changed_copy(halves[0], tmp_path / str(number), effects=effects))
    found = geomid_ros.compare(*both)
    assert [(each.place, each.parameter) for each in found.differing] == [("joint2", "level")]


def test_what_counts_as_exact_or_was_fitted_is_said(halves: tuple[Path, Path], tmp_path: Path) -> None:
    """A file without standard deviations, as of 'geomid gap', and one that held nothing out."""
    document = json.loads(halves[1].read_text())
    links = [{key: value for key, value in link.items() if key != "std"} for link in document["links"]]
    rms = document["rms"] | {"held_out": None}
    other = changed_copy(halves[1], tmp_path / "other", links=links, rms=rms)
    found = geomid_ros.compare(halves[0], other)
    assert found.notes == [
        f"{other} has no standard deviations; its links are treated as exact",
        f"{other} has no held-out data; its errors are training errors",
    ]
    assert {error.name: error.second for error in found.errors} == rms["train"]
    (mass,) = (each for each in found.compared.differences if (each.place, each.parameter) == ("link7", "mass"))
    both = geomid_ros.compare(*halves).compared.differences
    (known,) = (each for each in both if (each.place, each.parameter) == ("link7", "mass"))
    assert 0.0 < mass.half_width < known.half_width
