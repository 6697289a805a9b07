"""URDF made of a xacro file, by the package ``xacro`` in a process of its own with bounded time, memory and output."""

from __future__ import annotations

import resource
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from geomid_ros.errors import InputError
from geomid_ros.model.urdf_tree import MOST_BYTES
from geomid_ros.signals.limits import LONGEST_REASON

SUFFIX = ".xacro"
_SECONDS = 30
_MEMORY = 2_000_000_000


def urdf_of_xacro(path: Path, arguments: Sequence[str] = ()) -> str:
    """The URDF that a xacro file becomes.

    A xacro file is a program: it computes by Python expressions, and includes any file that the user may read.

    Args:
        path: the file.
        arguments: for it, as ``NAME:=VALUE``.

    Raises:
        InputError: naming the file, and the command that makes the URDF where the package is not installed.
    """
    wrong = next((argument for argument in arguments if ":=" not in argument), None)
    if wrong is not None:
        raise InputError(f"xacro's argument '{wrong}' is not of the form NAME:=VALUE")
    if not path.is_file():
        raise InputError(f"{path}: no regular file, as a robot description is")
    if find_spec("xacro") is None:
        command = shlex.join(["xacro", str(path), *arguments])
        raise InputError(
            f"{path}: a xacro file, of which this command makes a URDF: {command} > robot.urdf (after 'pip install "
            "xacro', or in a sourced workspace, geomid runs it by itself)"
        )
    return _run([sys.executable, "-c", "import xacro; xacro.main()", str(path), *arguments], path)


def _run(command: Sequence[str], path: Path) -> str:
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as errors:
        try:
            status = subprocess.run(  # noqa: S603 what the user gave to run
                command,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=errors,
                timeout=_SECONDS,
                check=False,
                preexec_fn=_bounds,
            ).returncode
        except subprocess.TimeoutExpired as error:
            raise InputError(f"{path}: xacro takes longer than {_SECONDS} s") from error
        out.seek(0), errors.seek(0)
        text, said = out.read(MOST_BYTES + 1), errors.read(MOST_BYTES)
    if status != 0:
        last = " ".join(said.decode(errors="replace").split())[-LONGEST_REASON:]
        raise InputError(f"{path}: xacro cannot make a URDF of it ({last or status}); is an --xacro-arg missing?")
    return text.decode(errors="replace")


def _bounds() -> None:
    """Limit what the process may take and write."""
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_FSIZE, (MOST_BYTES + 1, MOST_BYTES + 1))
