"""Where the package's own data lie: beside the source tree, or installed under ``share``."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import geomid_ros
from geomid_ros.errors import InputError


def shared_file(relative: str) -> Path:
    """A file or folder that the package ships, such as ``bags/arm7``."""
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    folders = [Path(geomid_ros.__file__).parents[1], *(Path(prefix) / "share/geomid_ros" for prefix in prefixes)]
    for folder in folders:
        if (folder / relative).exists():
            return folder / relative
    raise InputError(f"{relative} is not installed; looked in {', '.join(map(str, folders))}")
