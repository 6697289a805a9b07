"""Identification of many robots of one type, and of their population."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from geomid_ros.api.robot import check_command_efforts, configuration, description, topics
from geomid_ros.checks.verdict import DOUBTFUL, STATUS, USABLE
from geomid_ros.errors import InputError
from geomid_ros.estimation.population import FEWEST, Population, RobotLikelihood, population_and_members
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.files.models.posterior import write_population
from geomid_ros.fleet.fleet import Cluster, Fleet, FleetRobot
from geomid_ros.fleet.recordings import find_bags, on_this_disk
from geomid_ros.fleet.work import FleetPlan, Store, changes
from geomid_ros.options import takes
from geomid_ros.report.result_pages import FleetPage, RobotLine, write_fleet_page
from geomid_ros.session.options import FleetOptions

_KEPT = "kept"


@dataclass(frozen=True, eq=False, kw_only=True)
class FleetIdentification(FleetPage):
    """Result of a fleet identification.

    Attributes:
        lines: one line for each robot.
        bad: bags that could not be used, each with the reason.
        doubtful: bags that were left out or make their robot doubtful, each with the reason.
        files: the written files.
    """

    files: Sequence[Path]

    @property
    def status(self) -> int:
        """Exit status: success if any robot has a usable result, else that of a doubtful one."""
        return STATUS[USABLE if any(line.verdict == USABLE for line in self.lines) else DOUBTFUL]


@takes(FleetOptions)
def identify_fleet(options: FleetOptions) -> FleetIdentification:
    """Identify many robots of one type from many bags.

    ``geomid fleet`` calls this; its options have the same names. Without a ``scheduler``, a script has to call this
    under ``if __name__ == "__main__":``, as each worker imports the script.

    Raises:
        InputError: a file, an argument or the cluster cannot be used; intermediate results are kept.
    """
    folder = Path(options.out)
    parameters = check_command_efforts(options, configuration(options))
    every = find_bags(options.bags, options.by)
    if options.urdf is None:
        with on_this_disk(every[0].url) as path:
            described = description(options, [path])
    else:
        described = description(options, [])
    plan = FleetPlan(
        description=described.text,
        source=described.source,
        given=parameters.given_values,
        topics=topics(options),
        hold_out=options.hold_out,
    )
    fleet = Fleet(plan, every, Store(options.keep or str((folder / _KEPT).absolute())))
    since = None if options.since is None else Path(options.since)
    if since is not None and not since.is_dir():
        raise InputError(f"since: {since} is not a folder; give the folder of an earlier run, or omit it")
    robots = fleet.work(partial(Cluster, options.scheduler), options.progress)
    files = [folder / "fleet.html"]
    lines, evidence = {}, {}
    for robot in robots:
        lines[robot.name], likelihood = _written(fleet, robot, folder, since)
        if likelihood is not None:
            evidence[robot.name] = likelihood
    if len(evidence) >= FEWEST:
        options.progress("population", 0.0)
        population, members = population_and_members(list(evidence.values()))
        files.append(folder / "population.json")
        write_population(files[-1], population)
        for name, member in zip(evidence, members, strict=True):
            unlike = tuple(_in_words(part, evidence[name], population) for part in member.unlike)
            lines[name] = replace(lines[name], distance=member.distance, unlike=unlike)
    bad = [(bag.url, outcome.error) for robot in robots for bag, outcome in robot.bags if outcome.error]
    doubtful = [
        (bag.url, "; ".join(outcome.doubts)) for robot in robots for bag, outcome in robot.bags if outcome.doubts
    ]
    ordered = sorted(lines.values(), key=lambda line: line.remarkable, reverse=True)
    result = FleetIdentification(lines=ordered, bad=bad, doubtful=doubtful, files=files)
    write_fleet_page(files[0], result)
    return result


def _written(
    fleet: Fleet, robot: FleetRobot, folder: Path, since: Path | None
) -> tuple[RobotLine, RobotLikelihood | None]:
    """Write the files of a robot; return its line, and its evidence about the robot type if its result is usable."""
    if not robot.kept:
        line = RobotLine(name=robot.name, bags=len(robot.bags), used=0, verdict="no estimate", reasons=(robot.error,))
        return line, None
    results = fleet.results(robot)
    estimate = results.estimate
    verdict = estimate.judgement
    before = None if since is None else since / robot.name / "estimate.json"
    changed = changes(EstimateFile.read(before), estimate) if before is not None and before.is_file() else ()
    results.write(folder / robot.name)
    line = RobotLine(
        name=robot.name,
        bags=len(robot.bags),
        used=len(robot.used),
        verdict=verdict.word,
        reasons=verdict.reasons,
        changed=tuple(changed),
        mass=sum(link.mass for link in estimate.links),
    )
    return line, results.evidence if verdict.word == USABLE else None


def _in_words(part: str, robot: RobotLikelihood, population: Population) -> str:
    """Describe how a robot deviates from the population at a ``part``: a link with its mass, or an effect."""
    if part not in robot.links:
        return part.replace("_", " ")
    mass = robot.parameters[10 * robot.links.index(part)]
    population_mass = population.parameters[10 * population.links.index(part)]
    return f"{part}: {mass:.3g} kg, others {population_mass:.3g} kg"
