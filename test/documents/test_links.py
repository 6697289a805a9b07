"""Links lead somewhere, every page can be reached, and README is short."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import yaml

from .reading import DOCUMENTS, PAGES, ROOT, anchors, links, text_of

MOST_OF_README = 8_000  # bytes
MOST_OF_PICTURE = 600_000  # bytes


def test_links_lead_to_files_and_headings() -> None:
    found = [(document, *link) for document in DOCUMENTS for link in links(document)]
    assert len(found) > 100
    assert sum(bool(anchor) for _, _, anchor in found) > 10
    for document, path, anchor in found:
        assert path.exists(), f"{document}: {path.relative_to(ROOT)}"
        assert path.is_relative_to(ROOT), path
        assert not anchor or anchor in anchors(path), f"{document}: {path.relative_to(ROOT)}#{anchor}"


def test_every_page_is_in_the_navigation_once() -> None:
    text = text_of("docs/mkdocs.yml")
    shown = re.findall(r"([\w/]+\.md)$", text[text.index("\nnav:") :], re.MULTILINE)
    hooks = text_of("docs/generators/hooks.py")
    elsewhere = dict(re.findall(r'^    "([\w/]+\.md)": "([^"]+)"', hooks, re.MULTILINE))
    pages = [str(path.relative_to(PAGES)) for path in PAGES.rglob("*.md")]
    assert sorted(shown) == sorted([*pages, *elsewhere])
    assert all((ROOT / source).exists() for source in elsewhere.values())
    assert len(shown) >= 20


def test_readme_leads_to_every_use() -> None:
    """By the pages that it links to."""
    reached: set[Path] = set()
    new = {path for path, _ in links("README.md")}
    while new:
        reached |= new
        pages = [str(path.relative_to(ROOT)) for path in new if path.suffix == ".md"]
        new = {path for page in pages for path, _ in links(page)} - reached
    assert set(PAGES.rglob("*.md")) - reached <= {PAGES / "api/effects.md", PAGES / "api/results.md"}


def test_readme_is_short_and_its_picture_moves() -> None:
    text = text_of("README.md")
    assert len(text.encode()) <= MOST_OF_README
    first = re.findall(r"!\[.+\]\((.+)\)", text)[0]
    picture = (ROOT / first).read_bytes()
    assert picture.startswith(b"GIF89a")
    assert picture.count(b"\x21\xf9\x04") > 20  # frames
    assert len(picture) <= MOST_OF_PICTURE


def test_the_citation_names_this_version() -> None:
    citation = yaml.safe_load(text_of("CITATION.cff"))
    package = text_of("package.xml")
    assert f"<version>{citation['version']}</version>" in package
    assert f'<license file="LICENSE">{citation["license"]}</license>' in package
    assert [author["name"] for author in citation["authors"]] == re.findall(r"<maintainer[^>]*>([^<]+)<", package)


def test_the_architecture_is_the_generator_s_and_its_modules_exist() -> None:
    generator = ROOT / "docs/generators/architecture.py"
    subprocess.run([sys.executable, str(generator), "--check"], check=True)
    modules = re.findall(r'font-weight="bold"[^>]*>([\w/]+)<', text_of("docs/pages/figures/architecture.svg"))
    assert modules
    assert not [module for module in modules if not (ROOT / "geomid_ros" / f"{module}.py").is_file()]


FOLDERS = "geomid_ros|test|config|launch|security|bags|docs|benchmarks|examples"
HIDDEN = {"robots"}  # a room's folder of data
# What the recipe in CONTRIBUTING.md makes.
PLANNED = {"geomid_ros/model/effects/gear_ripple.py"}


def test_files_and_make_targets_that_are_named_exist() -> None:
    text = "\n".join(map(text_of, DOCUMENTS))
    files = set(re.findall(rf"`((?:{FOLDERS})/[\w./]*)`", text)) - PLANNED
    assert len(files) > 20
    assert not [name for name in files if not (ROOT / name).exists()]
    targets = set(re.findall(r"(?:`|    )make ([a-z]+)", text))
    assert len(targets) > 3
    assert targets <= set(re.findall(r"^([a-z]+):", text_of("Makefile"), re.MULTILINE))


def test_the_map_of_the_house_shows_every_room() -> None:
    """No more and no less, each floor as the test of the house holds it, and the folders within rooms."""
    from test_house import FLOORS  # noqa: PLC0415 it parses the package

    rows = re.findall(r"^\| (below|\d+) \| ([^|]+) \|", text_of("CONTRIBUTING.md"), re.MULTILINE)
    shown = {
        room.removesuffix("/").removesuffix(".py"): -1 if floor == "below" else int(floor)
        for floor, rooms in rows
        for room in re.findall(r"`([\w./]+)`", rooms)
    }
    assert shown == FLOORS
    rows = re.findall(r"^\| \d+ \| `(\w+)/` \| (.+) \|$", text_of("CONTRIBUTING.md"), re.MULTILINE)
    for room, what in rows:
        within = {path.parent.name for path in (ROOT / "geomid_ros" / room).glob("*/__init__.py")}
        assert set(re.findall(r"`(\w+)/`:", what)) == within - HIDDEN, room
