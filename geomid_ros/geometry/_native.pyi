from geomid_ros.types import FloatArray, IntArray

def straight_lines(base: FloatArray, steps: FloatArray, ends: FloatArray, /) -> None: ...
def second_order(
    basis: FloatArray,
    inertias: FloatArray,
    priors: FloatArray,
    rest: FloatArray,
    prior_rest: FloatArray,
    scales: FloatArray,
    weights: FloatArray,
    slope: FloatArray,
    products: FloatArray,
    gradient: FloatArray,
    information: FloatArray,
    hessian: FloatArray,
    /,
) -> float: ...
def weigh(
    products: FloatArray,
    places: IntArray,
    ends: IntArray,
    vector: FloatArray,
    counts: FloatArray,
    least: FloatArray,
    squares: FloatArray,
    total: FloatArray,
    /,
) -> None: ...
