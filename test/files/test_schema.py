"""Documents become dataclasses and back: what is written is read, and what cannot be names its key.

Archives: arrays and bytes come back to the last bit.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geomid_ros.errors import InputError
from geomid_ros.files.archive import archived, pack, unarchived, unpack
from geomid_ros.files.schema import Vector, from_document, to_document
from geomid_ros.types import FloatArray


@dataclass(frozen=True)
class Inner:
    name: str
    value: float = math.nan
    kind: Literal["a", "b"] = "a"


@dataclass(frozen=True, eq=False)
class Outer:
    count: int
    centre: Vector
    inner: tuple[Inner, ...] = ()
    by_name: Mapping[str, float] = field(default_factory=dict)
    counted: Counter[str] = field(default_factory=Counter)
    maybe: Inner | None = None
    whole: bool = True
    anything: Any = None


FLOATS = st.floats(-1e40, 1e40)
INNER = st.builds(Inner, name=st.text(), value=FLOATS, kind=st.sampled_from(["a", "b"]))
OUTER = st.builds(
    Outer,
    count=st.integers(0, 2**63 - 1),
    centre=st.lists(FLOATS, min_size=3, max_size=3).map(np.array),
    inner=st.lists(INNER, max_size=3).map(tuple),
    by_name=st.dictionaries(st.text(), FLOATS, max_size=3),
    counted=st.dictionaries(st.text(), st.integers(0, 9), max_size=3).map(Counter),
    maybe=st.none() | INNER,
    whole=st.booleans(),
)


@settings(max_examples=50)
@given(OUTER)
def test_what_is_written_is_read(value: Outer) -> None:
    read = from_document(Outer, json.loads(json.dumps(to_document(value), allow_nan=False)), "file:")
    np.testing.assert_array_equal(read.centre, value.centre)
    assert {**vars(read), "centre": 0} == {**vars(value), "centre": 0}


def test_what_is_no_number_is_null_and_unknown_keys_are_left_alone() -> None:
    assert to_document(Inner("x", math.inf)) == {"name": "x", "value": None, "kind": "a"}
    read = from_document(Inner, {"name": "x", "value": None, "later": [1]}, "file:")
    assert math.isnan(read.value)


GOOD: dict[str, Any] = {"count": 1, "centre": [0, 0, 1.5], "inner": [{"name": "x"}]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"count": -1}, "file: count is -1, expected a count"),
        ({"count": True}, "file: count is True, expected a count"),
        ({"centre": [0, 1]}, r"file: centre is \[0, 1\], expected finite numbers, 3"),
        ({"centre": [0, 1, math.inf]}, "expected finite numbers"),
        ({"inner": {}}, "file: inner is {}, expected a list"),
        ({"inner": [{}]}, r"file: inner\[0\].name is not given"),
        ({"inner": [3]}, r"file: inner\[0\] is 3, expected an object with name"),
        ({"inner": [{"name": 3}]}, r"file: inner\[0\].name is 3, expected a text"),
        ({"inner": [{"name": "x", "value": "1"}]}, r"inner\[0\].value is '1', expected a finite number"),
        ({"inner": [{"name": "x", "value": 10**400}]}, "expected a finite number"),
        ({"inner": [{"name": "x", "kind": "c"}]}, r"inner\[0\].kind is 'c', expected 'a' or 'b'"),
        ({"inner": [{"name": "x"}] * 40_001}, "expected a list of at most 40000"),
        ({"by_name": {"joint": math.nan}}, "file: by_name.joint is nan, expected a finite number"),
        ({"by_name": {1: 1.0}}, "file: by_name is .*expected an object"),
        ({"counted": {"why": 1.5}}, "file: counted.why is 1.5, expected a count"),
        ({"maybe": []}, r"file: maybe is \[\], expected an object with name"),
        ({"whole": 1}, "file: whole is 1, expected true or false"),
    ],
)
def test_what_cannot_be_names_its_key_and_what_is_expected(changes: dict[str, Any], message: str) -> None:
    assert from_document(Outer, GOOD, "file:").inner == (Inner("x"),)
    with pytest.raises(InputError, match=message):
        from_document(Outer, GOOD | changes, "file:")


RANDOM = np.random.default_rng(0)
MATRICES = {
    "upper": np.triu(RANDOM.normal(size=(3, 3))),
    "wide upper": np.triu(RANDOM.normal(size=(2, 5))),
    "tall": np.vstack([np.triu(RANDOM.normal(size=(2, 2))), np.zeros((2, 2))]),
    "no rows": np.zeros((0, 5)),
    "vector": RANDOM.normal(size=4),
    "three": RANDOM.normal(size=(2, 3, 4)),
    "transposed": RANDOM.normal(size=(2, 3)).T,
}


@dataclass(frozen=True, eq=False)
class Kept:
    arrays: Mapping[str, FloatArray]
    files: Mapping[str, bytes]
    several: tuple[tuple[FloatArray, ...], ...] = ()


def test_an_archive_holds_what_was_put_into_it() -> None:
    files = {"a.txt": b"\x00\xff", "empty": b""}
    content = archived(vars(Kept(MATRICES, files, ((MATRICES["upper"],), ()))))
    read = from_document(Kept, unarchived(content), "its text:")
    assert read.files == files
    assert read.arrays.keys() == MATRICES.keys()
    for name, matrix in MATRICES.items():
        np.testing.assert_array_equal(read.arrays[name], matrix, strict=True)
    np.testing.assert_array_equal(read.several[0][0], MATRICES["upper"])
    assert read.several[1] == ()


def test_of_a_triangle_its_numbers_alone_are_kept() -> None:
    size = 100
    sizes = [len(archived({"x": matrix})) for matrix in (np.ones((size, size)), np.triu(np.ones((size, size))))]
    assert sizes[0] - sizes[1] > 7 * size * (size - 1) // 2


def test_what_is_no_array_is_refused() -> None:
    for value, message in ((b"1", "expected an array"), (np.array([np.nan]), "finite numbers")):
        content = archived({"arrays": {"x": value}, "files": {}})
        with pytest.raises(InputError, match=f"arrays.x is .*{message}"):
            from_document(Kept, unarchived(content), "its text:")


def test_a_triangle_without_numbers_is_refused_unmade() -> None:
    """However large it claims to be; an empty array is none."""
    text, vectors = unpack(archived({"arrays": {"x": np.zeros(0)}, "files": {}}))
    claimed = text.replace('"shape": [0]', f'"shape": [0, {10**11}], "triangle": true')
    assert claimed != text
    with pytest.raises(InputError):
        unarchived(pack(claimed, vectors))
