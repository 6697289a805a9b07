"""Tasks of the workers, by a plan: a bag to its summary, and summaries to a robot's results. All are stored."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from geomid_ros.checks.verdict import Verdict
from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.population import RobotLikelihood
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.files.archive import FORMAT
from geomid_ros.files.models.readers import READERS
from geomid_ros.files.schema import from_document, to_document
from geomid_ros.fleet.recordings import FleetBag, on_this_disk
from geomid_ros.fleet.summary_store import SUFFIX, BagSummary, RobotResults, Store, sum_of_summaries, summarise
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, Topics, with_locked
from geomid_ros.session.session import Session, installed_version, save
from geomid_ros.types import FloatArray


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
            bags = Bags(fitted=[path], hold_out=plan.hold_out, topics=plan.topics)
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
    held_out = test_rows.rms(estimate.parameters)
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
