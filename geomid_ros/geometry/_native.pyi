"""Compiled from ``native/``; its numpy twins document the arguments."""

from typing import Any

def __getattr__(name: str) -> Any: ...
