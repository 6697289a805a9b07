"""Progress and results in the terminal. External texts are printed literally, never as markup, and made printable."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich import box
from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from geomid_ros import options
from geomid_ros.errors import one_line

if TYPE_CHECKING:
    from geomid_ros.checks.verdict import Verdict

_WIDTH_OF_FILES = 110


def results_console() -> Console:
    """Console on standard output; lines in a file or pipe may be wider than the 80 columns that rich assumes there."""
    console = Console(markup=False, emoji=False, highlight=False)
    if not console.is_terminal:
        console.width = _WIDTH_OF_FILES
    return console


def print_verdict(console: Console, verdict: Verdict, warnings: Iterable[str], notes: Iterable[str] = ()) -> None:
    """Print reasons against using a result, warnings, and notes."""
    print_remarks(console, {verdict.word.upper(): verdict.reasons, "Warning": warnings, "Note": notes})


def print_remarks(console: Console, remarks: Mapping[str, Iterable[str]]) -> None:
    """Print sentences, each after its heading."""
    for heading, sentences in remarks.items():
        for sentence in sentences:
            say(console, f"{heading}:", f" {sentence}")


def say(console: Console, heading: str, text: str) -> None:
    """Print a text after its heading."""
    console.print(Text.assemble((heading, "bold"), one_line(text)))


def lines(texts: Iterable[str]) -> Text:
    """Stack texts as the lines of a table cell."""
    return Text("\n".join(map(one_line, texts)))


def print_written(files: Sequence[Path], folder: Path, *, report: bool) -> None:
    """Print the written files; if no page was requested, name an older page in the folder."""
    click.echo(f"\nWritten: {', '.join(map(str, files))}")
    if not report and (old := folder / "report.html").exists():
        click.echo(f"Not of this run: {old}")


class _PlainTable(Table):
    def add_row(self, *cells: RenderableType | None, **style: Any) -> None:
        super().add_row(*(one_line(cell) if isinstance(cell, str) else cell for cell in cells), **style)


def plain_table(title: str, texts: Sequence[str] = (), numbers: Sequence[str] = ()) -> Table:
    """Create a table without lines between rows: text columns with these headings, then number columns."""
    table = _PlainTable(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in texts:
        table.add_column(heading, overflow="fold")
    number_columns(table, numbers)
    return table


def number_columns(table: Table, headings: Sequence[str]) -> None:
    """Add columns of numbers, which are wrapped rather than truncated."""
    for heading in headings:
        table.add_column(heading, justify="right", overflow="fold")


@contextmanager
def progress_bar() -> Iterator[options.Progress]:
    """Show a bar with the remaining time, which vanishes when done; nothing if standard error is no terminal.

    Yields a function to call with the current stage and its completed fraction, 0 to 1. While the fraction is zero, the
    bar only indicates activity.
    """
    console = Console(stderr=True)
    columns = TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=None)

        def show(stage: str, share: float) -> None:
            bar.update(task, description=stage, completed=share, total=1.0 if share > 0.0 else None)

        yield show
