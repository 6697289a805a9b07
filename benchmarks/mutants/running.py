"""A copy of the repository in which one fault after the other is planted, and the tests that meet it are run."""

from __future__ import annotations

import io
import os
import resource
import subprocess
import sys
import tarfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.mutants.operators import Mutant

_PATIENCE = 300.0  # [s of the processor] of tests, beside five times what they take without a fault


def copied(repository: Path, folder: Path) -> Path:
    """What is committed in a repository, in a folder."""
    command = ["git", "-C", str(repository), "archive", "HEAD"]
    archive = subprocess.run(command, capture_output=True, check=True).stdout  # noqa: S603 a command of ours
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        tar.extractall(folder, filter="data")
    return folder


def environment(root: Path) -> dict[str, str]:
    """In which the copy is what is imported, with one thread, and nothing is compiled that a fault would outlive."""
    own = {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
    return {**os.environ, **own, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def is_killed(root: Path, mutant: Mutant, tests: Sequence[str], seconds: float) -> bool:
    """Whether one of the tests, which take so long without a fault, fails with it or comes to no end."""
    path = root / mutant.path
    source = path.read_text(encoding="utf-8")
    (root / "chosen").write_text("\n".join(tests), encoding="utf-8")
    path.write_text(mutant.applied(source), encoding="utf-8")
    try:
        return _fails(root, _PATIENCE + 5.0 * seconds)
    finally:
        path.write_text(source, encoding="utf-8")


def _fails(root: Path, patience: float) -> bool:
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "@chosen"]
    limits = (int(patience), int(patience) + 10)
    ended = subprocess.run(  # noqa: S603 a command of ours
        command,
        cwd=root,
        env=environment(root),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, limits),
        check=False,
    )
    return ended.returncode != 0
