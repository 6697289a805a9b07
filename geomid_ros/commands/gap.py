"""``geomid gap``: where simulation and measurement disagree, which effect that is, and the model with it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import numpy as np

from geomid_ros.commands.gap_simulation import position_units, simulate_again
from geomid_ros.commands.gap_tables import print_gap
from geomid_ros.commands.options import URDF, configured, held_out_share, recording_options
from geomid_ros.commands.progress import staged, tracked
from geomid_ros.errors import InputError
from geomid_ros.files.models.gap_model import model_files, write_model
from geomid_ros.files.models.gap_results import gap_document, write_gap
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.gap.result import GapResult
from geomid_ros.model.effects import ModelEffect
from geomid_ros.model.samples import Samples
from geomid_ros.report.gap_page import GapPage, SimulatedAgain, write_gap_page
from geomid_ros.session.gap import find, gap_session
from geomid_ros.session.gap_recordings import Bags, Reader, Recordings
from geomid_ros.session.recordings import Topics
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

Progress = Callable[[str, float], None]


@click.command()
@click.argument("bags", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--urdf", **(URDF | {"help": "The robot's description.  [default: identified.urdf beside --model]"}))
@recording_options
@click.option(
    "--simulated",
    multiple=True,
    type=click.Path(path_type=Path),
    help="What your simulator did under the commands of a bag; one for each of BAGS, in their order.",
)
@click.option("--command", help="Topic of the joints' set-points (JointState), to simulate in closed loop.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("geomid_gap"),
    show_default=True,
    help="Folder for results.",
)
@click.option("--json", "as_json", is_flag=True, help="Print gap.json instead of tables.")
def gap(
    bags: tuple[Path, ...],
    urdf: Path | None,
    config: Path | None,
    model: Path | None,
    floating_base: bool,
    wrench: tuple[str, ...],
    joint_topic: str,
    odom_topic: str,
    hold_out: float | None,
    validate: tuple[Path, ...],
    simulated: tuple[Path, ...],
    command: str | None,
    out: Path,
    as_json: bool,
) -> None:
    """Find what a simulation lacks.

    Compares BAGS (folders, or .mcap and .db3 files) with the model of --urdf or --model, names the missing effect, adds
    it to the model and shows how much of the gap that closes on data that were held out. Writes gap.json, report.html,
    and the model: estimate.json, identified.urdf, identified.xml (MJCF) and effects.yaml.
    """
    urdf = urdf or _urdf_beside(model)
    configuration = configured(config, model, floating_base, wrench)
    session = gap_session(read_urdf(urdf), configuration, str(urdf))
    reader = Reader(session, Topics(joint_topic, odom_topic), tracked)
    chosen = Bags(bags, held_out_share(hold_out, validate), validate, simulated)
    recordings = reader.read(chosen)
    sharp = reader.sharp(chosen)
    commands = reader.sharp(chosen, command) if command else []
    with staged() as progress:
        result = _find(session, recordings, bags, progress)
        known = session.loaded.refitted(session.model, result.coefficients, result.beside)
        files = _write(out, session, result.inertias, [*known.beside_inertias, *result.findings])
        progress("simulating again", 0.0)
        again, why_not = _simulate_again(session, result, sharp, commands, recordings.cutoff)
        document = gap_document(result, {simulation.kind: simulation.errors for simulation in again})
        write_gap(out / "gap.json", document)
        page = _page(session, result, recordings, [*bags, *validate], again, why_not)
        write_gap_page(out / "report.html", page, lambda share: progress("drawing", share))
    if as_json:
        click.echo(json.dumps(document, indent=2))
    else:
        print_gap(result, again, why_not)
        click.echo(f"\nWritten: {', '.join(map(str, [out / 'report.html', out / 'gap.json', *files]))}")


def _urdf_beside(model: Path | None) -> Path:
    if model is None:
        raise click.UsageError("Missing option '--urdf', or '--model' with identified.urdf beside it.")
    beside = model.parent / "identified.urdf"
    if not beside.is_file():
        raise InputError(f"{model}: there is no identified.urdf beside it; give the robot's description with --urdf")
    return beside


def _find(session: Session, recordings: Recordings, bags: Sequence[Path], progress: Progress) -> GapResult:
    try:
        return find(session, recordings.train, recordings.held_out, recordings.cutoff, progress, recordings.simulated)
    except InputError as error:
        raise InputError(f"{', '.join(map(str, bags))}: {error}") from error


def _nominal_inertias(session: Session) -> FloatArray:
    """Of the identified bodies ``(bodies, 10)``: those of the earlier estimate, or of the URDF where it has none."""
    nominal = session.model.nominal_inertias
    known = nominal if session.prior is None else session.prior[: len(nominal)]
    return np.where(np.isfinite(known), known, nominal).reshape(-1, 10)


def _write(folder: Path, session: Session, inertias: FloatArray, effects: Sequence[ModelEffect]) -> list[Path]:
    by_name = dict(zip(session.model.body_names, inertias, strict=True))
    gravity = session.configuration.gravity
    return write_model(folder, session.model, session.urdf, by_name, effects, gravity)


def _simulate_again(
    session: Session, result: GapResult, sharp: Sequence[Samples], commands: Sequence[Samples], cutoff: float
) -> tuple[list[SimulatedAgain], str]:
    """What was known of the sensors before is corrected in the samples, and so not in these model files."""
    known = session.loaded
    fitted = known.refitted(session.model, result.coefficients, result.beside)
    with TemporaryDirectory() as folder:
        before, after = Path(folder) / "before", Path(folder) / "after"
        _write(before, session, _nominal_inertias(session), known.in_samples)
        _write(after, session, result.inertias, [*fitted.in_samples, *result.findings])
        files = model_files(before), model_files(after)
        try:
            return simulate_again(session.model, result, *files, sharp, commands, cutoff)
        except InputError as error:  # what was found is worth more than its simulation
            return [], str(error)


def _page(
    session: Session,
    result: GapResult,
    recordings: Recordings,
    bags: Sequence[Path],
    again: Sequence[SimulatedAgain],
    why_not: str,
) -> GapPage:
    return GapPage(
        robot=session.robot.name,
        recordings=[path.name for path in bags],
        joints=session.robot.joint_names,
        units=position_units(session.model),
        result=result,
        nominal=_nominal_inertias(session),
        rigid=_without_findings(session, result, recordings.held_out),
        known=session.loaded.effects,
        simulated=again,
        not_simulated=why_not,
    )


def _without_findings(session: Session, result: GapResult, held_out: Sequence[Samples]) -> FloatArray:
    """What the model predicts at the trace's instants without any finding, ``(N, channels)``."""
    samples = Samples.concatenate(list(held_out))
    order = np.argsort(samples.stamps, kind="stable")
    chosen = samples.select(order[np.searchsorted(samples.stamps, result.trace.stamps, sorter=order)])
    parameters = np.concatenate([result.inertias.ravel(), np.nan_to_num(result.coefficients)])
    return session.model.predict(chosen, parameters)[1]
