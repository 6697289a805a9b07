"""Progress and results in the terminal. External texts are printed literally, never as markup, and made printable."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich import box
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.measure import Measurement
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Column, Table
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
    click.echo(f"\nWritten to {folder}: {', '.join(file.name for file in files)}")
    if not report and (old := folder / "report.html").exists():
        click.echo(f"Not of this run: {old}")


class _PlainTable(Table):
    """A table without lines between rows. What is wider than the console continues below, after the first text columns
    that still fit."""

    def __init__(self, heading: str) -> None:
        super().__init__(box=box.SIMPLE_HEAD, pad_edge=False)
        self._heading = heading

    def add_row(self, *cells: RenderableType | None, **style: Any) -> None:
        super().add_row(*(one_line(cell) if isinstance(cell, str) else cell for cell in cells), **style)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        if self._heading:
            yield Text(self._heading, "bold")
        widths = [_widths(column, console, options) for column in self.columns]
        texts = next((index for index, column in enumerate(self.columns) if column.no_wrap), 0)
        shown = [0]
        for index in range(1, len(widths)):
            if len(shown) > 1 and _left(widths, [*shown, index], options) < 0:
                yield self._part(shown, widths, options)
                shown = [*range(min(texts, index))] or [0]
                while len(shown) > 1 and _left(widths, [*shown, index], options) < 0:
                    shown.pop()
            shown.append(index)
        yield self._part(shown, widths, options)

    def _part(self, shown: Sequence[int], widths: Sequence[tuple[int, int]], options: ConsoleOptions) -> Table:
        """Return some columns as a table. The first ones get the width that is left."""
        part = Table(box=self.box, pad_edge=self.pad_edge)
        part.rows = self.rows
        left = max(0, _left(widths, shown, options))
        for place, index in enumerate(shown):
            smallest, natural = widths[index]
            width = smallest + min(left, natural - smallest)
            left -= width - smallest
            column = replace(self.columns[index], _index=place, width=width, no_wrap=False, overflow="fold")
            part.columns.append(column)
        return part


def _widths(column: Column, console: Console, options: ConsoleOptions) -> tuple[int, int]:
    """Smallest and natural width of a column. Numbers are not broken, nor are words up to a third of the console."""
    cells = [Measurement.get(console, options, cell) for cell in (column.header, *column.cells)]
    natural = max(cell.maximum for cell in cells)
    smallest = min(max(cell.minimum for cell in cells), options.max_width // 3)
    return natural if column.no_wrap else smallest, natural


def _left(widths: Sequence[tuple[int, int]], shown: Sequence[int], options: ConsoleOptions) -> int:
    """Width that the smallest table of some columns leaves; columns are three characters apart, with one at the end."""
    return options.max_width + 1 - sum(widths[index][0] + 3 for index in shown)


def plain_table(
    title: str, texts: Sequence[str] = (), numbers: Sequence[str] = (), remarks: Sequence[str] = ()
) -> Table:
    """Create a table without lines between rows: text columns with these headings, then columns of numbers, which are
    never wrapped, then more text columns."""
    table = _PlainTable(title)
    for heading in texts:
        table.add_column(heading, overflow="fold")
    for heading in numbers:
        table.add_column(heading, justify="right", no_wrap=True)
    for heading in remarks:
        table.add_column(heading)
    return table


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
