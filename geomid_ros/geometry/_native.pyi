from geomid_ros.types import FloatArray, IntArray

def eigenvectors(matrices: FloatArray, values: FloatArray, vectors: FloatArray, /) -> None: ...
def measure(
    normals: FloatArray,
    offsets: FloatArray,
    polynomial: FloatArray,
    links: int,
    positives: int,
    half_squared: FloatArray,
    status: IntArray,
    /,
) -> None: ...
def project(
    normals: FloatArray,
    offsets: FloatArray,
    polynomial: FloatArray,
    links: int,
    positives: int,
    weights: FloatArray,
    half_squared: FloatArray,
    tangent: FloatArray,
    direction: FloatArray,
    curvature: FloatArray,
    status: IntArray,
    /,
) -> None: ...
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
    widths: IntArray,
    rows: IntArray,
    places: IntArray,
    runs: IntArray,
    ends: IntArray,
    vector: FloatArray,
    counts: FloatArray,
    least: FloatArray,
    squares: FloatArray,
    total: FloatArray,
    /,
) -> None: ...
