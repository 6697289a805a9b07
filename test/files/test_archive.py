"""Archives: arrays and bytes come back to the last bit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.files.archive import archived, pack, unarchived, unpack
from geomid_ros.files.schema import structured
from geomid_ros.types import FloatArray

RANDOM = np.random.default_rng(0)
MATRICES = {
    "full": RANDOM.normal(size=(3, 3)),
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


def test_what_is_written_is_read() -> None:
    files = {"a.txt": b"\x00\xff", "empty": b""}
    content = archived(vars(Kept(MATRICES, files, ((MATRICES["upper"],), ()))))
    read = structured(Kept, unarchived(content), "its text:")
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


@pytest.mark.parametrize(("value", "message"), [(b"1", "expected an array"), (np.array([np.nan]), "finite numbers")])
def test_what_is_no_array_is_refused(value: object, message: str) -> None:
    content = archived({"arrays": {"x": value}, "files": {}})
    with pytest.raises(InputError, match=f"arrays.x is .*{message}"):
        structured(Kept, unarchived(content), "its text:")


def test_a_triangle_without_numbers_is_refused_unmade() -> None:
    """However large it claims to be; an empty array is none."""
    empty = np.zeros((0, 7))
    assert structured(Kept, unarchived(archived({"arrays": {"x": empty}, "files": {}})), "").arrays["x"].shape == (0, 7)
    text, vectors = unpack(archived({"arrays": {"x": np.zeros(0)}, "files": {}}))
    claimed = text.replace('"shape": [0]', f'"shape": [0, {10**11}], "triangle": true')
    assert claimed != text
    with pytest.raises(InputError):
        unarchived(pack(claimed, vectors))
