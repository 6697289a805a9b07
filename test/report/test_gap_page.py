"""``report.html``: whole, self-contained, readable by programs for the blind, and proof against names from outside."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from files.gaps import gap_page

from geomid_ros.model.effects import KnownEffect, Quantity
from geomid_ros.report.gap_page import GapPage, write_gap_page
from geomid_ros.report.gap_words import measured, ratio, verdict_sentence
from geomid_ros.report.series import MOST_DRAWN

from .pages import EVIL, Page

ARM = tuple(f"joint{k}" for k in range(1, 8))


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Callable[[GapPage], Page]:
    folder = tmp_path_factory.mktemp("pages")
    seen: dict[GapPage, Page] = {}

    def draw(page: GapPage) -> Page:
        if page not in seen:
            write_gap_page(folder / "report.html", page)
            seen[page] = Page((folder / "report.html").read_text(encoding="utf-8"))
        return seen[page]

    return draw


NAMED = gap_page("named", ARM, wrench=True, simulated=True)
OUTSIDE = gap_page("incomplete", EVIL, wrench=True, simulated=True)
OUTSIDE = replace(OUTSIDE, file=replace(OUTSIDE.file, robot=EVIL[0]))
PAGES = {
    "named": NAMED,
    "no gap": gap_page("no gap", ARM),
    "inertias": gap_page("inertias", ARM[:3]),
    "ambiguous": gap_page("ambiguous", ARM[:3]),
    "incomplete": gap_page("incomplete", ARM[:3]),
    "unexplained": gap_page("unexplained", ARM[:3]),
    "names from outside": OUTSIDE,
    "twenty joints": gap_page("named", [f"left_arm_with_a_name_that_goes_on_joint_{k}" for k in range(20)]),
}
Draw = Callable[[GapPage], Page]


@pytest.mark.parametrize("case", PAGES)
def test_the_page_is_alone_readable_and_has_the_verdict_and_every_channel(case: str, drawn: Draw) -> None:
    """Pictures have titles and units; text stays text in them."""
    made, page = PAGES[case], drawn(PAGES[case])
    page.is_alone()
    page.can_be_read_without_seeing_it()
    result = made.result
    assert verdict_sentence(result) in page.text
    for channel, before in zip(result.channels, result.gap.before, strict=True):
        assert channel in page.text
        assert ratio(before) in page.text
    for finding in result.findings:
        assert (finding.sentence in page.text) == bool(finding.moment or finding.was), "the table has the numbers"
        assert all(measured(quantity) in page.text for quantity in finding.parameters.values())
    for picture in page.pictures:
        text = "".join(picture.itertext())
        assert picture.tag == "{http://www.w3.org/2000/svg}svg"
        assert len(re.findall(r"\[(?:N m|N|rad|rad/s|s)\]", text)) >= 2, text


def titles(page: Page) -> list[str]:
    """Of its pictures."""
    return [attributes["alt"] or "" for tag, attributes in page.elements if tag == "img"]


@pytest.mark.parametrize("variable", ["velocity", "position", "load", "time"])
def test_what_was_named_is_drawn_against_what_it_depends_on(variable: str, drawn: Draw) -> None:
    """And what depends on another joint is drawn against that joint."""
    located = [replace(entry, **{variable: 0.9}) for entry in NAMED.result.located]
    page = drawn(replace(NAMED, result=replace(NAMED.result, located=tuple(located))))
    assert [title.partition(":")[0] for title in titles(page)] == [f"Residual of joint4 against {variable}"]
    assert any("joint2 against velocity of joint1" in title for title in titles(drawn(PAGES["unexplained"])))


def test_channels_and_simulated_efforts_are_lines_over_time(drawn: Draw) -> None:
    panels = [attributes for tag, attributes in drawn(NAMED).elements if tag == "svg"]
    labels = [attributes["aria-label"] or "" for attributes in panels]
    assert sum(label.endswith("measured, before, after") for label in labels) == MOST_DRAWN
    assert sum(label.endswith("measured, simulated before, simulated after") for label in labels) == len(ARM)


def test_bars_are_as_long_as_the_logarithm_of_the_gap(drawn: Draw) -> None:
    result = NAMED.result
    lengths = {kind: [] for kind in ("before", "inertias_only", "after")}  # type: dict[str, list[float]]
    for tag, attributes in drawn(NAMED).elements:
        if tag == "b" and attributes.get("class") in lengths:
            width = re.fullmatch(r"width: ([\d.]+)%", attributes["style"] or "")
            assert width
            lengths[attributes["class"]].append(float(width[1]))  # type: ignore[index]
    count = len(result.channels)
    shown = np.array([lengths[kind][:count] for kind in lengths]).ravel()
    gaps = np.concatenate([result.gap.before, result.gap.inertias_only, result.gap.after])
    scale = shown.max() / np.log(gaps.max())
    assert 80.0 < shown.max() <= 100.0
    np.testing.assert_allclose(shown, scale * np.log(np.maximum(gaps, 1.0)), atol=0.02)


def test_the_table_of_changes_has_links_that_changed_and_what_the_model_said_before(drawn: Draw) -> None:
    text = drawn(NAMED).text
    assert "Unchanged: link joint1, link joint3, link joint5, link joint7." in text
    assert "link joint2 3.500 3.850" in text
    assert text.count("0.19") == 3, "sqrt(4) log(1.1) of each"
    level = Quantity(0.25, unit="N m")
    known = (KnownEffect(effect="coulomb_friction", joint="joint4", parameters={"level": level}),)
    page = drawn(replace(NAMED, file=replace(NAMED.file, known=known)))
    assert "already in the model Coulomb friction at joint4" in page.text
    assert "level 0.2500 N m 0.4012 ± 0.0049 N m" in page.text
    assert "level none 0.4012 ± 0.0049 N m" in text


def test_the_table_of_changes_has_what_is_written_and_no_more(drawn: Draw) -> None:
    """Also what ``identify`` finds beside a URDF; not what is unsure."""
    assert "Added" not in drawn(PAGES["ambiguous"]).text
    offset = KnownEffect("effort_offset", "joint3", "", {"offset": Quantity(1.5, 0.1, "N m")})
    text = drawn(replace(NAMED, result=replace(NAMED.result, ordinary=(offset,)))).text
    added = text.partition("Added: what is sure and what geomid identify finds, fitted together")[2]
    assert "at joint3 offset none 1.50 ± 0.10 N m" in added.partition("Link inertias")[0]


def test_what_is_said_of_each_case(drawn: Draw) -> None:
    """Nothing found is a plain page; an ambiguity names rivals and what would settle it."""
    plain, text = drawn(PAGES["no gap"]).text, drawn(PAGES["ambiguous"]).text
    assert "No gap found" in plain
    for absent in ("Findings", "Unexplained", "Next recording", "Candidates", "against"):
        assert absent not in plain
    rivals = "Load friction at joint2 (worse by 1.2), Viscous friction at joint2 (worse by 3.8)"
    assert rivals in text.replace(" ,", ",")
    assert "To discriminate: move joint2 at three constant speeds" in text
    assert "No resimulation: MuJoCo has the day off." in text
    named = drawn(NAMED).text
    assert "To discriminate" not in named
    assert "Resimulation In closed loop Efforts simulated in MuJoCo" in named
    assert "before 10.9" in named
    assert "No resimulation" not in named
