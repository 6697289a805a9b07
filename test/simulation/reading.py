"""Bags as a reader other than ours sees them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from files.recordings import recorded


def messages(bag: Path, topic: str) -> list[Any]:
    """All of a topic, in the order of recording."""
    return [item.message for item in recorded(bag) if item.topic == topic]
