"""Compiled inner loops of the fits. If the package was built without a compiler, numpy computes the same."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

try:
    native: ModuleType | None = import_module("geomid_ros.geometry._native")
except ImportError:
    native = None
