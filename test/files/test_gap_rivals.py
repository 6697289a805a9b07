"""What a gap leaves open."""

from __future__ import annotations

import pytest

from geomid_ros.files.models.gap_rivals import is_open

from .gaps import Case, gap_result


@pytest.mark.parametrize(("case", "answer"), [("ambiguous", True), ("named", False), ("no gap", False)])
def test_rivals_of_a_name_that_is_not_sure_are_open(case: Case, answer: bool) -> None:
    assert is_open(gap_result(case, ("shoulder", "elbow"))) is answer
