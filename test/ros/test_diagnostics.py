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


def said(*statuses: Status) -> tuple[bytes, str]:
    """Level and message of the last of several diagnostics."""
    diagnostics = Diagnostics("geomid")
    for each in statuses:
        stream = diagnostics.array(each).status[0]
    return stream.level, stream.message


def test_rows_that_are_not_taken_are_no_refused_messages() -> None:
    """A robot that stands still, of which all is known, is well."""
    assert said(status(rows=9, rows_rejected=Counter({"not measured": 70})))[0] == OK


def test_each_topic_has_its_own_reasons() -> None:
    """A topic, or a reason, that reads like a key of something else changes nothing."""
    odd = Account(accepted=5, rejected=Counter({"x dropped: y": 2}), dropped=Counter({"z": 1}))
    level, message = said(status({"/a lost": odd}))
    assert level == WARN
    assert message == "/a lost rejected: x dropped: y (2 messages); /a lost dropped: z (1 messages)"


def test_what_was_told_is_not_told_again() -> None:
    before = status({"/wrench": Account(accepted=20, rejected=Counter({"late": 3}), noted=Counter({"odd": 1}), lost=4)})
    after = status(
        {
            "joint_states": Account(accepted=30),
            "/wrench": Account(accepted=30, rejected=Counter({"late": 5}), noted=Counter({"odd": 1}), lost=5),
        }
    )
    assert said(before) == (WARN, "/wrench rejected: late (3 messages); /wrench: odd; /wrench lost (4 messages)")
    assert said(before, after) == (WARN, "/wrench rejected: late (2 messages); /wrench lost (1 messages)")


def test_all_counts_are_counted_from_an_earlier_status() -> None:
    before = status(rows=5, rows_made=9, rows_rejected=Counter({"a": 4}), failures=Counter({"f": 1}))
    after = status(rows=7, rows_made=14, rows_rejected=Counter({"a": 7}), failures=Counter({"f": 3}))
    new = after.since(before)
    assert (new.rows, new.rows_made, new.rows_rejected, new.failures) == (2, 5, {"a": 3}, {"f": 2})


def test_who_is_silent_is_named() -> None:
    before = status()
    after = status({"/wrench": Account(accepted=21)})
    assert said(before, after) == (WARN, "no messages on joint_states")
    resolved = replace(after, names={"joint_states": "/left/arm/states"})
    assert said(before, resolved) == (WARN, "no messages on /left/arm/states")


@pytest.mark.parametrize("remark", [Reason("odd", "told"), driver_error("odd")])
def test_a_remark_is_an_event(remark: str) -> None:
    """Of whatever level."""
    diagnostics = Diagnostics("geomid")
    diagnostics.array(status({"joint_states": Account(accepted=20, noted=Counter({remark: 1}))}))
    assert diagnostics.remarks == [f"joint_states: {remark}"]
    assert {*diagnostics.remarks} <= {*diagnostics.errors, *diagnostics.warnings}


@pytest.mark.parametrize(("received", "level"), [(9, WARN), (10, ERROR)])
def test_many_messages_of_which_none_is_taken_are_an_error(received: int, level: bytes) -> None:
    found = said(status({"/wrench": Account(rejected=Counter({"late": received}))}))
    assert found == (level, f"/wrench rejected: late ({received} messages)")


def test_an_error_of_one_topic_hides_no_warning_of_another() -> None:
    """Of one nothing is taken, of the other only some."""
    some = Account(accepted=1, rejected=Counter({"late": 30}))
    level, message = said(status({"joint_states": some, "/wrench": Account(rejected=Counter({"late": 30}))}))
    assert level == ERROR
    assert message == "/wrench rejected: late (30 messages); joint_states rejected: late (30 messages)"


def test_no_effort_at_all_is_one_sentence() -> None:
    level, message = said(status(joints=2, unmeasured=("a", "b")))
    assert level == ERROR
    assert message.count("no effort") == 1


def test_options_of_the_command_line_are_not_named() -> None:
    lock = Account(accepted=1, rejected=Counter({"joint 'a' is missing: set locked_joints (--lock)": 2}))
    assert said(status({"/wrench": lock}))[1].endswith("set locked_joints (2 messages)")


def test_an_exception_is_told_once() -> None:
    before = status(failures=Counter({"a callback failed": 1}))
    assert said(before) == (ERROR, "a callback failed")
    assert "failed" not in said(before, before)[1]


def test_a_rejected_message_may_have_been_accepted_before() -> None:
    """It waited in vain: one is accepted less, one rejected more."""
    after = status({"/wrench": Account(accepted=19, rejected=Counter({"in vain": 1}))})
    assert "/wrench rejected: in vain (1 messages)" in said(status(), after)[1]


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
