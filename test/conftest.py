"""For all tests."""

import os

import pytest

# As the commands and the node do: threads of the linear algebra library would only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the kernels once, before every worker would for itself."""
    if session.config.getoption("numprocesses", None):
        import numpy as np  # noqa: PLC0415

        from geomid_ros.estimation.rows import solve_rows  # noqa: PLC0415

        solve_rows(np.eye(1, 10), np.array([2.5]), np.array(0.1), np.array([[2.0, 0, 0, 0, 1, 0, 1, 0, 0, 1]]))
