"""From two results of one robot to what differs between them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Unpack

from geomid_ros.api.compared_files import (
    Result,
    check_same_robot,
    joined,
    judged_on,
    notes_on,
    own_errors,
    read_side,
    urdf_values,
)
from geomid_ros.api.options import PathLike, Paths, RobotKeywords, paths
from geomid_ros.checks.verdict import DOUBTFUL, STATUS, USABLE
from geomid_ros.errors import InputError
from geomid_ros.estimation.comparison import Difference, compared
from geomid_ros.files.models.sidecar import quantities_entry, quantity_entry
from geomid_ros.files.schema import plain
from geomid_ros.report.comparison_page import ComparisonPage, write_comparison_page
from geomid_ros.session.recordings import Progress, silent

_OWN = "what each held out of its own recording"


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison(ComparisonPage):
    """Two results of one robot side by side.

    Attributes:
        first, second: the files.
        compared: all numbers, and the links that have changed.
        errors: what both leave unexplained, by channel.
        judged_on: what these errors are of.
        doubts: why a result or the recording is not to be believed, in sentences.
        notes: what is worth knowing, in sentences.
        status: the exit status: that of the worse verdict of the two.
    """

    status: int

    @property
    def differing(self) -> list[Difference]:
        """The numbers that differ by more than their joint 95 % intervals, the surest first."""
        return self.compared.differing

    @property
    def document(self) -> dict[str, Any]:
        """All of it for programs."""
        return {
            "first": self.first,
            "second": self.second,
            "differences": [_entry(difference) for difference in self.compared.differences],
            "changed_links": [
                {
                    "link": link.link,
                    "mass": quantity_entry(link.mass),
                    "moment": quantities_entry(link.moment),
                    "gain": link.gain,
                    "rivals": list(link.rivals),
                }
                for link in self.compared.changed
            ],
            "not_compared": list(self.compared.not_compared),
            "judged_on": self.judged_on,
            "errors": [
                {"channel": e.name, "unit": e.unit, "first": plain(e.first), "second": plain(e.second)}
                for e in self.errors
            ],
            "doubts": list(self.doubts),
            "notes": list(self.notes),
        }

    def report(self, path: PathLike) -> Path:
        """Write everything on one HTML page that needs no network.

        Args:
            path: the file.

        Returns:
            The same path.

        Raises:
            InputError: the file cannot be written.
        """
        write_comparison_page(Path(path), self)
        return Path(path)

    def __repr__(self) -> str:
        """What differs, a line each."""
        found = [*(link.sentence for link in self.compared.changed), *(each.sentence for each in self.differing)]
        heading = f"{self.first} and {self.second}: {len(found) or 'nothing'} beyond chance"
        return "\n".join([*self.doubts, heading, *(f"  {sentence}" for sentence in found)])


def compare(
    first: PathLike,
    second: PathLike,
    *,
    urdf: PathLike | None = None,
    bag: Paths = (),
    progress: Progress = silent,
    **options: Unpack[RobotKeywords],
) -> Comparison:
    """Compare two results of one robot, or a result and a URDF.

    ``geomid compare`` calls this; its options have the same names.

    Args:
        first, second: each an estimate.json or a URDF, one of them an estimate.json.
        urdf: path or text of the robot description that results were identified from; None for the identified.urdf
            beside each.
        bag: rosbag folders, or .mcap and .db3 files, which both are to predict; without any, each is judged by the
            held-out data of its own recording.
        progress: called with what is being done and the share of it, 0 to 1, that is done.
        options: how the bags are read, see :class:`~geomid_ros.RobotOptions`.

    Raises:
        InputError: a file cannot be used, or they are of different robots.
    """
    sides = [read_side(Path(path)) for path in (first, second)]
    results = [side for side in sides if isinstance(side, Result)]
    if not results:
        raise InputError(f"{first}, {second}: neither is an estimate.json, so that nothing says how sure a number is")
    values = [side.values if isinstance(side, Result) else urdf_values(side, results[0]) for side in sides]
    check_same_robot(sides, values)
    doubts = [f"{result.path}: {remark}" for result in results for remark in result.file.judgement.remarks]
    status = max(result.file.judgement.status for result in results)
    errors, data = own_errors(sides), _OWN
    if bag:
        predicted = [judged_on(side, urdf, bag, options, progress) for side in sides]
        errors, data = joined([each.errors for each in predicted]), ", ".join(map(str, paths(bag)))
        more = [sentence for each in predicted for sentence in each.doubts]
        doubts, status = [*doubts, *more], max(status, STATUS[DOUBTFUL if more else USABLE])
    return Comparison(
        first=str(first),
        second=str(second),
        compared=compared(values[0], values[1]),
        errors=errors,
        judged_on=data,
        doubts=list(dict.fromkeys(doubts)),
        notes=notes_on(results, own_data=not bag),
        status=status,
    )


def _entry(difference: Difference) -> dict[str, Any]:
    values = {"first": difference.first, "second": difference.second}
    return {
        "place": difference.place,
        "effect": difference.effect,
        "parameter": difference.parameter,
        **{key: None if value is None else quantity_entry(value) for key, value in values.items()},
        "joint_interval": plain(difference.half_width),
        "differs": difference.differs,
    }
