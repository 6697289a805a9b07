"""``gap.json``: everything that was found is in it, and it is JSON for any parser."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geomid_ros.files.disk import write_json
from geomid_ros.files.models.gap_file import GapFile, gap_document, is_open, page_entries
from geomid_ros.files.models.sidecar import check_effect
from geomid_ros.files.schema import structured
from geomid_ros.model.effects import KnownEffect, Quantity

from .gaps import FLOOR, Case, gap_result

JOINTS = ("hip", "knee", "ankle")
KEYS = {
    *("format", "verdict", "findings", "links", "ordinary", "unexplained", "gap", "floor", "resimulated", "closed_loop")
}


def test_what_was_found_is_in_it(tmp_path: Path) -> None:
    result = gap_result("ambiguous", JOINTS)
    errors = {"before": {"hip": 7.5}, "after": {"hip": 1.25}}
    write_json(tmp_path / "gap.json", gap_document(result, {"windows": errors}))
    document = json.loads((tmp_path / "gap.json").read_text())
    assert document.keys() == KEYS
    assert document["verdict"] == "named"
    (finding,) = document["findings"]
    assert (finding["effect"], finding["joint"], finding["link"]) == ("coulomb_friction", "knee", "")
    assert finding["parameters"] == {"level": {"value": 0.40123, "std": 0.0049, "unit": "N m"}}
    assert finding["confidence"] == "ambiguous"
    assert finding["rivals"][0] == {"effect": "load_friction", "joint": "knee", "loss": 1.25}
    assert (finding["separability"], finding["loss"], finding["share"]) == (0.97, 812.0, 0.93)
    assert finding["sentence"] == result.findings[0].sentence
    assert finding["settled_by"] == result.findings[0].settled_by
    assert document["floor"] == dict.fromkeys(JOINTS, FLOOR)
    assert document["gap"]["after"] == dict(zip(JOINTS, result.gap.after.tolist(), strict=True))
    assert document["gap"]["before"]["knee"] > 1.5 * document["gap"]["inertias_only"]["ankle"]
    assert document["resimulated"] == errors
    assert document["closed_loop"] is None
    assert document["gap"]["moving"] == dict(zip(JOINTS, result.moving.tolist(), strict=True))


def test_links_that_have_changed_are_in_it() -> None:
    (change,) = gap_document(gap_result("incomplete", JOINTS), {})["links"]
    assert change == {
        "link": "hand",
        "joint": "knee",
        "mass": {"value": -0.74, "std": 0.05, "unit": "kg"},
        "was": 1.2,
        "moment": {},
        "loss": 310.0,
        "probability": 0.99,
        "confidence": "confident",
        "sentence": "link 'hand' weighs 0.74 ± 0.098 kg less than the 1.2 kg of the model",
    }


def test_what_is_not_explained_is_in_it() -> None:
    document = gap_document(gap_result("unexplained", JOINTS), {})
    assert document["verdict"] == "unexplained"
    assert document["findings"] == []
    assert document["unexplained"] == [{"joint": "knee", "depends_on": "hip", "gap": 4.2}]
    assert document["resimulated"] is None


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


@pytest.mark.parametrize("case", ["named", "incomplete"])
def test_a_finding_can_be_read_as_an_effect(case: str) -> None:
    result = gap_result(case, JOINTS)  # type: ignore[arg-type]
    (entry,) = gap_document(result, {})["findings"]
    effect = check_effect(structured(KnownEffect, entry, "gap.json"), "gap.json")
    assert (effect.effect, effect.joint) == ("coulomb_friction", "knee")
    assert effect.parameters == result.findings[0].parameters


@pytest.mark.parametrize(("case", "answer"), [("ambiguous", True), ("named", False), ("no gap", False)])
def test_rivals_of_a_name_that_is_not_sure_are_open(case: Case, answer: bool) -> None:
    assert is_open(gap_result(case, ("shoulder", "elbow"))) is answer


def test_it_is_read_again() -> None:
    result = gap_result("incomplete", JOINTS)
    document = json.loads(json.dumps(gap_document(result, {}) | page_entries(result, np.zeros_like(result.inertias))))
    document |= {"robot": "", "recordings": [], "judged_seconds": 1.0, "known": [], "not_simulated": ""}
    document |= {"causes": [], "warnings": [], "notes": []}
    read = GapFile.of(document, "gap.json")
    assert (read.findings, read.links, read.result.verdict) == (result.findings, result.links, result.verdict)
    assert read.result.corrected_floor.tolist() == pytest.approx(result.corrected_floor.tolist())
