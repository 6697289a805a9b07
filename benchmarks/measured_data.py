"""Held-out errors on every measured robot: the URDF, effects alone, least squares and geomid, on the same rows.

Reads the recordings in ../shared/data, which are not part of this repository:

    python -m benchmarks.measured_data [SET ...] [--gap] [--paper] [--out after.json] [--before before.json]

A sample moves if its joint is faster than 5 % of that joint's largest speed in the test part. With ``--before`` every
total is printed beside that of an earlier run.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

import geomid_ros
from geomid_ros.checks.verdict import Verdict
from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.starting_point import prior_parameters
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.samples import Samples
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

DATA = Path(__file__).parents[2] / "shared" / "data"
_MOVING = 0.05
PAPER = "geomid, (19)"


@dataclass(frozen=True)
class Case:
    """A robot's recordings: what to train on, and what to test on (other bags, or the last part of the first). The bags
    may name its joints otherwise: ``renamed`` is the beginning of a name in the URDF, and in the bags."""

    urdf: str
    train: tuple[str, ...]
    validate: tuple[str, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)
    gap: bool = True
    renamed: tuple[str, str] = ("", "")

    @property
    def description(self) -> Path:
        """URDF whose joints have the bags' names."""
        given = DATA / self.urdf
        if not any(self.renamed):
            return given
        copy = Path("out/measured_data") / given.name
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_text(given.read_text(encoding="utf-8").replace(*self.renamed), encoding="utf-8")
        return copy


CASES = {
    "ur10": Case("ur10_unisa_rosbag2/ur10.urdf", ("ur10_unisa_rosbag2/ur10_exciting_trajectory",)),
    "airbot": Case("airbot_play/airbot_play.urdf", ("airbot_play/chirp",), ("airbot_play/trapez",)),
    "airbot_loaded": Case("airbot_play/airbot_play.urdf", ("airbot_play/chirp_loaded",)),
    "rokae": Case(
        "rokae_ar5_tilted/AR5-5_07R-W4C4A2.urdf",
        ("rokae_ar5_tilted/real",),
        options={"config": {"gravity": [9.88, -0.165, -0.141]}},
    ),
    "lwr4": Case("kuka_lwr4_hw/kuka_lwr4.urdf", ("kuka_lwr4_hw/measurements_1",), ("kuka_lwr4_hw/measurements_2",)),
    "kr300": Case("kuka_kr300/kr300.urdf", ("kuka_kr300/FF_A", "kuka_kr300/FF_B"), ("kuka_kr300/FF_C",)),
    "med7": Case("kuka_med7/med7.urdf", ("kuka_med7/measurements",)),
    "tx40": Case("staubli_tx40/tx40.urdf", ("staubli_tx40/tx40",)),
    "panda": Case(
        "panda_unisa_rosbag2/panda_nohand.urdf",
        ("panda_unisa_rosbag2/panda_exciting_trajectory",),
        renamed=("panda_joint", "fer_joint"),
    ),
    "go2_air": Case("go2_air/go2.urdf", ("go2_air/traj_0",), gap=False),
    "wrist": Case(
        "wrist_ft_payload/tool.urdf",
        ("wrist_ft_payload/run",),
        options={"floating_base": True, "wrench": "/wrench:tool:external"},
        gap=False,
    ),
    "human": Case(
        "human_forceplate/human_94kg.urdf",
        ("human_forceplate/first_60s",),
        options={
            "floating_base": True,
            "wrench": "/wrench:odom:external",
            "hold_out": 0.25,
            "config": {"filter.cutoff": 3.0},
        },
        gap=False,
    ),
}


@dataclass(frozen=True, eq=False)
class Comparison:
    """RMS on held-out data by method ``(channels,)``; how many links are possible bodies; what geomid says: the verdict
    and the warnings."""

    channels: tuple[str, ...]
    errors: dict[str, FloatArray]
    moving: FloatArray
    possible: dict[str, int]
    estimate: Estimate
    added: tuple[str, ...]
    verdict: Verdict
    warnings: tuple[str, ...]
    seconds: float


def compare(case: Case, paper: bool = False) -> Comparison:
    """Fit every method to the same rows and try it on the same held-out samples; ``paper``: (19) of the paper, too."""
    validate = [DATA / name for name in case.validate]
    bags = [DATA / name for name in case.train]
    begin = time.process_time()
    found = geomid_ros.identify(bags, case.description, validate=validate, **case.options)
    seconds = time.process_time() - begin
    session, test = found.session, Samples.concatenate(list(found.held_out))
    solutions = {
        "URDF": session.model.described_parameters,
        "effects alone": _effects_alone(session),
        "least squares": _least_squares(session, found.train),
        "geomid": np.asarray(found.estimate.predictor.parameters),
    }
    gains = {method: np.ones(len(session.model.channels)) for method in solutions}
    gains["geomid"] = found.estimate.predictor.drive_gains
    left = _left(session, test, solutions, gains)
    errors = {method: _rms(each) for method, each in left.items()}
    if paper:
        solutions[PAPER], errors[PAPER] = _paper(case, bags, validate)
    optional = {(c.effect.name, c.place_name) for c in session.model.coefficients if c.optional}
    return Comparison(
        found.estimate.channels,
        errors,
        _moving(session, test, left["geomid"]),
        {method: _possible(session, parameters) for method, parameters in solutions.items()},
        found.estimate,
        tuple(f"{e.name} {e.joint} {e.value:.4g}" for e in found.effects if (e.name, e.joint) in optional),
        found.verdict,
        tuple(found.warnings),
        seconds,
    )


def _paper(case: Case, bags: list[Path], validate: list[Path]) -> tuple[FloatArray, FloatArray]:
    """Parameters and held-out RMS ``(channels,)`` with the paper's objective."""
    options = {**case.options, "config": {**case.options.get("config", {}), "objective": "geodesic"}}
    found = geomid_ros.identify(bags, case.description, validate=validate, **options)
    predictor = found.estimate.predictor
    return predictor.parameters, found.session.rms([Samples.concatenate(list(found.held_out))], *predictor)


def _columns(session: Session) -> FloatArray:
    """The parameters that are no optional effects."""
    first = len(session.model.nominal_inertias)
    kept = [first + k for k, coefficient in enumerate(session.model.coefficients) if not coefficient.optional]
    return np.array([*range(first), *kept])


def _effects_alone(session: Session) -> FloatArray:
    chosen, parameters = _columns(session), np.zeros(session.model.dimension)
    first = len(session.model.nominal_inertias)
    model = session.model.with_coefficients([int(column) - first for column in chosen[first:]])
    summary = session.identifier.snapshot().with_columns(model.channels, chosen)
    parameters[chosen] = prior_parameters(model, summary, None)
    return parameters


def _least_squares(session: Session, train: tuple[Samples, ...] | Any) -> FloatArray:
    """Plain least squares of the inertias and of the effects that every joint has."""
    chosen, parameters = _columns(session), np.zeros(session.model.dimension)
    rows = session.model.rows(Samples.concatenate(list(train)))
    measured = np.isfinite(rows.targets)
    coefficients = rows.coefficients[measured][:, chosen]
    parameters[chosen] = np.linalg.lstsq(coefficients, rows.targets[measured], rcond=1e-3)[0]
    return parameters


def _left(
    session: Session, test: Samples, solutions: Mapping[str, FloatArray], gains: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """What parameters and gains of drives leave of samples ``(N, channels)``, by method."""
    both = (np.column_stack(list(values.values())) for values in (solutions, gains))
    measured, predicted = session.model.predict(test, *both)
    return dict(zip(solutions, np.moveaxis(measured[:, :, None] - predicted, 2, 0), strict=True))


def _rms(left: FloatArray) -> FloatArray:
    """Of each channel ``(channels,)``."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a joint that never moves has no sample
        return np.sqrt(np.nanmean(left**2, axis=0))


def _moving(session: Session, test: Samples, left: FloatArray) -> FloatArray:
    """RMS of the samples at which the channel's own joint moves ``(channels,)``; of wrenches all."""
    errors = left.copy()
    speed = np.abs(test.velocity)
    slow = speed <= _MOVING * np.max(speed, axis=0)
    if efforts := session.model.layout.efforts:
        errors[:, efforts] = np.where(slow, np.nan, errors[:, efforts])
    return _rms(errors)


def _possible(session: Session, parameters: FloatArray) -> int:
    count = len(session.model.body_names)
    bodies = pseudo_inertia.from_parameters(np.asarray(parameters)[: 10 * count].reshape(count, 10))
    return int(np.count_nonzero(np.linalg.eigvalsh(bodies)[:, 0] > 0.0))


def gap(case: Case) -> dict[str, Any]:
    """The verdict of the gap workflow, what its file leaves of the worst channel, in motion and of all samples, and how
    many times the noise the written model is off, at the worst channel, when it is simulated."""
    options = {name: value for name, value in case.options.items() if name != "config"} | {
        name: case.options[name] for name in ("config",) if name in case.options
    }
    validate = [DATA / name for name in case.validate]
    found = geomid_ros.find_gap([DATA / name for name in case.train], case.description, validate=validate, **options)
    again = [times_noise for simulation in found.simulated for times_noise in simulation.errors["after"].values()]
    return {
        "verdict": found.result.verdict,
        "worst": float(np.nanmax(found.result.moving)),
        "worst of all samples": float(np.nanmax(found.result.gap.after)),
        "confident": [f"{f.effect} {f.joint or f.link}" for f in found.findings if f.confidence == "confident"],
        "names": len(found.findings),
        "simulated again": max(again, default=None),
    }


def main() -> None:
    """Print a table per robot, and one of totals."""
    if not DATA.is_dir():
        sys.exit(f"the measured recordings are not there: {DATA}")
    arguments = _parsed()
    before = json.loads(arguments.before.read_text()) if arguments.before else {}
    kept: dict[str, Any] = {}
    for name in arguments.sets or CASES:
        try:
            found = compare(CASES[name], arguments.paper)
        except GeomidError as error:
            print(f"{name}: refused: {error}\n")
            kept[name] = {"refused": str(error)}
            continue
        _report(name, found)
        kept[name] = {
            "total": float(np.nansum(found.errors["geomid"])),
            "moving": float(np.nansum(found.moving)),
            "paper": float(np.nansum(found.errors[PAPER])) if arguments.paper else None,
            "errors": dict(zip(found.channels, found.errors["geomid"].tolist(), strict=True)),
            "masses": {link.name: link.mass for link in found.estimate.links},
            "added": found.added,
        }
        if arguments.gap and CASES[name].gap:
            kept[name]["gap"] = gap(CASES[name])
            print(f"gap: {kept[name]['gap']}\n")
    _totals(kept, before)
    if arguments.out:
        arguments.out.write_text(json.dumps(kept, indent=2))


def _parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.measured_data", description=__doc__)
    parser.add_argument("sets", nargs="*", metavar="SET", help=f"of {', '.join(CASES)}; all unless given")
    parser.add_argument("--gap", action="store_true", help="run the gap workflow, too")
    parser.add_argument("--paper", action="store_true", help="minimise the paper's (19), too")
    parser.add_argument("--out", type=Path, help="file for the figures (JSON)")
    parser.add_argument("--before", type=Path, help="figures of an earlier run to print beside")
    return parser.parse_args()


def _report(name: str, found: Comparison) -> None:
    table = Table(title=f"{name}: RMS on held-out data", box=box.SIMPLE_HEAD, title_justify="left")
    for heading in ("", *found.channels, "total", "possible links"):
        table.add_column(heading, justify="right", no_wrap=True)
    for method, rms in found.errors.items():
        possible = f"{found.possible[method]} of {len(found.estimate.links)}"
        table.add_row(method, *(f"{value:.3g}" for value in rms), f"{np.nansum(rms):.4g}", possible)
    moving = (f"{value:.3g}" for value in found.moving)
    table.add_row("geomid, moving", *moving, f"{np.nansum(found.moving):.4g}", "")
    Console(width=200).print(table)
    estimate = found.estimate
    masses = ", ".join(f"{link.mass:.3g} ± {link.std_mass:.2g}" for link in estimate.links)
    print(f"gamma {estimate.gamma:.1e}, converged {estimate.converged}, {found.seconds:.1f} processor seconds")
    print(f"masses [kg]: {masses}\neffects that were asked for: {'; '.join(found.added) or 'none'}")
    print("".join(f"{remark}\n" for remark in found.verdict.remarks) or "usable")
    print("".join(f"warning: {warning}\n" for warning in found.warnings))


def _totals(kept: dict[str, Any], before: dict[str, Any]) -> None:
    table = Table(title="Totals", box=box.SIMPLE_HEAD, title_justify="left")
    for heading in ("set", "total", "before", "moving", "before", "effects added"):
        table.add_column(heading, justify="right")
    for name, figures in kept.items():
        old = before.get(name, {})
        cells = [
            f"{value:.4g}" if isinstance(value, float) else "refused" if "refused" in (own or {}) else ""
            for key in ("total", "moving")
            for own in (figures, old)
            for value in (own.get(key),)
        ]
        table.add_row(name, *cells, str(len(figures.get("added", ()))))
    Console(width=200).print(table)


if __name__ == "__main__":
    main()
