"""Stored results on bags and robots of a fleet, in a folder that all workers share or in an object store.

For a bag, everything that an estimate needs: summaries of its rows, and facts about it in addition to them. For a
robot, its files, and its contribution to a population.

Both have the file format of checkpoints (:mod:`geomid_ros.files.archive`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

from geomid_ros.errors import GeomidError, InputError
from geomid_ros.estimation.comparison import compare_robots
from geomid_ros.estimation.identifier import LONGEST_STEP, Memory
from geomid_ros.estimation.population import RobotLikelihood
from geomid_ros.estimation.summary import RowSummary, SummaryState
from geomid_ros.files.archive import archived, decoded, encoded, unarchived
from geomid_ros.files.disk import write_bytes
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.files.schema import from_document
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, read_bags, read_with_locked
from geomid_ros.session.review import RecordingFacts
from geomid_ros.session.session import Session
from geomid_ros.session.training import Training


def file_system(url: str) -> tuple[Any, str]:
    """Find the file system of a path or URL (fsspec), and the path there.

    Raises:
        InputError: fsspec, or a package that it needs for this kind of URL, is not installed, or the kind is unknown.
    """
    try:
        from fsspec.core import url_to_fs  # noqa: PLC0415 an extra
    except ImportError as error:
        raise InputError("geomid fleet needs the extra 'fleet': pip install geomid_ros[fleet]") from error
    try:
        result: tuple[Any, str] = url_to_fs(url)
    except (ImportError, ValueError, OSError) as error:
        raise InputError(f"{url}: cannot be reached ({error})") from error
    return result


def is_local(system: Any) -> bool:
    """True if a file system is this machine's."""
    return "file" in (system.protocol if isinstance(system.protocol, tuple) else (system.protocol,))


@dataclass(frozen=True)
class Store:
    """Files by name under a path or URL; each is complete or missing."""

    url: str

    def get(self, name: str, missing: str = "") -> bytes:
        """Content of a file. Raises InputError if it cannot be read, with the sentence ``missing`` if it does not
        exist."""
        system, folder = file_system(self.url)
        try:
            content: bytes = system.cat_file(f"{folder}/{name}")
        except FileNotFoundError as error:
            raise InputError(f"{self.url}: {missing or f'{name} is missing'}") from error
        except OSError as error:
            raise InputError(f"{self.url}: cannot be read ({error})") from error
        return content

    def put(self, name: str, content: bytes) -> None:
        """Write a file. Raises GeomidError if it cannot be written."""
        system, folder = file_system(self.url)
        if is_local(system):
            write_bytes(Path(folder) / name, content)
            return
        try:
            system.pipe_file(f"{folder}/{name}", content)
        except OSError as error:
            raise GeomidError(f"{self.url}: cannot be written ({error})") from error

    def names(self) -> set[str]:
        """Names of all files."""
        system, folder = file_system(self.url)
        try:
            return {path.rpartition("/")[2] for path in system.ls(folder, detail=False)}
        except FileNotFoundError:
            return set()
        except OSError as error:
            raise InputError(f"{self.url}: cannot be read ({error})") from error


SUFFIX = ".safetensors"
"""Suffix of these files."""


@dataclass(frozen=True, eq=False, kw_only=True)
class BagSummary:
    """A summary of one bag, or of several of the same robot and configuration.

    Attributes:
        fitted: rows to fit, and the reasons why others were rejected.
        held_out: rows to evaluate on.
        recorded: facts about the recordings in addition to the rows.
        locked: joints that were locked.
        begin, end: stamps of the first and last fitted samples [ns].
    """

    fitted: Memory
    held_out: SummaryState
    recorded: RecordingFacts
    locked: tuple[str, ...]
    begin: int
    end: int

    def encoded(self, session: Session) -> bytes:
        """Encode as a file."""
        return encoded({"meaning": session.meaning, **vars(self)}, self.recorded.accounts)

    @staticmethod
    def decoded(content: bytes, session: Session) -> BagSummary:
        """Decode a file, for a session of the same meaning. Raises InputError for an invalid file."""
        try:
            return decoded(BagSummary, content, session.meaning)
        except InputError as error:
            raise InputError(f"the summary of a bag cannot be read ({error})") from error

    def plus(self, later: BagSummary) -> BagSummary:
        """Sum of the rows of this summary and a ``later`` one."""
        pause = min(max(0.0, 1e-9 * (later.begin - self.end)), LONGEST_STEP)
        rows = self.fitted.summary.plus(later.fitted.summary, pause)
        return BagSummary(
            fitted=Memory(rows, self.fitted.rows_rejected + later.fitted.rows_rejected, None, None),
            held_out=self.held_out.plus(later.held_out),
            recorded=self.recorded.plus(later.recorded),
            locked=self.locked,
            begin=self.begin,
            end=max(self.end, later.end),
        )


def summarise(text: str, source: str, configuration: Configuration, bags: Bags) -> tuple[Session, BagSummary]:
    """Read bags, and keep everything that an estimate needs, as ``geomid identify`` does.

    Args:
        text: the robot description.
        source: its origin.
        configuration: configuration of the session.
        bags: the bags to read, and the fraction to hold out.

    Returns:
        The session that read them, and the summary.

    Raises:
        InputError: they cannot be used.
    """
    session, (held_out, begin, end) = read_with_locked(
        lambda chosen: Session(text, chosen, source), configuration, lambda session: _read(session, bags)
    )
    locked = set(session.locked_joints) - set(configuration["locked_joints"])
    summary = BagSummary(
        fitted=session.identifier.memory(),
        held_out=_rows(session.model, held_out),
        recorded=session.review.recorded,
        locked=tuple(sorted(locked)),
        begin=begin,
        end=end,
    )
    return session, summary


def _read(session: Session, bags: Bags) -> tuple[list[Samples], int, int]:
    """Held-out samples, and the first and last stamp of the fitted ones [ns]."""
    training, stamps = Training(session), list[int]()

    def fit(samples: Samples) -> None:
        training.add(samples)
        stamps[:] = [*stamps[:1], int(samples.stamps[0]), int(samples.stamps[-1])]

    held_out = read_bags(session, bags, fit)
    training.end()
    return held_out, stamps[0], stamps[-1]


def sum_of_summaries(summaries: Sequence[BagSummary]) -> BagSummary:
    """Sum of at least one summary, in the order of recording and by a fixed tree, so that it is reproducible."""
    summed = sorted(summaries, key=lambda summary: (summary.begin, summary.end, summary.fitted.summary.rows))
    while len(summed) > 1:
        pairs = [summed[index : index + 2] for index in range(0, len(summed), 2)]
        summed = [reduce(BagSummary.plus, pair) for pair in pairs]
    return summed[0]


def _rows(model: MeasurementModel, batches: Sequence[Samples]) -> SummaryState:
    """All rows of samples, including those at rest, as a prediction is evaluated there, too."""
    summary = RowSummary(model.channels)
    for samples in batches:
        rows = model.rows(samples)
        summary.add(rows.coefficients, rows.targets)
    return summary.state()


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotResults:
    """The ``files`` of a robot's folder by name, and the ``evidence`` for a population."""

    files: Mapping[str, bytes]
    evidence: RobotLikelihood

    @property
    def encoded(self) -> bytes:
        """Encoded as a file."""
        return archived(vars(self))

    @staticmethod
    def decoded(content: bytes) -> RobotResults:
        """Decode such a file. Raises InputError if it is invalid."""
        return from_document(RobotResults, unarchived(content), "its text:")

    @property
    def estimate(self) -> EstimateFile:
        """Content of ``estimate.json``."""
        return EstimateFile.of(json.loads(self.files["estimate.json"]), "the new estimate")

    def write(self, folder: Path) -> None:
        """Write the files into a folder. Raises GeomidError if they cannot be written."""
        for name, content in self.files.items():
            write_bytes(folder / Path(name).name, content)


_CHANCE = 1e-4  # false-alarm probability for all numbers of one robot; it is low, as a fleet has many robots


def changes(before: EstimateFile, after: EstimateFile) -> list[str]:
    """Sentences on links that have changed, and on numbers of links and effects that differ by more than their standard
    deviations explain, the most certain first.

    Information that both estimates took from the same prior counts as uncertain twice, so few data show no change.

    Args:
        before, after: estimates of one robot.

    Raises:
        InputError: a file has invalid content.
    """
    comparison = compare_robots(before.values, after.values, _CHANCE)
    return [*(link.sentence for link in comparison.changed), *(number.sentence for number in comparison.differing)]
