"""Tasks of the workers, by a plan: a bag to its summary, and summaries to a robot's results; and the store of all that.

The store is a folder that all workers share, or an object store. For a bag it has everything that an estimate needs:
summaries of its rows, and facts about it in addition to them. For a robot it has its files, and its contribution to a
population. Both have the file format of checkpoints (:mod:`geomid_ros.files.archive`).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache, reduce
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from geomid_ros.checks.verdict import Verdict
from geomid_ros.errors import GeomidError, InputError
from geomid_ros.estimation.comparison import compare_robots
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.identifier import LONGEST_STEP, Memory
from geomid_ros.estimation.population import RobotLikelihood
from geomid_ros.estimation.summary import RowSummary, SummaryState
from geomid_ros.files.archive import FORMAT, archived, decoded, encoded, unarchived
from geomid_ros.files.disk import write_bytes
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.files.models.readers import READERS
from geomid_ros.files.schema import from_document, to_document
from geomid_ros.fleet.recordings import FleetBag, file_system, is_local, on_this_disk
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, Topics, read_with_locked, train, with_locked
from geomid_ros.session.review import RecordingFacts
from geomid_ros.session.session import Session, installed_version, save
from geomid_ros.types import FloatArray, IntArray


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
    stamps: list[IntArray] = []
    held_out = train(session, bags, note=lambda samples: stamps.append(samples.stamps[[0, -1]]))
    return held_out, int(stamps[0][0]), int(stamps[-1][1])


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


# --- The plan, and the tasks ---


@dataclass(frozen=True, kw_only=True)
class FleetPlan:
    """Settings that all bags have in common.

    Attributes:
        description: text of the URDF.
        source: its origin.
        given: parameters of the configuration by full name.
        topics: topics that bags are read from.
        hold_out: fraction of each bag's time, at the end, to evaluate on; None for the default.
        version: version of this package.
    """

    description: str
    source: str
    given: dict[str, Any]
    topics: Topics
    hold_out: float | None = None
    version: str = field(default_factory=installed_version)

    @property
    def configuration(self) -> Configuration:
        """Configuration of the sessions."""
        return Configuration(self.given, "options")

    @property
    def document(self) -> dict[str, Any]:
        """The plan as JSON."""
        return asdict(self)

    @property
    def name(self) -> str:
        """Name under which it is stored."""
        return f"plan-{_checksum(self.document)}"

    def summary_name(self, bag: FleetBag) -> str:
        """Name under which the summary of a bag is stored."""
        return f"bag-{_checksum([self.document, bag.url, bag.fingerprint])}"

    def results_name(self, robot: str, bags: Iterable[str]) -> str:
        """Name under which the results of a robot are stored, from the names of its bags' summaries."""
        return f"robot-{_checksum([self.document, robot, sorted(bags)])}"


def _checksum(content: Any) -> str:
    text = json.dumps([FORMAT, content], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


@dataclass(frozen=True, kw_only=True)
class BagOutcome:
    """Outcome of a bag.

    Attributes:
        error: reason why it could not be used, in a sentence; empty if it could.
        doubts: suspected faults, in sentences.
        locked: joints that were locked, as its messages do not contain them.
    """

    error: str = ""
    doubts: tuple[str, ...] = ()
    locked: tuple[str, ...] = ()


def summarise_bag(store: Store, plan_name: str, bag: FleetBag) -> BagOutcome:
    """Summarise a bag. Faults of the bag itself are an outcome, too."""
    plan = _plan(store, plan_name)
    name = plan.summary_name(bag)
    try:
        with on_this_disk(bag.url) as path:
            bags = Bags(fitted=[path], hold_out=plan.hold_out, topics=plan.topics, unloaded=True)
            session, summary = summarise(plan.description, plan.source, plan.configuration, bags)
        content = summary.encoded(session)
    except InputError as error:
        outcome = BagOutcome(error=str(error))
    else:
        store.put(f"{name}{SUFFIX}", content)
        outcome = BagOutcome(
            doubts=tuple(finding.sentence for finding in summary.recorded.findings), locked=summary.locked
        )
    store.put(f"{name}.json", json.dumps(to_document(outcome)).encode())
    return outcome


def solve_robot(store: Store, plan_name: str, name: str, bags: Sequence[str], locked: Sequence[str]) -> str:
    """Identify a robot from the stored summaries of its bags.

    Args:
        store: where they are stored.
        plan_name: name of the stored plan.
        name: name under which the results are stored.
        bags: names of the stored summaries.
        locked: joints that none of the bags contains.

    Returns:
        The reason why that is impossible, in a sentence; empty if it was done.
    """
    plan = _plan(store, plan_name)
    try:
        session = Session(plan.description, with_locked(plan.configuration, locked), plan.source, readers=READERS)
        summary = sum_of_summaries([_kept(store, bag, session) for bag in bags])
        results = _results(session, *solve(session, summary))
    except InputError as error:
        return str(error)
    store.put(f"{name}{SUFFIX}", results.encoded)
    return ""


def solve(session: Session, summary: BagSummary) -> tuple[Estimate, FloatArray | None, Verdict]:
    """Identify a robot as ``geomid identify`` does, from the summary of its bags.

    Args:
        session: a session of the robot that has read nothing.
        summary: the summary of its bags.

    Returns:
        The estimate, the RMS residual of each channel on held-out data, if there are any, and the verdict.
    """
    session.review.read_elsewhere(summary.recorded)
    session.identifier.restore(summary.fitted)
    estimate = session.identifier.solve()
    test_rows = RowSummary(session.model.channels)
    test_rows.restore(summary.held_out)
    if not test_rows.rows:
        return estimate, None, session.review.verdict(estimate)
    parameters, drive_gains = estimate.predictor
    held_out = test_rows.with_drive_gains(drive_gains, len(session.model.nominal_inertias)).rms(parameters)
    return estimate, held_out, session.review.verdict(estimate, test_rows, held_out)


def _results(session: Session, estimate: Estimate, held_out: FloatArray | None, verdict: Verdict) -> RobotResults:
    """The robot's files, as ``geomid identify`` writes them, and its evidence for a population."""
    with TemporaryDirectory(prefix="geomid_robot_") as folder:
        files = save(session, Path(folder), estimate, held_out, verdict)
        content = {file.name: file.read_bytes() for file in files}
    return RobotResults(files=content, evidence=RobotLikelihood.of(estimate))


def _kept(store: Store, name: str, session: Session) -> BagSummary:
    missing = f"a bag's summary is missing ({name}); run the same again"
    return BagSummary.decoded(store.get(f"{name}{SUFFIX}", missing), session)


@lru_cache(maxsize=4)
def _plan(store: Store, name: str) -> FleetPlan:
    """Load the plan of that name. Raises InputError if it is of another version, or is not visible here."""
    missing = (
        "a worker does not see this folder; --out must be on a disk that all workers share, or --keep a URL that they "
        "reach"
    )
    plan = from_document(FleetPlan, json.loads(store.get(name, missing)), f"{store.url}/{name}:")
    if plan.version != installed_version():
        installed = installed_version()
        raise InputError(f"a worker has geomid_ros {installed}, not {plan.version}: install the same everywhere")
    return plan
