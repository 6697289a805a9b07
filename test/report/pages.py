"""Pages as a browser's parser sees them."""

from __future__ import annotations

import base64
import hashlib
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pytest

from geomid_ros.report import page

FORBIDDEN = {"iframe", "object", "embed", "form", "base", "audio", "video", "link"}
VOID = {"meta", "img", "br", "link", "input", "wbr"}
EVIL = ("<script>alert(1)</script>", '"><img src=http://x.example/y onerror=alert(1)>', "{{ 7 * 7 }} $\\frac$ & 関節")


class Page(HTMLParser):
    """A page as a browser's parser sees it: elements must be closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.source = text
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.elements[-1:] == [("wbr", {})]:
            self.words[-1] += data
        elif not {"style", "script"} & {*self.open}:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    @property
    def pictures(self) -> list[ElementTree.Element]:
        prefix = "data:image/svg+xml;base64,"
        sources = [attributes["src"] or "" for tag, attributes in self.elements if tag == "img"]
        assert all(source.startswith(prefix) for source in sources)
        return [ElementTree.fromstring(base64.b64decode(source.removeprefix(prefix))) for source in sources]

    def headings(self) -> list[str]:
        return [tag for tag, _ in self.elements if re.fullmatch("h[1-6]", tag)]

    def is_alone(self) -> None:
        """It needs nothing from elsewhere, and only its own script runs."""
        assert not FORBIDDEN & {tag for tag, _ in self.elements}
        for tag, attributes in self.elements:
            assert not any(name.startswith("on") for name in attributes), (tag, attributes)
            assert not {"href", "srcset"} & attributes.keys()
            assert (attributes.get("src") or "data:").startswith("data:")
            assert "url(" not in (attributes.get("style") or "")
        (policy,) = [a["content"] or "" for _, a in self.elements if a.get("http-equiv") == "Content-Security-Policy"]
        assert policy.startswith("default-src 'none'")
        scripts = re.findall(r"<script[^>]*>(.*?)</script>", self.source, re.DOTALL)
        assert len(scripts) == sum(tag == "script" for tag, _ in self.elements)
        own = base64.b64encode(hashlib.sha256(scripts[-1].encode()).digest()).decode()
        assert policy.endswith(f"script-src 'sha256-{own}'")

    def can_be_read_without_seeing_it(self) -> None:
        """By programs for the blind."""
        assert next(attributes["lang"] for tag, attributes in self.elements if tag == "html") == "en"
        assert all(attributes.get("alt") for tag, attributes in self.elements if tag == "img")
        assert self.headings()[0] == "h1"
        assert self.headings().count("h1") == 1
        assert all(attributes.get("scope") for tag, attributes in self.elements if tag == "th")


def lines_of_script(name: str, stage: str, folder: Path) -> list[str]:
    """What a page's script prints on a stage, run by an engine without a browser around it."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node to run the script with")
    script = (Path(page.__file__).parent / name).read_text(encoding="utf-8")
    (folder / "run.js").write_text(stage.replace("SCRIPT", script))
    run = subprocess.run([node, folder / "run.js"], capture_output=True, text=True, check=False, timeout=60)
    assert run.returncode == 0, run.stderr
    return run.stdout.splitlines()
