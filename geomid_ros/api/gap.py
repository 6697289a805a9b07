"""Diagnosis of the gap between simulation and robot, from rosbags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from geomid_ros.api.identify import DELAY, identify
from geomid_ros.api.rebuild import tables, write_tables
from geomid_ros.api.robot import bag_paths, configuration, description, recordings
from geomid_ros.checks.verdict import DOUBTFUL, STATUS, recording_verdict
from geomid_ros.errors import InputError
from geomid_ros.exports.descriptions import DESCRIPTIONS, DescriptionFiles, as_described
from geomid_ros.exports.handover import FileTest, evaluate_description, file_name
from geomid_ros.exports.model import ExportModel, read_model
from geomid_ros.files.disk import staged, write_json, write_text
from geomid_ros.files.models.estimate_file import causes_entry
from geomid_ros.files.models.gap_file import GapFile, gap_document, page_entries
from geomid_ros.files.models.readers import READERS, URDF
from geomid_ros.files.schema import to_document
from geomid_ros.gap.result import Finding, GapResult, Verdict
from geomid_ros.model.samples import Samples
from geomid_ros.options import Progress, shared, silent, takes
from geomid_ros.report.gap_page import GapPage, write_gap_page
from geomid_ros.report.gap_words import verdict_sentence
from geomid_ros.report.series import elapsed
from geomid_ros.resimulation.resimulate import Resimulated
from geomid_ros.session.gap import (
    GapReader,
    Identified,
    find_gap_in_samples,
    gap_session,
    identified_in,
    known_remainder_of,
)
from geomid_ros.session.options import GapOptions, PathLike, RecordingOptions
from geomid_ros.session.recordings import Bags
from geomid_ros.session.session import Session
from geomid_ros.session.written_simulation import nominal_inertias, simulate_again, without_findings, write_found


@dataclass(frozen=True, kw_only=True, eq=False)
class Gap:
    """Result of the gap workflow.

    Attributes:
        session: the robot and the given model.
        bags: the recordings.
        result: findings, ranking and gaps.
        held_out: the held-out samples, one element per recording.
        simulated: resimulations of these recordings in MuJoCo, before and after.
        not_simulated: why there is no resimulation; empty if there is one.
        reader: software that will read the robot description.
        with_simulator: True if compared with a simulator of the user's, which models more than the description.
        identified: what ``identify`` finds in the recordings, without a given model or a simulator of the user's.
    """

    session: Session
    bags: Bags
    result: GapResult
    held_out: Sequence[Samples]
    simulated: Sequence[Resimulated]
    not_simulated: str
    reader: str = URDF
    with_simulator: bool = False
    identified: Identified | None = None

    @property
    def verdict(self) -> Verdict:
        """``no gap``, ``named``, ``incomplete`` or ``unexplained``."""
        return self.result.verdict

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Effects found, the most certain first."""
        return self.result.findings

    @cached_property
    def handover(self) -> FileTest | None:
        """Prediction error of the description for :attr:`reader` on the held-out samples, loaded by MuJoCo or
        pinocchio. None with a simulator of the user's, because the rest of the model is in that simulator.

        Raises:
            InputError: that program rejects it.
        """
        if self.with_simulator:
            return None
        identified = dict(zip(self.result.channels, (self.result.gap.after * self.result.floor).tolist(), strict=True))
        written, session = self._written, self.session
        errors = {e.effect for e in written.effects if e.cls.is_sensor_error and e.is_coefficient}
        with_errors = session.again({"effects": sorted(errors), "candidates": []})
        test = with_errors, self.reader, self._description, self.held_out, identified
        return evaluate_description(*test, effects=written.known, beside=written.effects)

    @cached_property
    def _written(self) -> ExportModel:
        """Model for :attr:`reader` as it is written."""
        with TemporaryDirectory() as folder:
            write_found(Path(folder), self.session, self.result, self.reader, self.identified)
            return read_model(Path(folder) / "estimate.json", self.reader)

    @cached_property
    def _description(self) -> DescriptionFiles:
        """Description for :attr:`reader` of the model as it is written."""
        return DESCRIPTIONS[self.reader].whole(as_described(self._written))

    @property
    def status(self) -> int:
        """Exit status: 4 for a doubtful recording, or a description that predicts worse than the one given."""
        verdict = recording_verdict(self.session.review.findings)
        return STATUS[DOUBTFUL] if self.handover and self.handover.worse else verdict.status

    @property
    def document(self) -> dict[str, Any]:
        """All numbers, as in ``gap.json``."""
        session, stamps = self.session, self.result.trace.stamps
        document = gap_document(self.result, {simulation.kind: simulation.errors for simulation in self.simulated})
        return {
            **document,
            **page_entries(self.result, nominal_inertias(session)),
            "robot": session.robot.name,
            "recordings": [path.name for path, _ in self.bags.held_out_fractions],
            "judged_seconds": float(elapsed(stamps)[-1]) if len(stamps) else 0.0,
            "known": to_document(session.loaded.effects),
            "not_simulated": self.not_simulated,
            "causes": causes_entry(session.review.findings),
            "warnings": session.review.warnings(),
            "notes": session.notes,
            "handover": {self.reader: self.handover.entry} if self.handover else {},
        }

    def report(self, path: PathLike, *, progress: Progress = silent) -> Path:
        """Write one HTML page with all results and plots. The page needs no network.

        Args:
            path: the file.
            progress: called with the current stage and its completed fraction, 0 to 1.

        Returns:
            The same path.

        Raises:
            GeomidError: the file cannot be written.
        """
        page = GapPage(
            file=GapFile.of(self.document, "gap.json"),
            joints=self.session.robot.joint_names,
            units=["m" if joint.unit == "N" else "rad" for joint in self.session.robot.joints],
            result=self.result,
            rigid=without_findings(self.session, self.result, self.held_out),
            simulated=self.simulated,
        )
        progress("drawing", 0.0)
        write_gap_page(Path(path), page)
        return Path(path)

    def save(self, folder: PathLike, *, report: bool = True, progress: Progress = silent) -> list[Path]:
        """Write report.html, gap.json, findings.csv, and the model with the findings.

        Args:
            folder: created if it does not exist.
            report: whether to write report.html, which is for people.
            progress: called with the current stage and its completed fraction, 0 to 1.

        Returns:
            The files; the model is estimate.json, identified.urdf, identified.xml (MJCF) and effects.yaml.

        Raises:
            GeomidError: a file cannot be written.
        """
        with staged(Path(folder)) as stage:
            page = [self.report(stage / "report.html", progress=progress)] if report else []
            files = [*page, *self._write(stage)]
        return [Path(folder) / file.name for file in files]

    def _write(self, folder: Path) -> list[Path]:
        files, document = write_found(folder, self.session, self.result, self.reader, self.identified), self.document
        write_json(folder / "gap.json", document)
        texts = {file_name(self.reader): self._description.text, **self._description.extra_files}
        for path, text in ((folder / name, text) for name, text in texts.items() if folder / name not in files):
            files.append(path)
            write_text(path, text)
        written = [folder / "gap.json", *write_tables(folder, tables(document))]
        return [*written, *files]

    def __repr__(self) -> str:
        """Reasons for doubt, the verdict, and a sentence for each finding."""
        doubts = recording_verdict(self.session.review.findings).remarks
        sentences = [f"  {finding.sentence}" for finding in self.findings]
        return "\n".join([*doubts, f"Gap of {self.session.robot.name}: {verdict_sentence(self.result)}", *sentences])


@takes(GapOptions)
def find_gap(options: GapOptions) -> Gap:
    """Find where simulation and measurement disagree, which effect explains it, and how much of the gap it closes.

    ``geomid gap`` calls this; its options have the same names, but ``--for`` for ``reader``. With ``model``, the
    baseline is an estimate.json instead of the URDF with its inertias alone.

    Raises:
        InputError: a file, an argument or the data cannot be used; the message names it and says what to do.
    """
    recorded, simulated = recordings(options, options.bags), bag_paths(options.simulated)
    robot = description(options, recorded.fitted, options.model)
    parameters = configuration(options, options.model)
    notes: Sequence[str] = ()
    if parameters.gains:  # the delay column is first order: apply the delay first
        first = identify(options.bags, candidates=(), **shared(options, RecordingOptions)).session
        parameters, notes = parameters.with_values({DELAY: first.configuration[DELAY]}), first.review.settled
    session, samples = robot.read(
        gap_session, parameters, lambda session: GapReader(session, recorded, options.progress).read(simulated)
    )
    session.review.settled.extend(note for note in notes if note not in session.review.settled)
    session.review.check_description()
    if session.loaded.source and not session.loaded.fitted_models:
        session.review.settled.append(
            f"{session.loaded.source}: has no fits for description formats: written descriptions have the inertias of "
            "the estimate; identify again from bags to fit them"
        )
    recorded = replace(recorded, left_out=session.review.left_out)  # as is known now
    reader = GapReader(session, recorded, options.progress)
    sharp = reader.high_cutoff_samples()
    commands = reader.high_cutoff_samples(options.command) if options.command else []
    try:
        identified = identified_in(session, samples, READERS)
        result = find_gap_in_samples(session, samples, known_remainder_of(session), identified, options.progress)
    except InputError as error:
        raise InputError(f"{', '.join(map(str, recorded.fitted))}: {error}") from error
    options.progress("simulating again", 0.0)
    resimulated, not_simulated = simulate_again(session, result, sharp, commands, samples.cutoff)
    return Gap(
        session=session,
        bags=recorded,
        result=result,
        held_out=samples.held_out,
        simulated=resimulated,
        not_simulated=not_simulated,
        reader=options.reader,
        with_simulator=bool(simulated),
        identified=None if simulated else identified,
    )
