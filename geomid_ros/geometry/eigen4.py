"""Eigendecomposition of one symmetric 4x4 matrix by cyclic Jacobi rotations, compiled.

Small matrices in a compiled loop cost less this way than a LAPACK call each, and the loop runs without the GIL.
"""

from __future__ import annotations

import math

import numba

from geomid_ros.types import FloatArray

_MAX_SWEEPS = 12


@numba.njit(cache=True, nogil=True)
def jacobi_eigh(a: FloatArray, v: FloatArray) -> None:
    """Diagonalise ``a (4, 4)`` in place; ``v (4, 4)`` receives the eigenvectors as columns.

    Golub & Van Loan, "Matrix Computations", section 8.5: quadratic convergence, eigenvalues to rounding relative to
    the matrix's norm. Only the upper triangle of ``a`` is read; on return its diagonal holds the eigenvalues.
    """
    scale = 0.0
    for i in range(4):
        for j in range(4):
            v[i, j] = 1.0 if i == j else 0.0
        for j in range(i, 4):
            scale += a[i, j] * a[i, j]
    for _ in range(_MAX_SWEEPS):
        off = 0.0
        for i in range(3):
            for j in range(i + 1, 4):
                off += a[i, j] * a[i, j]
        if off <= 1e-32 * scale:
            return
        for p in range(3):
            for q in range(p + 1, 4):
                apq = a[p, q]
                if apq == 0.0:
                    continue
                theta = 0.5 * (a[q, q] - a[p, p]) / apq
                t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                a[p, p] -= t * apq
                a[q, q] += t * apq
                a[p, q] = 0.0
                for k in range(4):
                    if k != p and k != q:
                        kp_row, kp_col = (k, p) if k < p else (p, k)
                        kq_row, kq_col = (k, q) if k < q else (q, k)
                        akp = a[kp_row, kp_col]
                        akq = a[kq_row, kq_col]
                        a[kp_row, kp_col] = c * akp - s * akq
                        a[kq_row, kq_col] = s * akp + c * akq
                    vkp = v[k, p]
                    vkq = v[k, q]
                    v[k, p] = c * vkp - s * vkq
                    v[k, q] = s * vkp + c * vkq
