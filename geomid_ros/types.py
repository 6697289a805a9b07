"""Array types shared by all layers, and a function to freeze arrays."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]
AnyArray: TypeAlias = NDArray[Any]


def frozen(values: ArrayLike) -> FloatArray:
    """Return a read-only float64 copy of ``values``, for arrays in frozen objects."""
    array = np.array(values, dtype=np.float64, order="C")
    array.setflags(write=False)
    return array
