"""The documentation site builds without a warning, where what builds it is installed."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

from .reading import PAGES, ROOT

OWN = ROOT / ".venv-site/bin/python"


def python_with_mkdocs() -> str:
    """Of the environment that `make site` makes, or this one."""
    if OWN.exists():
        return str(OWN)
    if importlib.util.find_spec("mkdocs") and importlib.util.find_spec("mkdocstrings"):
        return sys.executable
    pytest.skip("mkdocs is not installed: make site")


def test_it_is_whole_and_loads_nothing_from_elsewhere(tmp_path: Path) -> None:
    site = tmp_path / "site"
    arguments = ["--strict", "--config-file", str(ROOT / "docs/mkdocs.yml"), "--site-dir", str(site)]
    command = [python_with_mkdocs(), "-m", "mkdocs", "build", *arguments]
    run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300, cwd=ROOT)
    assert run.returncode == 0, run.stderr
    pages = {path.relative_to(PAGES).with_suffix(".html") for path in PAGES.rglob("*.md")}
    built = {path.relative_to(site) for path in site.rglob("*.html")}
    assert pages < built
    assert Path("use/notebook.html") in built
    assert "<mfrac>" in (site / "method/index.html").read_text(encoding="utf-8")
    assert "weigh_payload" in (site / "api/index.html").read_text(encoding="utf-8")
    assert "data:image/png;base64," in (site / "use/notebook.html").read_text(encoding="utf-8")
    assert (site / "figures/arm7.gif").stat().st_size > 0
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        for tag in ('src="http', 'rel="stylesheet" href="http', 'src="//'):
            assert tag not in text, f"{page.relative_to(site)}: {tag}"
