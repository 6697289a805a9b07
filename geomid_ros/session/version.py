"""The version of this package."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def installed_version() -> str:
    """The version that is installed here."""
    try:
        return version("geomid_ros")
    except PackageNotFoundError:
        return "not installed"
