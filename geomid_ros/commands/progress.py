"""Progress on standard error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from geomid_ros.session import recordings


@contextmanager
def progress_bar() -> Iterator[recordings.Progress]:
    """A bar with the time left, which vanishes when done; nothing where standard error is no terminal.

    It yields a function to call with what is being done and the share of it, 0 to 1, that is done. As long as the share
    is zero the bar only shows that something is going on.
    """
    console = Console(stderr=True)
    columns = TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=None)

        def show(stage: str, share: float) -> None:
            bar.update(task, description=stage, completed=share, total=1.0 if share > 0.0 else None)

        yield show
