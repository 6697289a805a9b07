"""From a posterior on disk to robots drawn from it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from geomid_ros.api.export import check_into
from geomid_ros.api.options import PathLike
from geomid_ros.errors import InputError, unknown_name
from geomid_ros.exports.formats import JSON
from geomid_ros.exports.posterior_samples import DrawnRobots, described, draw_robots, ranges_text
from geomid_ros.exports.torque_spread import TorqueSpread, torque_spread
from geomid_ros.files.disk import write_text
from geomid_ros.files.models.readers import DESCRIBED_FOR
from geomid_ros.report.pictures import torque_picture
from geomid_ros.session.recordings import Progress, silent


@dataclass(frozen=True, eq=False, kw_only=True)
class SampledRobots:
    """Robots that were drawn from a posterior.

    Attributes:
        drawn: their parameters, and the estimate that they are from.
        tool: who is to read them.
        into: an MJCF that gets the numbers of each, for mujoco.
        packages: folders of ROS packages, by name.
    """

    drawn: DrawnRobots
    tool: str
    into: Path | None = None
    packages: Mapping[str, Path] = field(default_factory=dict)

    @property
    def texts(self) -> Iterator[tuple[str, str]]:
        """Names and texts of the robots' files."""
        return described(self.drawn, self.tool, self.into, self.packages)

    @property
    def ranges(self) -> str:
        """YAML with the 95 % range of each number; for isaac with the event terms of Isaac Lab."""
        return ranges_text(self.drawn, isaac=self.tool == "isaac")

    @cached_property
    def torques(self) -> TorqueSpread:
        """How much the robots' joint torques differ, beside those of ranges of 20 %."""
        return torque_spread(self.drawn)

    def save(self, folder: PathLike, *, progress: Progress = silent) -> list[Path]:
        """Write the robots, ranges.yaml and torques.png.

        Args:
            folder: made if it does not exist.
            progress: called with what is being done and the share of it, 0 to 1, that is done.

        Returns:
            The files.

        Raises:
            InputError: a file cannot be written.
        """
        out, files = Path(folder), list[Path]()
        for name, text in self.texts:
            files.append(out / name)
            progress("writing robots", len(files) / self.drawn.count)
            write_text(files[-1], text)
        progress("comparing torques", 0.0)
        ranges, picture = out / "ranges.yaml", out / "torques.png"
        write_text(ranges, self.ranges)
        joints = [f"{name} [{unit}]" for name, unit in zip(self.torques.joints, self.torques.units, strict=True)]
        title = f"{self.drawn.count} robots of {self.drawn.model.source}"
        torque_picture(picture, title, joints, self.torques.drawn, self.torques.ranges)
        return [*files, ranges, picture]


def sample(
    model: PathLike,
    tool: str,
    *,
    count: int = 100,
    into: PathLike | None = None,
    spread: float = 1.0,
    seed: int = 0,
    package_path: Mapping[str, Path] | None = None,
) -> SampledRobots:
    """Sample robots from a posterior: links and effects together, as the recording and the prior leave them.

    ``geomid sample`` calls this; its options have the same names, but ``--for`` for ``tool`` and ``-n`` for ``count``.

    Args:
        model: an estimate.json with the identified.urdf and the posterior.npz of the same run beside it.
        tool: who is to read them: urdf, moveit, isaac, gazebo, drake, mujoco or json.
        count: how many robots.
        into: an MJCF that is to get the numbers of each robot, for mujoco.
        spread: factor of all standard deviations.
        seed: the same seed draws the same.
        package_path: folders of ROS packages, by name.

    Raises:
        InputError: the files or arguments cannot be used.
    """
    if tool not in (*DESCRIBED_FOR, JSON):
        raise unknown_name("reader", tool, (*DESCRIBED_FOR, JSON))
    if count < 1 or not spread > 0.0:
        raise InputError(f"count is {count} and spread {spread:g}, expected a count of 1 or more and a positive spread")
    check_into(tool, into)
    drawn = draw_robots(Path(model), count, seed, spread)
    return SampledRobots(drawn=drawn, tool=tool, into=None if into is None else Path(into), packages=package_path or {})
