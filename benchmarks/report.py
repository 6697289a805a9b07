"""Where experiments leave what they found: tables on the screen, pictures and one JSON file in a folder."""

from __future__ import annotations

import json
import math
from argparse import ArgumentParser
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

from matplotlib.figure import Figure
from rich import box
from rich.console import Console
from rich.table import Table

FOLDER = Path("out/bench")
"""Where results go unless another folder is named."""


class Report:
    """Tables, pictures and results of one run, in ``folder``."""

    def __init__(self, folder: Path = FOLDER) -> None:
        self._folder = folder
        self._console = Console(width=190)
        self._status = Console(stderr=True)
        self._results: dict[str, Any] = {}
        folder.mkdir(parents=True, exist_ok=True)

    def table(self, title: str, headings: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> None:
        """Print a table: the first column to the left, the others to the right."""
        table = Table(title=title, caption=caption, box=box.SIMPLE_HEAD, title_justify="left", caption_justify="left")
        for index, heading in enumerate(headings):
            table.add_column(heading, justify="right" if index else "left", no_wrap=index == 0)
        for row in rows:
            table.add_row(*row)
        self._console.print(table)

    def say(self, text: str) -> None:
        """Print a line."""
        self._console.print(text, highlight=False, soft_wrap=True)

    def progress(self, text: str) -> None:
        """Say what is being computed, on the error stream."""
        self._status.print(text, style="dim", highlight=False)

    def picture(self, name: str, figure: Figure) -> None:
        """Write ``name``.png."""
        path = self._folder / f"{name}.png"
        figure.savefig(path, dpi=130, bbox_inches="tight")
        self.say(f"picture: {path}\n")

    def result(self, name: str, value: Any) -> None:
        """Keep a value and write the JSON file anew, so that an interrupted run leaves what it had."""
        self._results[name] = _plain(value)
        path = self._folder / "results.json"
        path.write_text(json.dumps(self._results, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    """JSON has no infinity and no NaN: null stands for them."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def chosen(parser: ArgumentParser, named: Sequence[str], known: Collection[str]) -> Collection[str]:
    """The names on a command line, all that are known if there are none; ends the command at one that is not."""
    unknown = [name for name in named if name not in known]
    if unknown:
        parser.error(f"nothing is called {', '.join(unknown)}; there are {', '.join(known)}")
    return named or known
