"""What of a robot has changed between two estimates."""

from __future__ import annotations

from geomid_ros.estimation.comparison import compared
from geomid_ros.files.models.estimate_file import EstimateFile

_CHANCE = 1e-4  # a fleet has many robots: of any of one robot's numbers, if none has changed


def changes(before: EstimateFile, after: EstimateFile) -> list[str]:
    """The links that have changed, and the numbers of links and effects that differ by more than their standard
    deviations explain, in words, the surest first.

    What both estimates took from the same prior counts as uncertain twice: little data tell no change.

    Args:
        before, after: of one robot.

    Raises:
        InputError: a file says what cannot be.
    """
    found = compared(before.values, after.values, _CHANCE)
    return [*(link.sentence for link in found.changed), *(number.sentence for number in found.differing)]
