"""Array types shared by every floor, and the one way to freeze an array."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]
AnyArray: TypeAlias = NDArray[Any]


def frozen(values: ArrayLike) -> FloatArray:
    """A read-only float64 copy of ``values``; arrays kept in frozen objects are made with it."""
    array = np.array(values, dtype=np.float64, order="C")
    array.setflags(write=False)
    return array
