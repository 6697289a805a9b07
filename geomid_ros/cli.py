"""The ``geomid`` command."""

from __future__ import annotations

import os


def main() -> None:
    """Entry point of ``geomid``."""
    # The matrices are small: threads of the linear algebra library would only wait for each other. numpy reads this
    # once.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from geomid_ros.commands.root import root  # noqa: PLC0415

    root()
