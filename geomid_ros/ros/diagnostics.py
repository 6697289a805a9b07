"""Diagnostics: a status for each link, the stream, search, payload and checkpoints; a scalar per key (REP 107). And
console messages on problems and progress, for users who do not watch them."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import Self

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from geomid_ros.errors import one_line
from geomid_ros.estimation.estimate import QUANTITIES, Estimate, LinkEstimate
from geomid_ros.estimation.identifier import STANDING_STILL
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.live.saving import CheckpointStatus
from geomid_ros.live.searches import FoundGap, SearchStatus
from geomid_ros.live.status import Status
from geomid_ros.live.supervisor import PUBLISHERS_START, Log
from geomid_ros.model.channels import is_of
from geomid_ros.monitoring.change_detection import ChannelGap
from geomid_ros.monitoring.payload_watch import CarriedPayload
from geomid_ros.report.gap_words import not_explained
from geomid_ros.signals.ledger import Account, meaning_of
from geomid_ros.signals.messages import JOINT_STATES

STOPPED = "stopped"
_SIMULATED = 1_000_000_000_000_000_000  # [ns] earlier stamps are of a simulation
_QUANTILES = {"p50": 0.5, "p99": 0.99, "max": 1.0}


class Advised(str):
    """Sentence on a problem, with separate ``advice`` on what to do."""

    advice: str

    def __new__(cls, sentence: str, advice: str) -> Self:
        advised = super().__new__(cls, sentence)
        advised.advice = advice
        return advised

    def __reduce__(self) -> tuple[type[Self], tuple[str, str]]:
        return type(self), (str(self), self.advice)


DESCRIPTION = "robot_description"
"""Topic of the robot description."""
NO_DESCRIPTION = Advised(
    "no robot description yet", "start robot_state_publisher, or set the parameter robot_description"
)
_NOTHING_COMES = "does the driver run? 'ros2 topic list -t' shows topics, '--ros-args -r NAME:=TOPIC' renames one"


class Diagnostics:
    """Makes a node's diagnostic messages. They report what went wrong since the previous message."""

    def __init__(self, node: str) -> None:
        self._node = node
        self._before = Status(active=False)
        self._barren = 0  # consecutive diagnostics with accepted messages but no rows
        self._fruitful = self._before  # the status before these
        self.errors: list[str] = []
        """Sentences on problems with the stream in the last diagnostics."""
        self.warnings: list[str] = []
        """Sentences on lesser problems in the last diagnostics."""
        self.remarks: list[str] = []
        """Those of the sentences that are one-off remarks on messages."""

    def array(
        self, status: Status, search: SearchStatus[FoundGap] | None = None, checkpoints: CheckpointStatus | None = None
    ) -> DiagnosticArray:
        """Return the state of the stream, of search, payload and checkpoints if there are any, and of every link.

        Args:
            status: of the session.
            search: of the search for a gap, if there was one.
            checkpoints: of the checkpoints, if any are kept.
        """
        new = status.since(self._before)
        self.errors = [*dict.fromkeys(_errors(status, new))]
        self.remarks = _remarks(new)
        sentences = dict.fromkeys([*_warnings(status, new), *self._without_rows(status, new)])
        self.warnings = [text for text in sentences if text not in self.errors]
        self._before = status
        level, message = _judgement(status, self.errors, self.warnings)
        array = DiagnosticArray(status=[status_message(f"{self._node}: stream", level, message, _stream(status))])
        if search is not None:
            array.status.append(_search(f"{self._node}: gap finding", search))
        if status.payload is not None:
            array.status.append(_payload(f"{self._node}: payload", status.payload))
        if checkpoints is not None:
            array.status.append(_checkpoints(f"{self._node}: checkpoints", checkpoints))
        if status.estimate is not None:
            array.status += [_link(self._node, link) for link in status.estimate.links]
        return array

    def _without_rows(self, status: Status, new: Status) -> list[str]:
        """Complain if accepted messages have yielded no rows for longer than all publishers and the filter need."""
        accepted = any(account.accepted > 0 for account in new.accounts.values())
        if not (status.active and accepted and new.rows_made == 0):
            self._barren, self._fruitful = 0, status
            return []
        self._barren += 1
        if self._barren <= PUBLISHERS_START + 2.0 * status.lag:
            return []
        advice = "check for pauses in every filter window, or a rate too low for it"
        since = status.since(self._fruitful)
        if missing := [status.name(topic) for topic in status.topics if since.account(topic).accepted <= 0]:
            advice = f"none is accepted on {', '.join(missing)}"
        elif len(status.topics) > 1:
            advice = f"check that {' and '.join(map(status.name, status.topics))} are stamped by the same clock"
        return [f"messages are accepted, but have yielded no rows for {self._barren} s: {advice}"]


def status_message(name: str, level: bytes, message: str, values: Mapping[str, object]) -> DiagnosticStatus:
    """Return a status with one scalar for each key."""
    texts = {key: f"{value:.6g}" if isinstance(value, float) else str(value) for key, value in values.items()}
    pairs = [KeyValue(key=node_line(key), value=node_line(text)) for key, text in texts.items()]
    return DiagnosticStatus(
        name=one_line(name), hardware_id="geomid", level=level, message=node_line(message), values=pairs
    )


def node_line(text: str) -> str:
    """Return the text in one line, without options of the command line such as (--lock), which a node has not."""
    return one_line(re.sub(r" \(--[a-z-]+\)", "", text))


def _link(node: str, link: LinkEstimate) -> DiagnosticStatus:
    values: dict[str, object] = {
        "mass": link.mass,
        "mass std": link.std_mass,
        **{f"com {axis}": float(value) for axis, value in zip("xyz", link.com, strict=True)},
        **{f"com {axis} std": float(value) for axis, value in zip("xyz", link.std_com, strict=True)},
        "from data": link.from_data,
        "distance from prior": link.distance_from_prior,
        "min eigenvalue ratio": link.min_eigenvalue_ratio,
        "merged": ", ".join(link.merged),
        "not identifiable": ", ".join(name for name in QUANTITIES if name not in link.identified),
    }
    note = "" if "mass" in link.identified else ", identifiable only in combination"
    if link.outlier:
        note = ", far from its prior: a payload, or an unmodelled effect; run 'geomid gap'"
    level = DiagnosticStatus.WARN if link.outlier else DiagnosticStatus.OK
    return status_message(f"{node}: {link.name}", level, f"mass {link.mass:.3f} kg{note}", values)


MOST_LISTED = 8
"""Largest number of reasons in the diagnostics, or of names in a line of the console."""
_MANY = 10  # messages without an accepted one, which is no accident


def _stream(status: Status) -> dict[str, object]:
    values: dict[str, object] = {"active": status.active, "lag": status.lag, "queue": status.queue}
    if seconds := status.receipt_to_row:  # from a message's receipt to the rows that it completed
        quantiles = 1e3 * np.quantile(seconds, [*_QUANTILES.values()])
        values |= {f"receipt to row {name} [ms]": q for name, q in zip(_QUANTILES, quantiles.tolist(), strict=True)}
    values |= {"solves": status.solves, "rows": status.rows, "rows made": status.rows_made}
    for topic, account in status.accounts.items():
        values |= {f"{topic} received": account.received, f"{topic} accepted": account.accepted}
        values |= _refusals(topic, account)
        values |= {f"{topic} noted: {remark}": count for remark, count in account.noted.items()}
        values |= {f"{topic} lost": account.lost} if account.lost else {}
    values |= {f"rows rejected: {reason}": count for reason, count in (+status.rows_rejected).items()}
    values |= {f"failed: {failure}": count for failure, count in status.failures.items()}
    values |= {f"gap {gap.channel}": gap.times_floor for gap in status.gaps}
    if (estimate := status.estimate) is not None:
        values |= {"converged": estimate.converged, "solve seconds": estimate.seconds, "gamma": estimate.gamma}
        for name, sigma, rms in zip(estimate.channels, estimate.sigmas, estimate.rms, strict=True):
            values |= {f"{name} sigma": float(sigma), f"{name} rms": float(rms)}
    return values


def _refusals(topic: str, account: Account) -> dict[str, int]:
    """Numbers of rejected and dropped messages by reason."""
    rejected = {f"{topic} rejected: {reason}": count for reason, count in account.rejected.items()}
    return rejected | {f"{topic} dropped: {reason}": count for reason, count in account.dropped.items()}


def _gap_sentence(gaps: Sequence[ChannelGap]) -> str:
    """Describe the open gaps, the largest first."""
    first, *others = sorted(gaps, key=lambda gap: -gap.times_floor)
    since = min(gap.since for gap in gaps if gap.since is not None)
    also = f"; also at {', '.join(gap.channel for gap in others)}" if others else ""
    return f"gap at {first.channel}: {first.times_floor:.1f} times the noise floor since {_time(since)}{also}"


def _time(stamp: int) -> str:
    """Format a stamp [ns]: seconds in a simulation, else date and time."""
    if stamp < _SIMULATED:
        return f"{stamp * 1e-9:.1f} s"
    return datetime.fromtimestamp(stamp * 1e-9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def _search(name: str, search: SearchStatus[FoundGap]) -> DiagnosticStatus:
    if search.stage or search.result is None:
        return status_message(name, DiagnosticStatus.OK if search.stage else DiagnosticStatus.WARN, search.sentence, {})
    result = search.result.result
    values: dict[str, object] = {"verdict": result.verdict}
    values |= {f"finding {number}": finding.sentence for number, finding in enumerate(result.findings, start=1)}
    values |= {
        f"unexplained {joint}": f"{gap:.2f} times the noise floor, depends on {depends_on}"
        for joint, gap, depends_on in not_explained(result)
    }
    for channel, before, after in zip(result.channels, result.gap.before, result.gap.after, strict=True):
        values |= {f"{channel} before": float(before), f"{channel} after": float(after)}
    level = DiagnosticStatus.OK if result.verdict == "no gap" else DiagnosticStatus.WARN
    return status_message(name, level, search.sentence, values)


def _payload(name: str, carried: CarriedPayload) -> DiagnosticStatus:
    low, high = carried.interval
    mass, *centre = pseudo_inertia.quantities_of(carried.parameters)[:4].tolist()
    values: dict[str, object] = {"link": carried.link, "mass": mass, "mass from": low, "mass to": high}
    values |= {f"com {axis}": value for axis, value in zip("xyz", centre, strict=True)}
    since = f"since {_time(carried.since)}"
    sentence = f"{mass:.2f} kg, from {low:.2f} to {high:.2f} kg (95 %), at '{carried.link}' {since}"
    return status_message(name, DiagnosticStatus.OK, sentence, values)


def _checkpoints(name: str, checkpoints: CheckpointStatus) -> DiagnosticStatus:
    if not checkpoints.problem:
        message = f"{checkpoints.values['rows']} rows in the checkpoint"
        return status_message(name, DiagnosticStatus.OK, message, checkpoints.values)
    level = DiagnosticStatus.ERROR if checkpoints.is_error else DiagnosticStatus.WARN
    return status_message(name, level, checkpoints.problem, checkpoints.values)


def _judgement(status: Status, errors: Sequence[str], warnings: Sequence[str]) -> tuple[bytes, str]:
    """Return the highest level, and all problems, errors first: an error of one topic hides nothing of another."""
    if errors or warnings:
        level = DiagnosticStatus.ERROR if errors else DiagnosticStatus.WARN
        return level, "; ".join([*errors, *warnings])
    if not status.active:
        return DiagnosticStatus.OK, status.unconfigured or STOPPED
    return DiagnosticStatus.OK, "collecting rows" if status.estimate is None else f"{status.rows} rows"


def _errors(status: Status, new: Status) -> list[str]:
    sentences = [*status.problems, *new.failures]
    if status.joints and len(status.unmeasured) == status.joints:
        sentences.append(
            f"{status.name(JOINT_STATES)}: no effort is measured at any joint, no joint equation is used: "
            f"{_list(status.unmeasured)}"
        )
    if gaps := _open(status, wrench=True):
        changed = ", ".join(map(status.name, status.changed_sensors))
        use = f"Rows of {changed} are left out until the gap closes, or ~/reset" if changed else "Its rows are used"
        cause = "the sensor was tared, drifts, or the load has changed"
        sentences.append(f"{_gap_sentence(gaps)}: {cause}. {use}")
    for topic in status.topics:
        account, name = new.account(topic), status.name(topic)
        all_bad = account.received >= _MANY and account.accepted <= 0
        bad = {why: count for why, count in account.rejected.items() if all_bad or meaning_of(why) == "driver error"}
        sentences += _most_frequent(_refusals(name, Account(rejected=Counter(bad))))
        sentences += [f"{name}: {remark}" for remark in account.noted if meaning_of(remark) == "driver error"]
    return sentences


def _warnings(status: Status, new: Status) -> list[str]:
    sentences = list(status.warnings)
    if not status.topics:
        where = f" on {status.name(DESCRIPTION)}" if DESCRIPTION in status.names else ""
        missing = Advised(NO_DESCRIPTION + where, NO_DESCRIPTION.advice)
        return sentences if status.unconfigured else [*sentences, missing]
    if not status.active:
        return sentences
    silent = [status.name(topic) for topic in status.topics if new.account(topic).received == 0]
    if silent:
        sentences.append(Advised(f"no messages on {', '.join(silent)}", _NOTHING_COMES))
    accounts = {status.name(topic): account for topic, account in new.accounts.items()}
    refusals: dict[str, int] = {}
    for name, account in accounts.items():
        refusals |= _refusals(name, account)
    sentences += _most_frequent(refusals)
    sentences += _remarks(new)
    sentences += [f"{name} lost ({account.lost} messages)" for name, account in accounts.items() if account.lost]
    if len(status.unmeasured) < status.joints and status.unmeasured:
        sentences.append(
            f"{status.name(JOINT_STATES)}: no effort of {_list(status.unmeasured)}; its equation is left out"
        )
    if gaps := _open(status, wrench=False):
        sentences.append(_gap_sentence(gaps))
    if status.estimate is not None and not status.estimate.converged:
        sentences.append(status.estimate.reason)
    if new.rows_rejected[STANDING_STILL] > 0 and new.rows <= 0 and status.estimate is None:  # afterwards it may rest
        sentences.append(f"{STANDING_STILL}: no link is identifiable; move the robot")
    return sentences


def _remarks(new: Status) -> list[str]:
    return [f"{new.name(topic)}: {remark}" for topic, account in new.accounts.items() for remark in account.noted]


def _open(status: Status, *, wrench: bool) -> list[ChannelGap]:
    """Open gaps of wrench channels, or of all others."""
    gaps = (gap for gap in status.gaps if gap.since is not None)
    return [gap for gap in gaps if any(is_of(gap.channel, topic) for topic in status.topics) == wrench]


def _most_frequent(refusals: Mapping[str, int]) -> list[str]:
    return [f"{reason} ({count} messages)" for reason, count in Counter(refusals).most_common(MOST_LISTED)]


def _list(names: Sequence[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


AGAIN = 60.0  # [s] until a sentence is logged again
_MOST_KINDS = 200  # bound on remembered sentences, as names in them are from outside


class Console:
    """Log in which every entry is one printable line, whatever names it contains.

    A complaint is logged if two diagnostics in a row have it, and then once a minute; its end, if two in a row no
    longer have it. One-off events are logged at once, and the same ones at most once a minute. Sentences that differ
    only in numbers are the same; those in names are no numbers.
    """

    def __init__(self, log: Log) -> None:
        self._log = log
        self._before: set[str] = set()  # kinds of complaints of the last diagnostics
        self._lasting: dict[str, str] = {}  # complaints that were logged, by kind, until they end
        self._logged: dict[str, float] = {}

    def info(self, *messages: str) -> None:
        """Log normal progress."""
        self._log.info(self._entry(messages))  # rclpy allows one severity per line of code

    def warning(self, *messages: str) -> None:
        """Log a problem that allows operation to continue."""
        self._log.warning(self._entry(messages))

    def error(self, *messages: str) -> None:
        """Log an error."""
        self._log.error(self._entry(messages))

    def log_complaints(self, errors: Sequence[str], warnings: Sequence[str], events: Iterable[str] = ()) -> None:
        """Take the complaints of the present diagnostics; log those that last, those that are one-off ``events``, and
        the end of those that were logged as they lasted."""
        before, present, at_once = self._before, set[str](), {*map(_kind, events)}
        for log, sentences in ((self.error, errors), (self.warning, warnings)):
            kinds = {_kind(sentence): sentence for sentence in sentences}
            due = [kind for kind in kinds if kind in before | at_once and self._was_long_ago(kind)]
            if due:
                log(*(kinds[kind] for kind in due))
            self._lasting |= {kind: kinds[kind] for kind in due if kind in before}
            present |= kinds.keys()
        ended = [kind for kind in self._lasting if kind not in before | present]
        if ended:
            self.info(f"no longer: {'; '.join(self._lasting.pop(kind) for kind in ended)}")
        self._before = present

    def log_events(self, sentences: Iterable[str]) -> None:
        """Log one-off events."""
        for sentence in sentences:
            if self._was_long_ago(_kind(sentence)):
                self.info(sentence)

    def _was_long_ago(self, kind: str) -> bool:
        return time.monotonic() - self._logged.get(kind, -AGAIN) >= AGAIN

    def _entry(self, sentences: Sequence[str]) -> str:
        """Return the entry of sentences that are logged now, and remember when."""
        self._logged |= dict.fromkeys(map(_kind, sentences), time.monotonic())
        while len(self._logged) > _MOST_KINDS:
            self._logged.pop(min(self._logged, key=self._logged.__getitem__))
        advised = (f"{text} ({text.advice})" if isinstance(text, Advised) else text for text in sentences)
        return node_line("; ".join(advised))


def _kind(sentence: str) -> str:
    return re.sub(r"\b\d+(\.\d+)?(e[-+]\d+)?", "#", sentence)


_MASS = QUANTITIES[0]


class StatusEvents:
    """Compares the present status with that of a second ago."""

    def __init__(self) -> None:
        self._before = Status(active=False)
        self._coming: dict[str, int] = {}  # consecutive seconds with data, by topic
        self._reported: set[str] | None = None  # links whose mass was reported; None before the first estimate

    def since(self, status: Status) -> Iterator[str]:
        """Yield sentences on what is new in the ``status`` of the next second."""
        accepted = {topic: account.accepted for topic, account in status.since(self._before).accounts.items()}
        self._before, estimate = status, status.estimate
        self._coming = {topic: self._coming.get(topic, 0) + 1 for topic, count in accepted.items() if count > 0}
        for topic in self._coming:
            if self._coming[topic] == 2:
                yield f"{status.name(topic)}: receiving {accepted[topic]} messages/s"
        if estimate is None:
            self._reported = None
            return
        identified = {link.name: link for link in estimate.links if _MASS in link.identified}
        if self._reported is None:
            self._reported = set()
            yield _first(estimate, identified.values())
        elif new := [link for name, link in identified.items() if name not in self._reported]:
            yield f"identified: {_abridged(map(_mass, new))}"
        self._reported.update(identified)


def _first(estimate: Estimate, identified: Iterable[LinkEstimate]) -> str:
    masses = _abridged(map(_mass, identified))
    rest = _abridged(link.name for link in estimate.links if _MASS not in link.identified)
    sentence = f"first estimate, from {estimate.rows_accepted} rows"
    sentence += f"; identified: {masses}" if masses else "; no mass is individually identifiable yet"
    return sentence + (f"; not identified yet: {rest}" if masses and rest else "")


def _mass(link: LinkEstimate) -> str:
    return f"{link.name} {link.mass:.3f} ± {link.std_mass:.3f} kg"


def _abridged(texts: Iterable[str]) -> str:
    names = [*texts]
    rest = f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
    return ", ".join(names[:MOST_LISTED]) + rest
