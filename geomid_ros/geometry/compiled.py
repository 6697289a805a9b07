"""Compiled inner loops of the fits. If the package was built without a compiler, numpy computes the same."""

from __future__ import annotations

from types import ModuleType

native: ModuleType | None
try:
    from geomid_ros.geometry import _native as native
except ImportError:
    native = None
