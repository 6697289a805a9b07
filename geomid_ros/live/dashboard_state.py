"""What the dashboard shows: a node's diagnostics as one JSON document."""

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
_MOST_ROWS = 500  # of each table: whoever may publish diagnostics decides how many there are


@dataclass(frozen=True)
class Diagnosis:
    """One status of the diagnostics: its ``name``, ``level`` (0 to 3), ``message`` and ``values``."""

    name: str
    level: int
    message: str
    values: Mapping[str, str]


def state_of(node: str, diagnoses: Sequence[Diagnosis]) -> State | None:
    """The state of a node.

    Args:
        node: its full name without the leading slash.
        diagnoses: all that came at once, of other nodes, too.

    Returns:
        ``level`` and ``message`` of its stream, ``links``, ``channels``, ``topics``, ``numbers`` and ``others``
        (statuses that are of no link); None if there is no stream of this node.
    """
    own = {one.name.removeprefix(f"{node}: "): one for one in diagnoses if one.name.startswith(f"{node}: ")}
    stream = own.pop("stream", None)
    if stream is None:
        return None
    links = {name: one for name, one in own.items() if "mass" in one.values}
    others = {name: one for name, one in own.items() if name not in links}
    channels, topics, numbers = _sorted_out(stream.values)
    return {
        "node": node,
        "level": _level(stream),
        "message": stream.message,
        "links": [_link(name, one.values) for name, one in _first(links).items()],
        "channels": [{"name": name, **values} for name, values in _first(channels).items()],
        "topics": [{"name": name, **values} for name, values in _first(topics).items()],
        "numbers": list(_first(numbers).items()),
        "others": [
            {"name": name, "level": _level(one), "message": one.message, "values": list(_first(one.values).items())}
            for name, one in _first(others).items()
        ],
    }


def _first(items: Mapping[str, Any]) -> dict[str, Any]:
    return dict(list(items.items())[:_MOST_ROWS])


def _level(one: Diagnosis) -> str:
    return _LEVELS[min(one.level, len(_LEVELS) - 1)]


def _number(text: str | None) -> float | None:
    """A finite number, else None: JSON has no others."""
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
        "cannot_tell": cannot_tell([*filter(None, values.get("cannot be told", "").split(", "))]),
    }


def _sorted_out(values: Mapping[str, str]) -> tuple[dict[str, State], dict[str, State], dict[str, str]]:
    """The stream's values by channel, by topic, and those of the stream as a whole."""
    channels: dict[str, State] = {key.removesuffix(" rms"): {} for key in values if key.endswith(" rms")}
    topics: dict[str, State] = {}
    numbers: dict[str, str] = {}
    for key, value in values.items():
        channel, _, what = key.rpartition(" ")
        topic, _, reason = key.partition(": ")
        topic, _, how = topic.rpartition(" ")
        if key.startswith("gap "):
            channels.setdefault(key.removeprefix("gap "), {})["gap"] = _number(value)
        elif channel in channels and what in ("rms", "sigma"):
            channels.setdefault(channel, {})[what] = _number(value)
        elif how in _REASONS and topic != "rows":
            topics.setdefault(topic, {}).setdefault(how, []).append([reason, value])
        elif what in _COUNTS:
            topics.setdefault(channel, {})[what] = value
        else:
            numbers[key] = value
    return channels, topics, numbers
