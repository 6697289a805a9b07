"""Which tests run which lines, and how long each test takes."""

from __future__ import annotations

import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path

from coverage import CoverageData

from benchmarks.mutants.operators import Mutant
from benchmarks.mutants.running import environment

_DURATION = re.compile(r"^ *([0-9.]+)s (?:setup|call|teardown) +(.+?) *$", re.MULTILINE)
_AT_IMPORT = ""  # in the place of a test


@dataclass
class Selection:
    """Of the tests of some folders: ``seconds`` of each, and those that run each ``line`` of each file."""

    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    lines: dict[tuple[str, int], set[str]] = field(default_factory=lambda: defaultdict(set))
    files: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))

    @staticmethod
    def make(root: Path, folders: Sequence[str]) -> Selection:
        """Run all tests of the folders once. Raises RuntimeError if one of them fails."""
        data = root / ".coverage"
        options = ["-vv", "--durations=0", "-n", "2", "-p", "no:cacheprovider", "--cov=geomid_ros"]
        command = [sys.executable, "-m", "pytest", *options, "--cov-context=test", "--cov-report=", *folders]
        ended = subprocess.run(  # noqa: S603 a command of ours
            command, cwd=root, env=environment(root), capture_output=True, text=True, check=False
        )
        if ended.returncode:
            raise RuntimeError(f"tests fail without any fault:\n{ended.stdout[-3000:]}")
        found = Selection()
        for seconds, test in _DURATION.findall(ended.stdout):
            found.seconds[test] += float(seconds)
        found._read(CoverageData(str(data)), root)
        return found

    def _read(self, data: CoverageData, root: Path) -> None:
        data.read()
        for path in data.measured_files():
            name = str(Path(path).relative_to(root))
            for line, contexts in data.contexts_by_lineno(path).items():
                tests = {context.rpartition("|")[0] for context in contexts}
                self.lines[name, line] |= tests
                self.files[name] |= tests - {_AT_IMPORT}

    def tests(self, mutant: Mutant, limit: float) -> list[str]:
        """The tests that a fault may concern, as many as take up to ``limit`` seconds.

        First those that run its lines; then the others of their files, which may share what these have made; and where
        the lines are run at import, those that run any line of the file. File by file, the quick ones first.
        """
        first, last = mutant.lines
        running = set().union(*(self.lines.get((mutant.path, line), ()) for line in range(first, last + 1)))
        files = {_file(test) for test in (self.files[mutant.path] if _AT_IMPORT in running or not running else running)}
        found = [test for test in self.seconds if _file(test) in files]
        of_file: dict[str, float] = defaultdict(float)
        for test in found:
            of_file[_file(test)] += self.seconds[test]
        order = sorted(found, key=lambda t: (t not in running, of_file[_file(t)], _file(t), self.seconds[t], t))
        spent = accumulate(self.seconds[test] for test in order)
        return [test for test, seconds in zip(order, spent, strict=True) if seconds <= limit]


def _file(test: str) -> str:
    return test.partition("::")[0]
