"""From a posterior on disk to robots drawn from it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from geomid_ros.api.export import check_into
from geomid_ros.api.options import SampleOptions
from geomid_ros.errors import unknown_name
from geomid_ros.exports.formats import JSON
from geomid_ros.exports.posterior_samples import DrawnRobots, described, draw_robots, ranges_text
from geomid_ros.exports.torque_spread import TorqueSpread, torque_spread
from geomid_ros.files.disk import write_text
from geomid_ros.files.models.readers import DESCRIBED_FOR
from geomid_ros.options import Progress, silent, takes
from geomid_ros.report.pictures import torque_picture
from geomid_ros.session.options import PathLike


@dataclass(frozen=True, eq=False)
class SampledRobots:
    """Robots that were drawn from a posterior.

    Attributes:
        drawn: their parameters, and the estimate that they are from.
        options: who is to read them, and as what.
    """

    drawn: DrawnRobots
    options: SampleOptions

    @property
    def texts(self) -> Iterator[tuple[str, str]]:
        """Names and texts of the robots' files."""
        into = None if self.options.into is None else Path(self.options.into)
        return described(self.drawn, self.options.tool, into, self.options.package_path or {})

    @property
    def ranges(self) -> str:
        """YAML with the 95 % range of each number; for isaac with the event terms of Isaac Lab."""
        return ranges_text(self.drawn, isaac=self.options.tool == "isaac")

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


@takes(SampleOptions)
def sample(options: SampleOptions) -> SampledRobots:
    """Sample robots from a posterior: links and effects together, as the recording and the prior leave them.

    ``geomid sample`` calls this; its options have the same names, but ``--for`` for ``tool`` and ``-n`` for ``count``.

    Raises:
        InputError: the files or arguments cannot be used.
    """
    if options.tool not in (*DESCRIBED_FOR, JSON):
        raise unknown_name("reader", options.tool, (*DESCRIBED_FOR, JSON))
    check_into(options.tool, options.into)
    return SampledRobots(draw_robots(Path(options.model), options.count, options.seed, options.spread), options)
