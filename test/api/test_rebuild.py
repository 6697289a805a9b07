"""A result's page and tables written again from its files alone: the same, but for what needs the recordings."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from commands.running import done, refused
from files.recordings import BAGS
from report.pages import Page

import geomid_ros
from geomid_ros.checks.causes import Cause, RecordingFault
from geomid_ros.files.models.estimate_file import causes_entry
from geomid_ros.files.models.gap_file import CauseEntry
from geomid_ros.files.schema import from_document

BAG, URDF = BAGS / "arm3", BAGS / "arm3.urdf"
MISSING = "Time series need the recordings; this page was made from the files of the result alone."
FILES = {"identify": "estimate.json", "gap": "gap.json"}
KINDS = list(FILES)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """What 'geomid identify' writes, with effects of several parameters, a weighed mass and options in it; and what
    'geomid gap' writes."""
    options = ("--wrench", "/wrench:wrist_ft:mounted", "--cutoff", "6", "--known", "link2=1.2:0.05")
    folders = {kind: tmp_path_factory.mktemp(kind) for kind in KINDS}
    for kind, out in folders.items():
        done(kind, BAG, "--urdf", URDF, *(options if kind == "identify" else ()), "--out", out)
    return folders


OF_SAMPLES = ("Measured and predicted", "Held-out data", "Residual, and what the findings explain", "Residual")


def lines(path: Path) -> list[str]:
    """What is written on a page, without sections and pictures of samples over time, and without the hour."""
    parts = path.read_text(encoding="utf-8").partition("<body>")[2].partition("<script>")[0].split("<section>")
    kept = [part for part in parts if not any(f"<h2>{heading}</h2>" in part for heading in OF_SAMPLES)]
    written = [line.strip() for part in kept for line in part.splitlines()]
    return [line for line in written if line and "<img" not in line and "<dt>date</dt>" not in line]


@pytest.mark.parametrize("kind", KINDS)
def test_all_but_time_series_is_as_it_was(kind: str, results: dict[str, Path], tmp_path: Path) -> None:
    """The page needs no other file."""
    folder = results[kind]
    (tmp_path / "files").mkdir()
    shutil.copy(folder / FILES[kind], tmp_path / "files")
    printed = done("report", tmp_path / "files")
    assert lines(tmp_path / "files" / "report.html") == lines(folder / "report.html")
    again = (tmp_path / "files" / "report.html").read_text(encoding="utf-8")
    assert MISSING in again
    assert MISSING not in (folder / "report.html").read_text(encoding="utf-8")
    Page(again)
    for name in ("links.csv", "effects.csv", "channels.csv") if kind == "identify" else ("findings.csv",):
        assert (tmp_path / "files" / name).read_bytes() == (folder / name).read_bytes()
        assert str(tmp_path / "files" / name) in printed


def test_what_is_no_result_is_refused(tmp_path: Path) -> None:
    assert "no result is in this folder" in refused("report", tmp_path)
    assert "no result is in this folder" in refused("report", tmp_path / "nowhere")


NEEDED = {
    "identify": ("channels", "origin", "urdf_masses", "telling", "robot", "steps", "messages", "known"),
    "gap": ("units", "located", "ranking", "bodies", "known", "robot", "judged_seconds", "links"),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_result_that_lacks_something_is_refused(kind: str, results: dict[str, Path], tmp_path: Path) -> None:
    shutil.copytree(results[kind], tmp_path / "old")
    file = tmp_path / "old" / FILES[kind]
    document = json.loads(file.read_text())
    for key in NEEDED[kind]:
        file.write_text(json.dumps({name: value for name, value in document.items() if name != key}))
        message = refused("report", tmp_path / "old", "--out", tmp_path / "new")
        assert f"{file}: lacks what its page needs ({key} is not given)" in message
        assert not (tmp_path / "new").exists()


def refusal(folder: Path, out: Path) -> str:
    """Why no page can be written; empty if it can."""
    try:
        geomid_ros.rebuild_report(folder, out=out)
    except geomid_ros.InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("kind", "garbage"), [("identify", [[]]), ("gap", [[]]), ("gap", 5)])
def test_garbage_is_refused_or_shown_and_never_ends_in_a_traceback(
    kind: str, garbage: object, results: dict[str, Path], tmp_path: Path
) -> None:
    shutil.copytree(results[kind], tmp_path / "files")
    file = tmp_path / "files" / FILES[kind]
    document = json.loads(file.read_text())
    for key in document:
        file.write_text(json.dumps(document | {key: garbage}))
        said = refusal(tmp_path / "files", tmp_path / key)
        assert str(tmp_path / "files") in said or (tmp_path / key / "report.html").is_file()
        assert not said or not (tmp_path / key).exists()


def test_doubts_are_said_again_as_they_were() -> None:
    """Sure, suspected, and with rivals."""
    signs, units = Cause(kind="signs", sentence="signs are reversed"), Cause(kind="units", sentence="in mN m")
    findings = [
        RecordingFault(cause=signs),
        RecordingFault(cause=units, sure=False),
        RecordingFault(cause=signs, rivals=(units,)),
    ]
    written = json.loads(json.dumps(causes_entry(findings)))
    assert [from_document(CauseEntry, own, "gap.json:").doubt for own in written] == [own.sentence for own in findings]
