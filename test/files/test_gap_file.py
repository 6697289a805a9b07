"""``gap.json``: everything that was found is in it, and it is JSON for any parser."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from geomid_ros.errors import InputError
from geomid_ros.files.disk import write_json
from geomid_ros.files.models.estimate_file import EstimateFile, by_channel
from geomid_ros.files.models.gap_file import GapFile, gap_document, is_open, page_entries
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.files.models.written_model import write_model
from geomid_ros.model.effects import KnownEffect, Quantity
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot

from .gaps import FLOOR, Case, gap_result
from .recordings import BAGS

JOINTS = ("hip", "knee", "ankle")


def test_what_was_found_is_in_it(tmp_path: Path) -> None:
    result = gap_result("ambiguous", JOINTS)
    errors = {"before": {"hip": 7.5}, "after": {"hip": 1.25}}
    write_json(tmp_path / "gap.json", gap_document(result, {"windows": errors}))
    document = json.loads((tmp_path / "gap.json").read_text())
    assert (document["format"], document["verdict"], document["closed_loop"]) == (1, "named", None)
    (finding,) = document["findings"]
    assert finding["parameters"] == {"level": {"value": 0.40123, "std": 0.0049, "unit": "N m"}}
    assert finding["confidence"] == "ambiguous"
    assert finding["rivals"][0] == {"effect": "load_friction", "joint": "knee", "loss": 1.25}
    assert finding["sentence"] == result.findings[0].sentence
    assert document["floor"] == dict.fromkeys(JOINTS, FLOOR)
    for kind, values in (("before", result.gap.before), ("after", result.gap.after), ("moving", result.moving)):
        assert document["gap"][kind] == dict(zip(JOINTS, values.tolist(), strict=True))
    assert document["resimulated"] == errors


def test_what_is_not_a_number_is_null() -> None:
    """NaN is no JSON: other parsers refuse it."""
    result = gap_result("named", JOINTS)
    finding = replace(result.findings[0], parameters={"level": Quantity(0.4, np.nan, "N m")}, separability=np.nan)
    floor = np.array([np.nan, *result.floor[1:]])
    document = gap_document(
        replace(result, findings=(finding,), floor=floor), {"windows": {"before": {"hip": np.inf}, "after": {}}}
    )
    text = json.dumps(document, allow_nan=False)
    assert json.loads(text)["floor"]["hip"] is None
    assert json.loads(text)["findings"][0]["parameters"]["level"]["std"] is None
    assert json.loads(text)["resimulated"]["before"]["hip"] is None


def test_rivals_of_a_name_that_is_not_sure_are_open() -> None:
    assert [is_open(gap_result(case, JOINTS)) for case in ("ambiguous", "named", "no gap")] == [True, False, False]


@pytest.mark.parametrize("case", ["incomplete", "ambiguous", "unexplained"])
def test_it_is_read_again(case: Case) -> None:
    result = gap_result(case, JOINTS)
    document = json.loads(json.dumps(gap_document(result, {}) | page_entries(result, np.zeros_like(result.inertias))))
    sentence = "mass of link 'hand' is 0.74 ± 0.05 kg lower than in the model (1.2 kg)"
    assert [(link["confidence"], link["sentence"]) for link in document["links"]] == [("confident", sentence)] * len(
        result.links
    )
    document |= {"robot": "", "recordings": [], "judged_seconds": 1.0, "known": [], "not_simulated": ""}
    document |= {"causes": [], "warnings": [], "notes": []}
    read = GapFile.of(document, "gap.json")
    for name in ("verdict", "findings", "links", "unexplained", "ordinary", "located", "ranking"):
        assert getattr(read.result, name) == getattr(result, name)
    assert read.result.corrected_floor.tolist() == pytest.approx(result.corrected_floor.tolist())
    document["findings"] = [{"effect": "springs"}]
    with pytest.raises(InputError, match=r"^gap\.json: findings\[0\]"):
        GapFile.of(document, "gap.json")


URDF = (BAGS / "arm3.urdf").read_text(encoding="utf-8")
MODEL = MeasurementModel(Robot(URDF), ())


def friction(effect: str, value: float, unit: str) -> KnownEffect:
    return KnownEffect(effect, "joint1", "", {"coefficient": Quantity(value, 0.01, unit)})


def test_files_that_cannot_say_a_friction_have_the_other_without_it(tmp_path: Path) -> None:
    effects = [
        friction("viscous_friction", 2.0, "N m s/rad"),
        friction("quadratic_friction", -0.5, "N m s^2/rad^2"),
    ]
    inertias = dict(zip(MODEL.body_names, MODEL.nominal_inertias.reshape(-1, 10), strict=True))
    noise = {"floor": by_channel(MODEL.robot.joint_names, np.array([0.1, 0.2, np.nan])), "cutoff": 8.0}
    folded = {("joint1", "dynamics/damping"): -0.4}
    gravity = np.array([9.8, -0.2, -0.1])
    write_model(tmp_path, MODEL, URDF, inertias, effects, gravity, noise=noise, folded=folded)
    joint = ElementTree.parse(tmp_path / "identified.urdf").find("joint[@name='joint1']/dynamics")
    assert joint is not None
    assert float(joint.attrib["damping"]) == 1.6
    mjcf = ElementTree.parse(tmp_path / "identified.xml").find(".//joint[@name='joint1']")
    assert mjcf is not None
    assert float(mjcf.attrib["damping"]) == 1.6
    known = {e.effect: e.parameters["coefficient"].value for e in LoadedModel.read(f"{tmp_path}/estimate.json").effects}
    assert known == {"viscous_friction": 2.0, "quadratic_friction": -0.5}
    said = yaml.safe_load((tmp_path / "effects.yaml").read_text())["effects"]
    assert [entry.get("alone") for entry in said] == [{"coefficient": 1.6}, None]
    document = json.loads((tmp_path / "estimate.json").read_text())
    assert EstimateFile.read(tmp_path / "estimate.json").gravity.tolist() == gravity.tolist()
    assert (document["floor"], document["cutoff"]) == ({"joint1": 0.1, "joint2": 0.2, "joint3": None}, 8.0)
