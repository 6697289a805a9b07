"""The catalogue is complete, every test it names exists, and the page of faults has it."""

from __future__ import annotations

import re
from pathlib import Path

from .catalogue import CATALOGUE, table

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs/pages/faults.md"


def test_they_are_numbered() -> None:
    numbers = [entry.number for entry in CATALOGUE]
    assert numbers[:70] == list(range(1, 71))
    assert numbers == sorted(set(numbers))
    assert all(entry.tests for entry in CATALOGUE)


def test_their_tests_exist() -> None:
    """The file, the function, and the case among its parameters."""
    for test in {test for entry in CATALOGUE for test in entry.tests}:
        name, _, rest = test.partition("::")
        function, _, case = rest.partition("[")
        text = (HERE / name).read_text(encoding="utf-8")
        assert not function or re.search(rf"^ *def {function}\(", text, re.MULTILINE), test
        assert not case or re.search(rf'^    "{re.escape(case.rstrip("]"))}":', text, re.MULTILINE), test


def test_the_page_has_the_table() -> None:
    assert table() in PAGE.read_text(encoding="utf-8")
