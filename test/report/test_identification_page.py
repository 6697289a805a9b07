"""``report.html`` of an identification: what was planted is on it, whole, self-contained, escaped and small."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from files.estimates import estimate_of, link_estimate

from geomid_ros.estimation.estimate import QUANTITIES, EffectEstimate
from geomid_ros.estimation.suggested_motions import FAST, POSES
from geomid_ros.files.models.estimate_file import EstimateFile, RowsEntry, account_entry, estimate_document
from geomid_ros.model.effects import Quantity
from geomid_ros.report.result_pages import write_identification_page
from geomid_ros.report.series import Series
from geomid_ros.signals.ledger import Account

from .pages import EVIL, Page, lines_of_script

MOST_BYTES = 3_000_000
ORIGIN = {
    "version": "9.8.7",
    "command": "geomid identify monday --urdf arm.urdf",
    "date": "2031-02-03 04:05:06 UTC",
    "files": [["/data/monday", "recording, fitted"]],
    "configuration": {"filter.cutoff": 7.5},
}
SECTIONS = [
    "Masses",
    "Fit of every channel",
    "Measured and predicted",
    "Effects",
    "Not individually identifiable",
    "Rejected data",
    "Provenance",
]


def channel(name: str, samples: int = 500, error: float = 0.1) -> Series:
    """The URDF is off by 1, the identified model by ``error``."""
    times = 0.01 * np.arange(samples)
    truth = 3.0 * np.sin(times)
    return Series(name, "N m", times, truth, truth + 1.0, truth + error)


def page_of(*names: str, samples: int = 500, word: str = "usable") -> tuple[EstimateFile, list[Series]]:
    """A page whose links and channels have these names."""
    links = [link_estimate(f"link {name}", seed=k) for k, name in enumerate(names)]
    heavier = 4.321 / links[0].mass * links[0].parameters
    links[0] = replace(links[0], parameters=heavier, std=10.0 * links[0].std, cannot_tell=QUANTITIES[1:])
    quantity = Quantity(0.75, 0.01, "N m")
    friction = EffectEstimate(name="coulomb_friction", joint=names[0], parameters={"level": quantity}, from_data=0.25)
    estimate = estimate_of(*links, effects=(friction,))
    document = estimate_document(estimate, {"standing": 11}, np.zeros(2)) | {
        "robot": names[-1],
        "verdict": {"result": word, "reasons": [] if word == "usable" else [f"signs of {names[0]} are reversed"]},
        "warnings": [f"a warning of {names[0]}"],
        "notes": [f"a note of {names[0]}"],
        "urdf_masses": {link.name: 5.5 for link in links},
        "channels": [
            {"channel": name, "unit": "N m", "urdf": 1.0, "identified": 0.1, "file": 0.5, "file_with_offsets": 0.25}
            for name in names
        ],
        "handover": {
            "urdf": {
                "links": [],
                "effects": [],
                "file": "identified.urdf",
                "alone": dict.fromkeys(names, 0.5),
                "corrected": dict.fromkeys(names, 0.25),
            }
        },
        "telling": {link.name: {POSES: ["com x"], FAST: ["Ixx"], "": ["Ixy"]} for link in links},
        "messages": {
            f"/{names[0]}": account_entry(Account(90, Counter({f"glitch of {names[0]}": 7}), Counter(), Counter(), 3))
        },
        "origin": ORIGIN,
    }
    file = EstimateFile.of(document, "estimate.json")
    return file, [channel(name, samples) for name in names]


def written(page: tuple[EstimateFile, list[Series]], folder: Path) -> tuple[Page, str]:
    write_identification_page(folder / "report.html", *page)
    text = (folder / "report.html").read_text(encoding="utf-8")
    return Page(text), text


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Page:
    return written(page_of("joint1", "joint2", "arm"), tmp_path_factory.mktemp("page"))[0]


def test_what_was_planted_is_on_it_in_order(plain: Page) -> None:
    """Masses, intervals, effects, what would tell what was not told, messages, and where the page is from."""
    sections = ("usable Predicts efforts", "a warning", *(f" {section} " for section in SECTIONS))
    places = [plain.text.index(text) for text in sections]
    assert places == sorted(places)
    motions = f"com x: {POSES} Ixx: {FAST} Ixy: none of the simulated motions"
    slow = "slow motion of this joint, back and forth at several constant speeds"
    for planted in (
        *("5.500", "4.32 \u00b1 0.10 kg", "4.129 to 4.522", "50 %"),
        *("0.750 \u00b1 0.010 N m", "0.730 to 0.770", "25 %"),
        *("/joint1", "90", "100", "7: glitch of joint1", "11 (standing)"),
        *(ORIGIN["version"], ORIGIN["command"], ORIGIN["date"], "/data/monday", "filter.cutoff", "7.5"),
        *("a warning of joint1", "a note of joint1"),
        *(f"link joint1 centre of mass, inertia {motions}", f"Coulomb friction at joint1 {slow}"),
    ):
        assert planted in plain.text, planted


def test_what_it_is_good_for(plain: Page, tmp_path: Path) -> None:
    assert "10 to 10 % of the URDF's errors remain, in identified.urdf alone 50 to 50 %" in plain.text
    assert "Identified from the data (95 % interval within ±20 %): mass of link joint1, link joint2" in plain.text
    assert "first moment of link joint1 (x, y)" in plain.text
    assert "inertia of" not in plain.text
    assert "identified only in combination" in plain.text
    doubtful, _ = written(page_of("joint1", word="doubtful"), tmp_path)
    assert "doubtful signs of joint1 are reversed Do not use this result" in doubtful.text
    assert "Predicts efforts" not in doubtful.text


def test_marks_of_masses_are_to_scale(plain: Page) -> None:
    """The mass of the first link is to that of the URDF as where their marks are."""
    left = {"found": [], "urdf": []}  # type: dict[str, list[float]]
    for _, attributes in plain.elements:
        if attributes.get("class") in left and "left" in (attributes.get("style") or ""):
            found = re.search(r"left: ([\d.]+)%", attributes["style"] or "")
            assert found
            left[str(attributes["class"])].append(float(found[1]))
    assert left["found"][0] / left["urdf"][0] == pytest.approx(4.321 / 5.5, abs=1e-3)


def test_lines_are_where_they_were_measured(plain: Page) -> None:
    """The paths of a channel, read back, are its values."""
    figure = next(attributes for tag, attributes in plain.elements if tag == "figure")
    paths = [attributes for tag, attributes in plain.elements if tag == "path"][:3]
    low, high, end = (float(figure[key] or "nan") for key in ("data-low", "data-high", "data-end"))
    series = channel("joint1")
    for path, values in zip(paths, (series.measured, series.nominal, series.predicted), strict=True):
        x, y = np.array((path["d"] or "").removeprefix("M").split(), dtype=float).reshape(-1, 2).T
        times, heights = end * x / 20_000, high - (high - low) * y / 4_000
        np.testing.assert_allclose(heights, np.interp(times, series.times, values), atol=0.02)


def test_it_is_alone_and_names_from_outside_are_only_text(plain: Page, tmp_path: Path) -> None:
    page, _ = written(page_of(*EVIL), tmp_path)
    for each in (plain, page):
        each.is_alone()
        each.can_be_read_without_seeing_it()
        assert not any(tag == "img" for tag, _ in each.elements)
        pictures = [attributes for tag, attributes in each.elements if tag == "svg"]
        assert len(pictures) == 3
        assert all(attributes.get("aria-label") and attributes.get("role") == "img" for attributes in pictures)
    for name in EVIL:
        assert page.text.count(" ".join(name.split())) >= 3, name


@pytest.mark.parametrize(("channels", "samples"), [(6, 50_000), (120, 3_000)])
def test_the_page_is_small_however_long_the_recording(channels: int, samples: int, tmp_path: Path) -> None:
    file, _ = page_of("joint", "arm")
    noise = np.random.default_rng(0).normal(size=samples)
    long = [channel(f"joint{k}", samples) for k in range(channels)]
    noisy = [
        replace(each, **{name: getattr(each, name) + noise for name in ("measured", "predicted")}) for each in long
    ]
    write_identification_page(tmp_path / "report.html", file, noisy)
    assert 100_000 < (tmp_path / "report.html").stat().st_size < MOST_BYTES


def test_no_channel_and_no_effect_is_a_page_too(tmp_path: Path) -> None:
    file, _ = page_of("joint1")
    empty = replace(file, effects=(), document={"effects": []}, messages={}, rows=RowsEntry())
    assert "No effects were identified." in written((empty, []), tmp_path)[0].text


def test_the_script_reads_values_and_zooms(tmp_path: Path) -> None:
    """On a page of one panel, whose line falls from 2 to -2 in 10 s."""
    printed = lines_of_script("traces.js", STAGE, tmp_path)
    assert printed == ["2.50 s: measured 1.000 N m", "5000 0 10000 4000", "2.500 5.000 7.500", "0 0 20000 4000"]


STAGE = """
const told = {};
const element = (extra) => Object.assign({ style: {}, hidden: true, textContent: "", attributes: {},
  addEventListener(name, call) { (told[extra.id] ??= {})[name] = call; },
  setAttribute(name, value) { this.attributes[name] = value; },
  getAttribute(name) { return this.attributes[name]; } }, extra);
const path = element({ id: "path", attributes: { d: "M0 0 20000 4000" }, dataset: { name: "measured" } });
const svg = element({ id: "svg", querySelectorAll: () => [path] });
const area = element({ id: "area", getBoundingClientRect: () => ({ left: 100, width: 400 }), setPointerCapture() {} });
const readout = element({ id: "output" }), cursor = element({ id: "cursor" }), back = element({ id: "back" });
const labels = [0, 1, 2].map((k) => element({ id: `label${k}` }));
const parts = { svg, ".area": area, output: readout, ".cursor": cursor };
const figure = { dataset: { unit: "N m", low: "-2", high: "2", end: "10" },
  querySelector: (selector) => parts[selector], querySelectorAll: () => labels };
globalThis.document = { querySelectorAll: () => [{ querySelectorAll: () => [figure], querySelector: () => back }] };
{ SCRIPT }
told.area.pointermove({ clientX: 200 });
console.log(readout.textContent);
told.area.pointerdown({ clientX: 200, pointerId: 1 });
told.area.pointerup({ clientX: 400 });
console.log(svg.attributes.viewBox);
console.log(labels.map((label) => label.textContent).join(" "));
told.back.click();
console.log(svg.attributes.viewBox);
"""
