"""What is kept of bags and robots.

Of a bag, what an estimate needs: the summaries of its rows, and what is known of it beside them. Of a robot its files,
and what a population is made of.

Both are NumPy archives without pickled objects. That of a bag has two checkpoints
(:mod:`geomid_ros.files.checkpoints.checkpoint`), of what is fitted and of what is held out, and a JSON text.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.errors import InputError
from geomid_ros.estimation.comparison import compared
from geomid_ros.estimation.identifier import LONGEST_STEP, Memory
from geomid_ros.estimation.population import RobotLikelihood
from geomid_ros.estimation.posterior import EffectCoordinate
from geomid_ros.estimation.summary import RowSummary, SummaryState
from geomid_ros.files.checkpoints.checkpoint import Checkpoint, decoded, encoded
from geomid_ros.files.disk import write_bytes
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recording_facts import Recorded
from geomid_ros.session.recordings import Bags, read_bags, read_with_locked
from geomid_ros.session.session import Session
from geomid_ros.session.training import Training

_FITTED, _HELD_OUT, _BESIDE = "fitted", "held_out", "beside"


@dataclass(frozen=True, eq=False, kw_only=True)
class BagSummary:
    """A summary of one bag, or of several of the same robot and configuration.

    Attributes:
        fitted: rows to fit, and why others were not taken.
        held_out: rows to judge on.
        recorded: what is known beside them.
        locked: the joints that were locked.
        begin, end: stamps of the first and of the last instant that is fitted [ns].
    """

    fitted: Memory
    held_out: SummaryState
    recorded: Recorded
    locked: tuple[str, ...]
    begin: int
    end: int

    def encoded(self, session: Session) -> bytes:
        """As a file."""
        accounts = self.recorded.accounts
        fitted = encoded(Checkpoint(session.meaning, self.fitted, accounts), session.model.channels)
        judged = Memory(self.held_out, Counter(), None, None)
        held_out = encoded(Checkpoint(session.meaning, judged), session.model.channels)
        beside = asdict(self.recorded) | {"locked": self.locked, "begin": self.begin, "end": self.end}
        del beside["accounts"]
        content = io.BytesIO()
        blobs = {_FITTED: np.frombuffer(fitted, np.uint8), _HELD_OUT: np.frombuffer(held_out, np.uint8)}
        np.savez(content, allow_pickle=False, **{_BESIDE: np.array(json.dumps(beside))}, **blobs)
        return content.getvalue()

    @staticmethod
    def decoded(content: bytes, session: Session) -> BagSummary:
        """From a file, for a session of the same meaning. Raises InputError for what is no such file."""
        try:
            with np.load(io.BytesIO(content), allow_pickle=False) as archive:
                meaning, channels = session.meaning, session.model.channels
                fitted = decoded(archive[_FITTED].tobytes(), meaning, channels)
                held_out = decoded(archive[_HELD_OUT].tobytes(), meaning, channels)
                beside = json.loads(str(archive[_BESIDE]))
            return BagSummary(
                fitted=fitted.memory,
                held_out=held_out.memory.summary,
                recorded=_recorded(beside, fitted),
                locked=tuple(beside["locked"]),
                begin=beside["begin"],
                end=beside["end"],
            )
        except (zipfile.BadZipFile, KeyError, TypeError, ValueError, OSError, EOFError) as error:
            raise InputError(f"the summary of a bag cannot be read ({error})") from error

    def plus(self, later: BagSummary) -> BagSummary:
        """The rows of both, of which the other was recorded later."""
        pause = min(max(0.0, 1e-9 * (later.begin - self.end)), LONGEST_STEP)
        rows = self.fitted.summary.plus(later.fitted.summary, pause)
        return BagSummary(
            fitted=Memory(rows, self.fitted.rows_rejected + later.fitted.rows_rejected, None, None),
            held_out=self.held_out.plus(later.held_out),
            recorded=Recorded.together([self.recorded, later.recorded]),
            locked=self.locked,
            begin=self.begin,
            end=max(self.end, later.end),
        )


def summarise(text: str, source: str, configuration: Configuration, bags: Bags) -> tuple[Session, BagSummary]:
    """Read bags, and keep of them what an estimate needs, as ``geomid identify`` does.

    Args:
        text: the robot description.
        source: where it is from.
        configuration: of the session.
        bags: which to read, and what to hold out.

    Returns:
        The session that read them, and the summary.

    Raises:
        InputError: they cannot be used.
    """
    session, (held_out, begin, end) = read_with_locked(
        lambda chosen: Session(text, chosen, source), configuration, lambda session: _read(session, bags)
    )
    locked = set(session.configuration["locked_joints"]) - set(configuration["locked_joints"])
    summary = BagSummary(
        fitted=session.identifier.memory(),
        held_out=_rows(session.model, held_out),
        recorded=session.recorded,
        locked=tuple(sorted(locked)),
        begin=begin,
        end=end,
    )
    return session, summary


def _read(session: Session, bags: Bags) -> tuple[list[Samples], int, int]:
    """The samples to judge on, and the first and the last stamp of those that were fitted."""
    training, stamps = Training(session), list[int]()

    def fit(samples: Samples) -> None:
        training.add(samples)
        stamps[:] = [*stamps[:1], int(samples.stamps[0]), int(samples.stamps[-1])]

    held_out = read_bags(session, bags, fit)
    training.end()
    return held_out, stamps[0], stamps[-1]


def total(summaries: Sequence[BagSummary]) -> BagSummary:
    """The sum of at least one: in the order of recording and always by the same tree, so that it depends on nothing
    else."""
    several = sorted(summaries, key=lambda summary: (summary.begin, summary.end, summary.fitted.summary.rows))
    while len(several) > 1:
        pairs = [several[index : index + 2] for index in range(0, len(several), 2)]
        several = [reduce(BagSummary.plus, pair) for pair in pairs]
    return several[0]


def _rows(model: MeasurementModel, batches: Sequence[Samples]) -> SummaryState:
    """All rows of samples, those at a standstill included: a prediction is judged there, too."""
    summary = RowSummary(model.channels)
    for samples in batches:
        rows = model.rows(samples)
        for coefficients, targets in zip(rows.coefficients, rows.targets, strict=True):
            summary.add(coefficients, targets)
    return summary.state()


def _recorded(entry: Mapping[str, Any], fitted: Checkpoint) -> Recorded:
    names = ("remarks", "unmeasured", "incomplete", "unchecked", "settled")
    findings = tuple(
        Finding(cause=_cause(f["cause"]), sure=f["sure"], rivals=tuple(map(_cause, f["rivals"])))
        for f in entry["findings"]
    )
    texts = {name: tuple(map(str, entry[name])) for name in names}
    return Recorded(accounts=fitted.accounts, findings=findings, **texts)


def _cause(entry: Mapping[str, Any]) -> Cause:
    places = tuple(map(str, entry["places"]))
    return Cause(kind=entry["kind"], sentence=entry["sentence"], settings=entry["settings"], places=places)


_HEADER, _FILE = "header", "file "
_ARRAYS = ("rows", "targets", "parameters", "prior", "scales")


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotResults:
    """The ``files`` of a robot's folder by name, and the ``evidence`` that a population is made of."""

    files: Mapping[str, bytes]
    evidence: RobotLikelihood

    @property
    def encoded(self) -> bytes:
        """As a NumPy archive without pickled objects."""
        header = {"links": self.evidence.links, "effects": [asdict(effect) for effect in self.evidence.effects]}
        arrays = {name: getattr(self.evidence, name) for name in _ARRAYS}
        files = {_FILE + name: np.frombuffer(content, np.uint8) for name, content in self.files.items()}
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, **{_HEADER: np.array(json.dumps(header))}, **arrays, **files)
        return content.getvalue()

    @staticmethod
    def decoded(content: bytes) -> RobotResults:
        """From such an archive. Raises InputError for what is none."""
        try:
            return RobotResults._read(content)
        except (zipfile.BadZipFile, KeyError, TypeError, ValueError, EOFError) as error:
            raise InputError(f"the stored result of a robot cannot be read ({error})") from error

    @staticmethod
    def _read(content: bytes) -> RobotResults:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            header = json.loads(str(archive[_HEADER]))
            evidence = RobotLikelihood(
                links=tuple(header["links"]),
                effects=tuple(EffectCoordinate(**entry) for entry in header["effects"]),
                **{name: archive[name] for name in _ARRAYS},
            )
            files = {key[len(_FILE) :]: archive[key].tobytes() for key in archive.files if key.startswith(_FILE)}
        return RobotResults(files=files, evidence=evidence)

    @property
    def estimate(self) -> EstimateFile:
        """What ``estimate.json`` says."""
        return EstimateFile.of(json.loads(self.files["estimate.json"]), "the new estimate")

    def write(self, folder: Path) -> None:
        """Write the files into a folder. Raises GeomidError if they cannot be written."""
        for name, content in self.files.items():
            write_bytes(folder / Path(name).name, content)


_CHANCE = 1e-4  # a fleet has many robots: of any of one robot's numbers, if none has changed


def changes(before: EstimateFile, after: EstimateFile) -> list[str]:
    """The links that have changed, and the numbers of links and effects that differ by more than their standard
    deviations explain, in words, the surest first.

    What both estimates took from the same prior counts as uncertain twice: little data tell no change.

    Args:
        before, after: of one robot.

    Raises:
        InputError: a file says what cannot be.
    """
    found = compared(before.values, after.values, _CHANCE)
    return [*(link.sentence for link in found.changed), *(number.sentence for number in found.differing)]
