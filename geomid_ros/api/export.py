"""Export of a model on disk to the formats of other software, and of robots sampled from its posterior."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

from geomid_ros.api.robot import entries
from geomid_ros.errors import InputError, check_name
from geomid_ros.exports.descriptions import DESCRIPTIONS, described, patch_user_mjcf
from geomid_ros.exports.formats import CONTROLLERS, JSON, Export
from geomid_ros.exports.model import ExportModel, read_model
from geomid_ros.exports.payload import attached, difference, each_link, sum_of_links
from geomid_ros.exports.posterior_samples import (
    DrawnRobots,
    TorqueSpread,
    descriptions_of,
    ranges_text,
    sample_robots,
    torque_spread,
)
from geomid_ros.files.disk import write_text
from geomid_ros.files.models.readers import DESCRIBED_FOR, EXISTING_MJCF, MUJOCO
from geomid_ros.options import Progress, silent, takes
from geomid_ros.report.pictures import torque_picture
from geomid_ros.session.options import ExportOptions, PathLike, SampleOptions, Texts


class Exported(NamedTuple):
    """The ``text`` for the other software, ``notes`` on what it omits and ``doubts`` about the models, in sentences."""

    text: str
    notes: tuple[str, ...]
    doubts: tuple[str, ...]


@takes(ExportOptions)
def export(options: ExportOptions) -> Exported:
    """Convert an estimate for other software: a robot description, or the payload at a flange.

    ``geomid export`` calls this; its options have the same names, but ``--for`` for ``tool``. Without ``frame``, the
    whole robot is exported.

    Raises:
        InputError: the files or arguments cannot be used, the data do not identify what is requested, or a model is
            doubtful and ``force`` is not given.
    """
    _check(options)
    tool = options.tool
    reader = "" if tool in CONTROLLERS else tool if options.into is None else EXISTING_MJCF
    own = read_model(Path(options.model), reader)
    reference = None if options.without is None else read_model(Path(options.without))
    doubts = tuple(each.warning for each in (own, reference) if each is not None and each.warning)
    if doubts and not options.force:
        raise InputError(f"{doubts[0]}; fix this, or export anyway with --force")
    if tool in CONTROLLERS:
        flange = options.frame or _flange(own, CONTROLLERS[tool].flange)
        return Exported(CONTROLLERS[tool].commands(_payload(own, flange, options.links, reference)), (), doubts)
    if options.frame:
        return Exported(DESCRIPTIONS[tool].payload(_payload(own, options.frame, options.links, reference)), (), doubts)
    if options.into is not None:
        result = patch_user_mjcf(own, Path(options.into))
    else:
        result = described(own, tool, each_link(own), options.package_path or {})
    return Exported(result.text, tuple(result.omissions), doubts)


def check_into(tool: str, into: PathLike | None) -> None:
    """Refuse an MJCF if the software is not MuJoCo. Raises InputError."""
    if into is not None and tool != MUJOCO:
        raise InputError(f"into is a file of MuJoCo's: it goes with {MUJOCO} (--for {MUJOCO}), not with {tool}")


def _check(options: ExportOptions) -> None:
    """Refuse inconsistent options. Raises InputError."""
    tool, is_payload = options.tool, options.links is not None or options.without is not None
    check_name("reader", tool, (*CONTROLLERS, *DESCRIPTIONS))
    check_into(tool, options.into)
    if options.into is not None and options.frame:
        raise InputError("into and frame exclude each other: a payload is printed alone; leave one out")
    if options.links is not None and options.without is not None:
        raise InputError("links and without exclude each other: a payload is either these links or a difference")
    if tool not in CONTROLLERS and not options.frame and is_payload:
        raise InputError("frame is missing: name the link in whose axes the payload is expressed")


def _payload(model: ExportModel, frame: str, links: Texts | None, reference: ExportModel | None) -> Export:
    if reference is not None:
        return difference(model, reference, frame)
    return attached(model, frame) if links is None else sum_of_links(model, entries("links", links), frame)


def _flange(model: ExportModel, ending: str) -> str:
    """Return the one link whose name ends like the flange of the manufacturer's URDF, with any prefix."""
    matches = [link for link in model.tree.links if link.endswith(ending)]
    if len(matches) != 1:
        candidates = ", ".join(matches or model.tree.links)
        raise InputError(f"{model.source}: which link is the flange? Name it with --frame: {candidates}")
    return matches[0]


@dataclass(frozen=True, eq=False)
class SampledRobots:
    """Robots sampled from a posterior.

    Attributes:
        drawn: their parameters, and the estimate that they are sampled from.
        options: which software will read them, and in which form.
    """

    drawn: DrawnRobots
    options: SampleOptions

    @property
    def texts(self) -> Iterator[tuple[str, str]]:
        """Names and texts of the robots' files."""
        into = None if self.options.into is None else Path(self.options.into)
        return descriptions_of(self.drawn, self.options.tool, into, self.options.package_path or {})

    @property
    def ranges(self) -> str:
        """YAML with the 95 % range of each number; for isaac with the event terms of Isaac Lab."""
        return ranges_text(self.drawn, isaac=self.options.tool == "isaac")

    @cached_property
    def torques(self) -> TorqueSpread:
        """Variation of joint torques among the robots, compared with that of uniform ranges of 20 %."""
        return torque_spread(self.drawn)

    def save(self, folder: PathLike, *, progress: Progress = silent) -> list[Path]:
        """Write the robots, ranges.yaml and torques.png.

        Args:
            folder: created if it does not exist.
            progress: called with the current stage and its completed fraction, 0 to 1.

        Returns:
            The files.

        Raises:
            GeomidError: a file cannot be written.
        """
        out, files = Path(folder), list[Path]()
        for name, text in self.texts:
            files.append(out / name)
            progress("writing robots", min(len(files) / self.drawn.count, 1.0))
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
    """Sample robots from a posterior: links and effects jointly, given the recording and the prior.

    ``geomid sample`` calls this; its options have the same names, but ``--for`` for ``tool`` and ``-n`` for ``count``.

    Raises:
        InputError: the files or arguments cannot be used.
    """
    check_name("reader", options.tool, (*DESCRIBED_FOR, JSON))
    check_into(options.tool, options.into)
    return SampledRobots(sample_robots(Path(options.model), options.count, options.seed, options.spread), options)
