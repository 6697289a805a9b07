"""The documents of the repository: their text, links, headings and blocks of code."""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs/pages"
NOTEBOOK = ROOT / "examples/identify.ipynb"
_OUTSIDE = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "config/README.md", "bags/README.md")
DOCUMENTS = [*_OUTSIDE, *sorted(str(path.relative_to(ROOT)) for path in PAGES.rglob("*.md"))]

_FENCED = re.compile(r"^(<!-- run -->\n)?```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_INDENTED = re.compile(r"(?:^    .*\n)+", re.MULTILINE)
_COMMAND = re.compile(r"^    (geomid .+)$", re.MULTILINE)
_SPAN = re.compile(r"`([^`\n]+)`")
_LINK = re.compile(r"\]\(([^)\s]+)\)")


@dataclass(frozen=True)
class Block:
    """A block of code: its language, ``""`` where none is given, and whether it says of itself that it runs."""

    language: str
    text: str
    runs: bool = False


def text_of(document: str) -> str:
    return (ROOT / document).read_text(encoding="utf-8")


def without_code(text: str) -> str:
    return _SPAN.sub("", _INDENTED.sub("\n", _FENCED.sub("", text)))


def blocks(document: str) -> list[Block]:
    """Fenced and indented ones."""
    text = text_of(document)
    fenced = [Block(language, code, bool(mark)) for mark, language, code in _FENCED.findall(text)]
    indented = _INDENTED.findall(re.sub(r"^[-*0-9].*\n(?:  .*\n)*", "", _FENCED.sub("", text), flags=re.MULTILINE))
    return fenced + [Block("", re.sub(r"^    ", "", code, flags=re.MULTILINE)) for code in indented]


def outputs(document: str) -> list[tuple[str, str]]:
    """What blocks of output show that say that they run, each with the command above it that prints it."""
    text = text_of(document)
    shown = [match for match in _FENCED.finditer(text) if match[1] and match[2] == "text"]
    return [(_COMMAND.findall(text[: match.start()])[-1], match[3]) for match in shown]


def spans(document: str) -> list[str]:
    """What is set in code within sentences."""
    return _SPAN.findall(_FENCED.sub("", text_of(document)))


def links(document: str) -> Iterator[tuple[Path, str]]:
    """Files that the document links to, each with its anchor; links to elsewhere in the world are left out."""
    for link in _LINK.findall(without_code(text_of(document))):
        if "://" not in link:
            path, _, anchor = link.partition("#")
            here = ROOT / document
            yield (here.parent / path).resolve() if path else here, anchor


def anchors(path: Path) -> set[str]:
    """Anchors of a document's headings, as MkDocs and code hosts make them."""
    headings = re.findall(r"^#+ (.+)$", _FENCED.sub("", path.read_text(encoding="utf-8")), re.MULTILINE)
    return {_slug(heading.replace("`", "")) for heading in headings}


def _slug(heading: str) -> str:
    plain = unicodedata.normalize("NFKD", heading).encode("ascii", "ignore").decode()
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", plain).strip().lower())


def cells() -> list[str]:
    """The notebook's cells of code."""
    document = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    return ["".join(cell["source"]) for cell in document["cells"] if cell["cell_type"] == "code"]
