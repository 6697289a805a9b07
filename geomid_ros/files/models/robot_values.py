"""What an ``estimate.json`` says of a robot, to be compared with another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.comparison import LinkValues, RobotValues
from geomid_ros.files.models.loaded_model import known_effects, merged_links
from geomid_ros.files.models.results import known_inertias, known_information
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import FloatArray


def robot_values(document: Mapping[str, Any], source: str) -> RobotValues:
    """What a document says.

    Args:
        document: of an ``estimate.json``.
        source: its file, for messages.

    Raises:
        InputError: the document says no such thing.
    """
    inertias, merged = known_inertias(document, source), merged_links(document, source)
    links = {
        str(link["name"]): LinkValues(
            parameters=inertias[str(link["name"])],
            std=_deviations(link, source),
            merged=merged.get(str(link["name"]), frozenset()),
        )
        for link in document["links"]
    }
    return RobotValues(
        links=links,
        effects=tuple(known_effects(document, source)),
        information=known_information(document, inertias, source),
    )


def quantities_entry(entry: Mapping[str, Any]) -> FloatArray:
    """Quantities ``(10,)``, or their standard deviations, of an entry with mass, com and inertia about it. Raises
    KeyError, TypeError or ValueError for what is none."""
    inertia = pseudo_inertia.inertia_entries(np.array(entry["inertia"], dtype=float).reshape(3, 3))
    return np.concatenate([[float(entry["mass"])], np.array(entry["com"], dtype=float).reshape(3), inertia])


def _deviations(link: Mapping[str, Any], source: str) -> FloatArray:
    """Standard deviations ``(10,)`` of a link's quantities, NaN where the file says none."""
    if "std" not in link:
        return np.full(10, np.nan)
    try:
        return quantities_entry(link["std"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{source}: link '{link['name']}' lacks a valid std ({error})") from error
