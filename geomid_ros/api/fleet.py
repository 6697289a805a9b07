"""From the bags of many robots of a type to an estimate of each, and to what they have in common."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from geomid_ros.api.arguments import Config, PathLike, Texts, configuration, description
from geomid_ros.errors import GeomidError
from geomid_ros.fleet.changes import changes
from geomid_ros.fleet.cluster import Cluster
from geomid_ros.fleet.fleet import Fleet, Robot
from geomid_ros.fleet.plan import Plan
from geomid_ros.fleet.recordings import find_bags, on_this_disk
from geomid_ros.fleet.results import RobotResults
from geomid_ros.fleet.store import Store
from geomid_ros.files.models.results import read_estimate
from geomid_ros.report.fleet_page import FleetPage, RobotLine, write_fleet_page
from geomid_ros.session.recordings import Progress, Topics, silent

_KEPT = "kept"


@dataclass(frozen=True, eq=False, kw_only=True)
class FleetIdentification:
    """What was identified of a fleet.

    Attributes:
        lines: a line for every robot.
        bad: bags that could not be used, with why, in sentences.
        doubtful: bags that were left out, or make their robot doubtful, with what seems to be wrong with them.
        files: that were written.
    """

    lines: Sequence[RobotLine]
    bad: Sequence[tuple[str, str]]
    doubtful: Sequence[tuple[str, str]]
    files: Sequence[Path]


def identify_fleet(
    bags: str,
    urdf: PathLike | None = None,
    *,
    out: PathLike,
    by: str = "robot",
    scheduler: str | None = None,
    keep: str | None = None,
    since: PathLike | None = None,
    config: Config | None = None,
    xacro_args: Texts = (),
    floating_base: bool = False,
    wrench: Texts = (),
    joint_topic: str = "joint_states",
    odom_topic: str = "odom",
    hold_out: float | None = None,
    progress: Progress = silent,
) -> FleetIdentification:
    """Identify many robots of a type from many bags.

    ``geomid fleet`` calls this; its options have the same names.

    Args:
        bags: a folder with a folder of bags for each robot, a pattern, or a table (.csv) with the columns ``robot`` and
            ``bag``; on a disk, or by a URL that fsspec knows.
        urdf: path or text of the robot description; None for what is recorded in the first bag.
        out: folder for results, one for each robot.
        by: the column of the table that names the robot.
        scheduler: address of a Dask scheduler; None for workers on this machine's cores.
        keep: path or URL, which all workers see, of what was done so far; None for a folder in ``out``.
        since: folder of an earlier run, to tell which robots have changed.
        config, xacro_args, floating_base, wrench, joint_topic, odom_topic: as of :func:`geomid_ros.identify`.
        hold_out: share of each bag's time, at the end, to judge on; None for 0.3.
        progress: called with what is being done and the share of it, 0 to 1, that is done.

    Raises:
        InputError: a file, an argument or the cluster cannot be used; what was done so far is kept.
    """
    folder = Path(out)
    found = find_bags(bags, by)
    if urdf is None:
        with on_this_disk(found[0].url) as path:
            robot = description(None, [path])
    else:
        robot = description(urdf, [], xacro_args=xacro_args)
    settings = configuration(config, model=None, floating_base=floating_base, wrench=wrench)
    plan = Plan(
        description=robot.text,
        source=robot.source,
        given=settings.given,
        topics=Topics(joint_topic, odom_topic),
        hold_out=hold_out,
    )
    fleet = Fleet(plan, found, Store(keep or str((folder / _KEPT).absolute())))
    robots = fleet.work(partial(Cluster, scheduler), progress)
    lines = [_written(fleet, robot, folder, None if since is None else Path(since)) for robot in robots]
    bad = [(bag.url, outcome.error) for robot in robots for bag, outcome in robot.bags if outcome.error]
    doubtful = [
        (bag.url, "; ".join(outcome.doubts)) for robot in robots for bag, outcome in robot.bags if outcome.doubts
    ]
    page = FleetPage(lines=lines, bad=bad, doubtful=doubtful)
    write_fleet_page(folder / "fleet.html", page)
    return FleetIdentification(lines=lines, bad=bad, doubtful=doubtful, files=[folder / "fleet.html"])


def _written(fleet: Fleet, robot: Robot, folder: Path, since: Path | None) -> RobotLine:
    """The line of a robot, whose files are written."""
    if not robot.kept:
        return RobotLine(name=robot.name, bags=len(robot.bags), used=0, verdict="no estimate", reasons=(robot.error,))
    results = fleet.results(robot)
    document = results.document
    before = None if since is None else since / robot.name / "estimate.json"
    changed = changes(read_estimate(before), document) if before is not None and before.is_file() else ()
    results.write(folder / robot.name)
    return RobotLine(
        name=robot.name,
        bags=len(robot.bags),
        used=len(robot.used),
        verdict=document["verdict"]["result"],
        reasons=tuple(document["verdict"]["reasons"]),
        changed=tuple(changed),
        mass=sum(link["mass"] for link in document["links"]),
    )
