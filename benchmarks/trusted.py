"""What is called identified, against planted truths: half of the robots rub and measure as the model does not know.

    python -m benchmarks.trusted [--seeds 40] [--no-shared] [--out trusted.json]

Prints how many of the masses, first moments and inertias that are called identified are off by more than 20 %, and
which masses are called identified on the measured robots in ../shared/data, which are not part of this repository.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

import geomid_ros
from benchmarks.blind.case import robot_file
from benchmarks.measured_data import CASES, DATA
from geomid_ros.api.identify import Identification
from geomid_ros.checks.verdict import USABLE
from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import QUANTITIES, LinkEstimate, quantities_and_moments, sizes
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.simulation.description import WRIST_FRAME, robot_description
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.recording import simulate
from geomid_ros.types import FloatArray

WRONG = 0.2
_ROBOTS = (("arm7", WRIST_FRAME), ("arm7", None), ("arm3", WRIST_FRAME), ("ur5_joint_limited_robot.urdf", None))
_ERRORS = (0.2, 0.4, 0.6)  # of the URDF's inertias, where the simulation does not draw them
_NAMES = (*QUANTITIES, *(f"first moment {axis}" for axis in "xyz"))
_SLOWER = 0.6
_ATTEMPTS = 4


@dataclass(frozen=True)
class Number:
    """A number of a link of a robot: its error relative to its size, and whether it is called identified by a result
    that is called usable."""

    seed: int
    realistic: bool
    robot: str
    link: str
    name: str
    error: float
    identified: bool
    usable: bool


def drawn(seed: int) -> SimulationOptions:
    """The recording of a seed: odd ones of realistic robots, whose friction the model lacks."""
    rng = np.random.default_rng([seed, 31])
    robot, frame = _ROBOTS[seed // 2 % len(_ROBOTS)]
    options = SimulationOptions(
        robot=robot_file(robot),
        seed=seed,
        motion_seed=300_000 + seed,
        realistic=seed % 2 == 1,
        duration=25.0,
        wrench_frame=frame,
        motion=str(rng.choice(["sines", "aperiodic"])),
        motion_range=rng.uniform(0.4, 0.8),
        motion_speed=rng.uniform(0.3, 0.7),
    )
    return options if options.realistic else replace(options, inertia_error=float(rng.choice(_ERRORS)))


def judged(seed: int) -> Iterator[Number]:
    """The numbers of a seed's links."""
    options = drawn(seed)
    with tempfile.TemporaryDirectory(prefix="trusted-") as folder:
        bag = Path(folder) / "bag"
        for attempt in range(_ATTEMPTS):
            try:  # motions that the drives cannot follow are tried again, slower
                simulate(bag, options)
                break
            except GeomidError:
                if attempt + 1 == _ATTEMPTS:
                    raise
                options = replace(options, motion_speed=_SLOWER * options.motion_speed)
        wrench = f"/wrench:{options.wrench_frame}:mounted" if options.wrench_frame else ()
        found = geomid_ros.identify(bag, robot_description(options.robot), wrench=wrench)
        truth = json.loads(bag.with_name("bag.truth.json").read_text())["links"]
    bodies = {link["name"]: _parameters(link) for link in truth}
    for link in found.links:
        parts = [part for part in (link.name, *link.merged) if part in bodies]
        true = _sum([(bodies[part], found.session.robot.fixed_placement(part, link.name)) for part in parts])
        errors = np.abs(quantities_and_moments(link.parameters) - quantities_and_moments(true)) / sizes(true)
        for name, error, known in zip(_NAMES, errors.tolist(), _known(link), strict=True):
            usable = found.verdict.word == USABLE
            yield Number(seed, options.realistic, options.robot, link.name, name, error, known, usable)


def _known(link: LinkEstimate) -> list[bool]:
    moments = (axis in link.moments for axis in "xyz")
    return [*(name in link.identified for name in QUANTITIES), *moments]


def _parameters(link: dict[str, object]) -> FloatArray:
    mass, com, inertia = (np.array(link[name], dtype=float) for name in ("mass", "com", "inertia"))
    return pseudo_inertia.assemble(mass, com, inertia.reshape(3, 3))


def _sum(parts: list[tuple[FloatArray, FloatArray]]) -> FloatArray:
    """The parameters of bodies ``(10,)``, each with its placement ``(4, 4)``, together."""
    moved = [placement @ pseudo_inertia.from_parameters(body) @ placement.T for body, placement in parts]
    return pseudo_inertia.to_parameters(np.sum(moved, axis=0))


def _report(found: list[Number]) -> None:
    table = Table(title="Called identified, and off by more than 20 %", box=box.SIMPLE_HEAD, title_justify="left")
    for heading in ("robots", "numbers", "of all", "identified", "off", "share"):
        table.add_column(heading, justify="left" if heading in ("robots", "numbers") else "right")
    kinds = {"friction as modelled": [False], "realistic": [True], "all": [False, True]}
    groups = {"mass": "mass", "first moment": "first", "centre of mass": "com", "inertia": "I"}
    for robots, chosen in kinds.items():
        for group, start in groups.items():
            own = [n for n in found if n.realistic in chosen and n.name.startswith(start)]
            known = [n for n in own if n.identified and n.usable]
            off = [n for n in known if n.error > WRONG]
            share = f"{100.0 * len(off) / len(known):.1f} %" if known else ""
            table.add_row(robots, group, str(len(own)), str(len(known)), str(len(off)), share)
    Console(width=100).print(table)
    for n in found:
        if n.name == "mass" and n.identified and n.usable and n.error > WRONG:
            print(f"seed {n.seed}, {Path(n.robot).stem}, {n.link}: mass off by {100 * n.error:.0f} %")


def _shared() -> None:
    for name, case in CASES.items():
        bags, validate = [DATA / bag for bag in case.train], [DATA / bag for bag in case.validate]
        found = geomid_ros.identify(bags, case.description, validate=validate, **case.options)
        print(f"{name}: {_said(found)}", flush=True)


def _said(found: Identification) -> str:
    masses = [f"{link.name} {link.mass:.3g} ± {link.std_mass:.2g}" for link in found.links if _known(link)[0]]
    reasons = f" ({'; '.join(found.verdict.reasons)})" if found.verdict.reasons else ""
    return f"{found.verdict.word}{reasons}; masses identified [kg]: {', '.join(masses) or 'none'}"


def main() -> None:
    """Print both."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.trusted", description=__doc__)
    parser.add_argument("--seeds", type=int, default=40, help="how many robots")
    parser.add_argument("--no-shared", action="store_true", help="simulated robots alone")
    parser.add_argument("--out", type=Path, help="file for every number (JSON)")
    arguments = parser.parse_args()
    found: list[Number] = []
    for seed in range(arguments.seeds):
        try:
            found += judged(seed)
        except GeomidError as error:
            print(f"seed {seed}: {error}")
    _report(found)
    if arguments.out:
        arguments.out.write_text(json.dumps([asdict(number) for number in found], indent=1))
    if DATA.is_dir() and not arguments.no_shared:
        _shared()


if __name__ == "__main__":
    main()
