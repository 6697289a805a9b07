"""Hooks of MkDocs: documents of the repository become pages, their links follow, and formulas become MathML."""

from __future__ import annotations

import json
import posixpath
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
FOLDER = "docs/pages"
# Pages whose text is elsewhere, as it has to be where it is.
ELSEWHERE = {
    "use/notebook.md": "examples/identify.ipynb",
    "robots/configurations.md": "config/README.md",
    "developers/contributing.md": "CONTRIBUTING.md",
    "developers/security.md": "SECURITY.md",
    "developers/bags.md": "bags/README.md",
    "developers/changelog.md": "CHANGELOG.rst",
}
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)#\s:]+)(#[^)\s]*)?\)")


def on_config(config: MkDocsConfig) -> None:
    """Formulas in fenced blocks called ``math`` need no script and no network."""
    fence = {"name": "math", "class": "math", "format": mathml}
    config.mdx_configs["pymdownx.superfences"] = {"custom_fences": [fence]}


def mathml(source: str, *_: Any, **__: Any) -> str:
    """A formula as the browser draws it."""
    return convert(source, display="block")


def on_files(files: Files, *, config: MkDocsConfig) -> None:
    """Add the pages whose text is elsewhere."""
    for page, source in ELSEWHERE.items():
        files.append(File.generated(config, page, content=markdown_of(ROOT / source)))


def markdown_of(path: Path) -> str:
    """A document of the repository as Markdown."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".ipynb":
        return "\n\n".join(block for cell in json.loads(text)["cells"] for block in blocks_of(cell))
    if path.suffix == ".rst":
        text = re.sub(r"^\^+\n", "", text, flags=re.MULTILINE)
        text = re.sub(r"^(.+)\n-+$", r"## \1\n", text, flags=re.MULTILINE).replace("``", "`")
        return f"# {text}"
    return text


def blocks_of(cell: dict[str, Any]) -> list[str]:
    """A cell of a notebook with what it printed and drew."""
    source = "".join(cell["source"])
    if cell["cell_type"] == "markdown":
        return [source]
    blocks = [f"```python\n{source}\n```"]
    for output in cell["outputs"]:
        data = output.get("data", {"text/plain": output.get("text", [])})
        if "image/png" in data:
            blocks.append(f"![What the cell draws](data:image/png;base64,{''.join(data['image/png']).strip()})")
        else:
            blocks.append(f"```text\n{''.join(data['text/plain']).rstrip()}\n```")
    return blocks


def on_page_markdown(markdown: str, *, page: Page, **_: Any) -> str:
    """Links lead from page to page; a file that is no page is named."""
    here = page.file.src_uri
    source = ELSEWHERE.get(here, f"{FOLDER}/{here}")
    pages = {document: name for name, document in ELSEWHERE.items()}

    def followed(link: re.Match[str]) -> str:
        mark, text, path, anchor = link.groups()
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
        if target.startswith(f"{FOLDER}/"):
            target = target.removeprefix(f"{FOLDER}/")
        elif target in pages:
            target = pages[target]
        else:
            return f"`{target}`" if text in target else f"{text} (`{target}`)"
        return f"{mark}[{text}]({posixpath.relpath(target, posixpath.dirname(here))}{anchor or ''})"

    return _LINK.sub(followed, markdown)


def on_page_content(html: str, **_: Any) -> str:
    """Docstrings name what they mean with its kind, as Sphinx reads it: ``:attr:`` and the like."""
    return re.sub(r":(?:attr|class|data|exc|func|meth|mod):<code>~?", "<code>", html)
