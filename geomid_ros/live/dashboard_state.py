"""State that the dashboard shows: a node's diagnostics as one JSON document."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from geomid_ros.estimation.uncertain_inertia import interval_of_positive
from geomid_ros.report.result_pages import cannot_tell

State: TypeAlias = dict[str, Any]
_COUNTS = ("received", "accepted", "lost")
_REASONS = ("rejected", "dropped", "noted")
_LEVELS = ("ok", "warning", "error", "stale")
_MOST_ROWS = 500  # of each table, as the publisher of diagnostics decides how many there are


@dataclass(frozen=True)
class Diagnosis:
    """One status of the diagnostics: its ``name``, ``level`` (0 to 3), ``message`` and ``values``."""

    name: str
    level: int
    message: str
    values: Mapping[str, str]


def state_of(node: str, diagnoses: Sequence[Diagnosis]) -> State | None:
    """Return the state of a node.

    Args:
        node: its full name without the leading slash.
        diagnoses: statuses of one message, those of other nodes included.

    Returns:
        ``level`` and ``message`` of its stream, ``links``, ``channels``, ``topics``, ``numbers`` and ``others``
        (statuses that are not of links); None if the node has no stream status.
    """
    states = {item.name.removeprefix(f"{node}: "): item for item in diagnoses if item.name.startswith(f"{node}: ")}
    stream = states.pop("stream", None)
    if stream is None:
        return None
    links = {name: item for name, item in states.items() if "mass" in item.values}
    others = {name: item for name, item in states.items() if name not in links}
    channels, topics, numbers = _grouped(stream.values)
    return {
        "node": node,
        "level": _level(stream),
        "message": stream.message,
        "links": [_link(name, item.values) for name, item in _first(links).items()],
        "channels": [{"name": name, **values} for name, values in _first(channels).items()],
        "topics": [{"name": name, **values} for name, values in _first(topics).items()],
        "numbers": list(_first(numbers).items()),
        "others": [
            {"name": name, "level": _level(item), "message": item.message, "values": list(_first(item.values).items())}
            for name, item in _first(others).items()
        ],
    }


def _first(items: Mapping[str, Any]) -> dict[str, Any]:
    return dict(list(items.items())[:_MOST_ROWS])


def _level(status: Diagnosis) -> str:
    return _LEVELS[min(status.level, len(_LEVELS) - 1)]


def _number(text: str | None) -> float | None:
    """Return a finite number, else None, as JSON has no NaN or infinity."""
    try:
        value = float(text or "nan")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _link(name: str, values: Mapping[str, str]) -> State:
    mass, deviation = _number(values["mass"]), _number(values.get("mass std"))
    ends: tuple[float | None, float | None] = (None, None)
    if mass is not None and mass > 0.0 and deviation is not None and deviation >= 0.0:
        ends = interval_of_positive(mass, deviation)
    return {
        "name": name,
        "mass": mass,
        "std": deviation,
        "low": ends[0],
        "high": ends[1],
        "from_data": _number(values.get("from data")),
        "distance": _number(values.get("distance from prior")),
        "merged": values.get("merged", ""),
        "cannot_tell": cannot_tell([*filter(None, values.get("not identifiable", "").split(", "))]),
    }


def _grouped(values: Mapping[str, str]) -> tuple[dict[str, State], dict[str, State], dict[str, str]]:
    """Group the stream's values by channel, by topic, and those of the stream as a whole."""
    channels: dict[str, State] = {key.removesuffix(" rms"): {} for key in values if key.endswith(" rms")}
    topics: dict[str, State] = {}
    numbers: dict[str, str] = {}
    for key, value in values.items():
        channel, _, kind = key.rpartition(" ")
        topic, _, reason = key.partition(": ")
        topic, _, outcome = topic.rpartition(" ")
        if key.startswith("gap "):
            channels.setdefault(key.removeprefix("gap "), {})["gap"] = _number(value)
        elif channel in channels and kind in ("rms", "sigma"):
            channels.setdefault(channel, {})[kind] = _number(value)
        elif outcome in _REASONS and topic != "rows":
            topics.setdefault(topic, {}).setdefault(outcome, []).append([reason, value])
        elif kind in _COUNTS:
            topics.setdefault(channel, {})[kind] = value
        else:
            numbers[key] = value
    return channels, topics, numbers
