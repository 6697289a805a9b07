"""How results are printed in the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

_WIDTH_OF_FILES = 110


def results_console() -> Console:
    """Standard output; in a file or a pipe, lines may be wider than the 80 columns that rich assumes there."""
    console = Console()
    return console if console.is_terminal else Console(width=_WIDTH_OF_FILES)


def print_remarks(console: Console, warnings: Sequence[str], notes: Sequence[str]) -> None:
    """What makes results doubtful, and what is worth knowing."""
    for heading, sentences in (("Warning", warnings), ("Note", notes)):
        for sentence in sentences:
            console.print(f"[bold]{heading}:[/bold] {escape(sentence)}", highlight=False)


def plain_table(title: str) -> Table:
    """A table without lines between rows."""
    return Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)


def number_columns(table: Table, headings: Sequence[str]) -> None:
    """Add columns of numbers."""
    for heading in headings:
        table.add_column(escape(heading), justify="right", no_wrap=True)
