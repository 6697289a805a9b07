"""The files of this tree, as git sees them, or where it was unpacked from an sdist all that are not made here."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[1]
_MADE = {"build", "install", "log", "out", "geomid_out", "__pycache__"}
_MADE_ENDS = (".egg-info", "_cache", ".hypothesis", ".so")


def files() -> set[Path]:
    """Relative to the root."""
    if not (ROOT / ".git").exists():
        found = (path.relative_to(ROOT) for path in ROOT.rglob("*") if path.is_file())
        return {path for path in found if not any(part in _MADE or _is_made(part) for part in path.parts)}
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\0")
    return {Path(name) for name in listed if (ROOT / name).is_file()}


def _is_made(part: str) -> bool:
    return part.startswith(".venv") or part.endswith(_MADE_ENDS) or part == "PKG-INFO"


def copy(to: Path) -> Path:
    """A copy of the tree; returns ``to``."""
    for file in files():
        (to / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / file, to / file)
    return to


def quick_compiler(folder: Path) -> str:
    """A C compiler that does not optimise, in an eighth of the time: for tests of which files are built."""
    path = folder / "cc"
    path.write_text('#!/bin/sh\nexec cc "$@" -O0\n')
    path.chmod(0o755)
    return str(path)
