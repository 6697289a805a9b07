"""Progress bars with the time left, on standard error."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

T = TypeVar("T")

console = Console(stderr=True)


def progress_bar(*extra: TextColumn | MofNCompleteColumn) -> Progress:
    """A bar that vanishes when done; silent where standard error is no terminal."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        *extra,
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


def tracked(items: Iterable[T], total: int, description: str) -> Iterator[T]:
    """Pass ``items`` on while a bar shows how many of ``total`` are done."""
    with progress_bar(MofNCompleteColumn()) as bar:
        task = bar.add_task(description, total=total)
        for item in items:
            yield item
            bar.advance(task)


@contextmanager
def working(description: str) -> Iterator[None]:
    """A spinner while something of unknown length goes on."""
    with console.status(description):
        yield


@contextmanager
def staged() -> Iterator[Callable[[str, float], None]]:
    """A bar for work that says what it is doing, and which share of it, 0 to 1, is done."""
    with progress_bar() as bar:
        task = bar.add_task("", total=1.0)
        yield lambda stage, share: bar.update(task, description=stage, completed=share)
