"""What of a robot has changed between two estimates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from geomid_ros.estimation.comparison import compared
from geomid_ros.files.models.robot_values import robot_values

_CHANCE = 1e-4  # a fleet has many robots: of any of one robot's numbers, if none has changed


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """The links that have changed, and the numbers of links and effects that differ by more than their standard
    deviations explain, in words, the surest first.

    What both estimates took from the same prior counts as uncertain twice: little data tell no change.

    Args:
        before, after: documents of ``estimate.json`` of one robot.

    Raises:
        InputError: a document is none.
    """
    pair = robot_values(before, "the earlier estimate"), robot_values(after, "the new estimate")
    found = compared(*pair, _CHANCE)
    return [*(link.sentence for link in found.changed), *(number.sentence for number in found.differing)]
