"""The catalogue is complete, every test it names exists, and the page of faults has it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from .catalogue import CATALOGUE, Fault, table

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs/pages/faults.md"


def test_they_are_numbered() -> None:
    numbers = [entry.number for entry in CATALOGUE]
    assert numbers[:70] == list(range(1, 71))
    assert numbers == sorted(set(numbers))
    assert all(entry.tests for entry in CATALOGUE)


@pytest.mark.parametrize("entry", CATALOGUE, ids=lambda entry: str(entry.number))
def test_its_tests_exist(entry: Fault) -> None:
    """The file, the function, and the case among its parameters."""
    for test in entry.tests:
        name, _, rest = test.partition("::")
        text = (HERE / name).read_text(encoding="utf-8")
        if not rest:
            continue
        function, _, case = rest.partition("[")
        functions = {node.name for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)}
        assert function in functions, test
        assert not case or re.search(rf'^    "{re.escape(case.rstrip("]"))}":', text, re.MULTILINE), test


def test_the_page_has_the_table() -> None:
    assert table() in PAGE.read_text(encoding="utf-8")
