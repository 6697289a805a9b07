"""How results are printed in the terminal: names and texts from outside as they are, never as markup, and printable."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from rich import box
from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from geomid_ros.checks.verdict import Verdict
from geomid_ros.errors import one_line

_WIDTH_OF_FILES = 110


def results_console() -> Console:
    """Standard output; in a file or a pipe, lines may be wider than the 80 columns that rich assumes there."""
    console = Console(markup=False, emoji=False, highlight=False)
    if not console.is_terminal:
        console.width = _WIDTH_OF_FILES
    return console


def print_remarks(console: Console, verdict: Verdict, warnings: Iterable[str], notes: Iterable[str] = ()) -> None:
    """Print why a result cannot be used, what to be careful about, and what is worth knowing."""
    for heading, sentences in ((verdict.word.upper(), verdict.reasons), ("Warning", warnings), ("Note", notes)):
        for sentence in sentences:
            say(console, f"{heading}:", f" {sentence}")


def say(console: Console, heading: str, text: str) -> None:
    """Print a text behind its heading."""
    console.print(Text.assemble((heading, "bold"), one_line(text)))


def lines(texts: Iterable[str]) -> Text:
    """Texts one below the other, for a cell."""
    return Text("\n".join(map(one_line, texts)))


class _PlainTable(Table):
    def add_row(self, *cells: RenderableType | None, **style: Any) -> None:
        super().add_row(*(one_line(cell) if isinstance(cell, str) else cell for cell in cells), **style)


def plain_table(title: str) -> Table:
    """A table without lines between rows."""
    return _PlainTable(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)


def number_columns(table: Table, headings: Sequence[str]) -> None:
    """Add columns of numbers."""
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
