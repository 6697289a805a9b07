"""Command line: the group ``geomid`` and behaviour common to all commands, which are in the files of this folder."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from io import TextIOWrapper
from typing import Any

import click
from click.shell_completion import CompletionItem

import geomid_ros
from geomid_ros.errors import GeomidError, check_memory, error_message, unknown_name

COMMANDS = {
    "compare": "Compare two results of one robot.",
    "dashboard": "Show a running node on a local page.",
    "demo": "Watch a live identification of a simulated arm.",
    "excite": "Design an exciting trajectory.",
    "export": "Print an estimate in the format of other software.",
    "feedforward": "Fill the efforts of a trajectory.",
    "fleet": "Identify many robots of a type from many bags.",
    "gap": "Diagnose the gap between simulation and robot.",
    "identify": "Identify link inertias from rosbags.",
    "payload": "Identify a payload.",
    "play": "Play a rosbag on live topics.",
    "prior": "Compute prior inertials of a URDF from its shapes.",
    "report": "Write the report of a result again.",
    "sample": "Sample robots from the posterior.",
    "simulate": "Record a rosbag of a simulated robot.",
    "verify": "Check that a model predicts a recording.",
}
"""First sentence of each command's help, by its name."""
_HOMES = {  # module of a command, if its name differs
    **dict.fromkeys(("compare", "export", "feedforward", "payload", "report", "sample", "verify"), "results"),
    **dict.fromkeys(("dashboard", "demo", "play"), "live"),
    **dict.fromkeys(("fleet", "gap", "identify"), "recordings"),
}


INTERRUPTED = 130
"""Exit status after Ctrl-C, as of other programs."""


class _Failure(click.ClickException):
    """Error of this package shown to the user: one message, exit status 2."""

    exit_code = 2


class _Group(click.Group):
    """Group that loads a command on first use, because its imports are slow."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        if cmd_name not in COMMANDS:
            raise _Failure(str(unknown_name("command", cmd_name, COMMANDS)))
        command: click.Command = getattr(
            import_module(f"geomid_ros.commands.{_HOMES.get(cmd_name, cmd_name)}"), cmd_name
        )
        return command

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        names = [CompletionItem(name, help=text) for name, text in COMMANDS.items() if name.startswith(incomplete)]
        return names + click.Command.shell_complete(self, ctx, incomplete)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def invoke(self, ctx: click.Context) -> Any:
        try:
            check_memory()
            return super().invoke(ctx)
        except GeomidError as error:
            raise _Failure(str(error)) from error
        except KeyboardInterrupt as error:
            click.echo("Interrupted.", err=True)
            raise click.exceptions.Exit(INTERRUPTED) from error


class _Output(TextIOWrapper):
    """Standard output in which characters that its encoding lacks become question marks.

    If nobody reads on, as after ``| head``, the rest is dropped: the command's result does not depend on it.
    """

    def write(self, text: str) -> int:
        with self._writing():
            return super().write(text)
        return len(text)

    def flush(self) -> None:
        with self._writing():
            super().flush()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Raise GeomidError if the block cannot write."""
        try:
            yield
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())  # what is buffered would fail again
            if not isinstance(error, BrokenPipeError):
                raise GeomidError(f"standard output cannot be written: {error.strerror}") from error


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(geomid_ros.__version__, prog_name="geomid")
def root() -> None:
    """Identify a robot's link inertias, from rosbags or while it runs."""


def main() -> None:
    """Entry point of ``geomid``."""
    if sys.stdout is not None:
        out = sys.stdout
        sys.stdout = _Output(out.buffer, out.encoding, errors="replace", line_buffering=out.isatty())
    try:
        try:
            root()
        finally:
            click.echo(nl=False)  # what is still buffered may fail to be written
    except Exception as error:  # libraries raise various errors when memory runs out
        if not (sentence := error_message(error)):
            raise
        click.echo(f"Error: {sentence}", err=True)
        sys.exit(2)
