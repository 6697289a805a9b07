"""What diagnostics say is what was counted since the last ones, topic by topic."""

from __future__ import annotations

import copy
from collections import Counter
from dataclasses import replace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from geomid_ros.live.status import Status
from geomid_ros.ros.diagnostics import NO_DESCRIPTION, Diagnostics
from geomid_ros.signals.ledger import Account, Ledger, Reason, driver_error

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
TOPICS = ("joint_states", "/wrench")


def status(accounts: dict[str, Account] | None = None, **values: Any) -> Status:
    """Of a node that hears both topics."""
    heard = {topic: Account(accepted=20) for topic in TOPICS}
    return Status(active=True, topics=TOPICS, accounts=heard | (accounts or {}), **values)


def refused(accepted: int = 0, **rejected: int) -> Account:
    return Account(accepted=accepted, rejected=Counter(rejected))


BEFORE = status({"/wrench": Account(accepted=20, rejected=Counter({"late": 3}), noted=Counter({"odd": 1}), lost=4)})
AFTER = status(
    {
        "joint_states": Account(accepted=30),
        "/wrench": Account(accepted=30, rejected=Counter({"late": 5}), noted=Counter({"odd": 1}), lost=5),
    }
)
SILENT = status({"/wrench": Account(accepted=21)})
ODD = Account(accepted=5, rejected=Counter({"x dropped: y": 2}), dropped=Counter({"z": 1}))
FAILED = status(failures=Counter({"a callback failed": 1}))
LOCK = refused(1, **{"joint 'a' is missing: set locked_joints (--lock)": 2})
BOTH = {"joint_states": refused(1, late=30), "/wrench": refused(late=30)}
# Statuses of a node, one after the other, and what the last diagnostics say.
SAID: dict[str, tuple[list[Status], bytes, str]] = {
    "a robot that stands still, of which all is known, is well": (
        [status(rows=9, rows_rejected=Counter({"not measured": 70}))],
        OK,
        "collecting rows",
    ),
    "a topic or a reason that reads like a key of something else changes nothing": (
        [status({"/a lost": ODD})],
        WARN,
        "/a lost rejected: x dropped: y (2 messages); /a lost dropped: z (1 messages)",
    ),
    "all that is new": ([BEFORE], WARN, "/wrench rejected: late (3 messages); /wrench: odd; /wrench lost (4 messages)"),
    "only what is new": ([BEFORE, AFTER], WARN, "/wrench rejected: late (2 messages); /wrench lost (1 messages)"),
    "who is silent": ([status(), SILENT], WARN, "no messages on joint_states"),
    "by the name that it has": (
        [status(), replace(SILENT, names={"joint_states": "/left/arm/states"})],
        WARN,
        "no messages on /left/arm/states",
    ),
    "nine messages": ([status({"/wrench": refused(late=9)})], WARN, "/wrench rejected: late (9 messages)"),
    "ten messages of which none is taken": (
        [status({"/wrench": refused(late=10)})],
        ERROR,
        "/wrench rejected: late (10 messages)",
    ),
    "an error of one topic hides no warning of another": (
        [status(BOTH)],
        ERROR,
        "/wrench rejected: late (30 messages); joint_states rejected: late (30 messages)",
    ),
    "no effort at all is one sentence": (
        [status(joints=2, unmeasured=("a", "b"))],
        ERROR,
        "joint_states: no effort is measured at any joint, no joint equation is used: 'a', 'b'",
    ),
    "options of the command line are not named": (
        [status({"/wrench": LOCK})],
        WARN,
        "/wrench rejected: joint 'a' is missing: set locked_joints (2 messages)",
    ),
    "an exception": ([FAILED], ERROR, "a callback failed"),
    "is told once": ([FAILED, FAILED], WARN, "no messages on joint_states, /wrench"),
    "a message that was accepted waited in vain": (
        [status(), status({"/wrench": refused(19, **{"in vain": 1})})],
        WARN,
        "no messages on joint_states, /wrench; /wrench rejected: in vain (1 messages)",
    ),
}


@pytest.mark.parametrize("case", SAID)
def test_what_was_counted_since_the_last_diagnostics_is_said(case: str) -> None:
    statuses, level, message = SAID[case]
    diagnostics = Diagnostics("geomid")
    *_, last = [diagnostics.array(each).status[0] for each in statuses]
    assert (last.level, last.message) == (level, message)


def test_all_counts_are_counted_from_an_earlier_status() -> None:
    before = status(rows=5, rows_made=9, rows_rejected=Counter({"a": 4}), failures=Counter({"f": 1}))
    after = status(rows=7, rows_made=14, rows_rejected=Counter({"a": 7}), failures=Counter({"f": 3}))
    new = after.since(before)
    assert (new.rows, new.rows_made, new.rows_rejected, new.failures) == (2, 5, {"a": 3}, {"f": 2})


@pytest.mark.parametrize("remark", [Reason("odd", "told"), driver_error("odd")])
def test_a_remark_is_an_event(remark: str) -> None:
    """Of whatever level."""
    diagnostics = Diagnostics("geomid")
    diagnostics.array(status({"joint_states": Account(accepted=20, noted=Counter({remark: 1}))}))
    assert diagnostics.remarks == [f"joint_states: {remark}"]
    assert {*diagnostics.remarks} <= {*diagnostics.errors, *diagnostics.warnings}


def test_a_sentence_with_advice_can_be_counted_and_copied() -> None:
    """The ledger hands out copies: one that failed would silence all diagnostics."""
    ledger = Ledger()
    ledger.drop("joint_states", NO_DESCRIPTION)
    assert ledger.topics["joint_states"].dropped == {"no robot description yet": 1}
    assert copy.deepcopy(NO_DESCRIPTION).advice == NO_DESCRIPTION.advice


@pytest.mark.parametrize("silent", ["", "/wrench"])
def test_90_messages_of_which_nothing_comes_are_a_warning(silent: str) -> None:
    """Once that lasts longer than the filter needs, and until rows come, or nothing is accepted: then something else is
    wrong, and said."""

    def warned(second: int, rows: int) -> list[str]:
        accounts = {topic: Account(accepted=0 if topic == silent else 100 * second) for topic in TOPICS}
        diagnostics.array(Status(active=True, topics=TOPICS, accounts=accounts, rows_made=rows, lag=0.5))
        return [warning for warning in diagnostics.warnings if "yielded no rows" in warning]

    diagnostics = Diagnostics("node")
    told = [warned(second, 5) for second in range(12)]
    assert [bool(warning) for warning in (*told[:5], *told[6:])] == 5 * [False] + 6 * [True]
    clocks = "check that joint_states and /wrench are stamped by the same clock"
    assert told[-1][0].endswith(f": none is accepted on {silent}" if silent else f": {clocks}")
    assert not any(warned(12, 6) for _ in range(10))
