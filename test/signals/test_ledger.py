"""The accounts of messages."""

from __future__ import annotations

import copy
import pickle
from collections import Counter

from geomid_ros.signals.ledger import Account, Ledger, Reason, count_reason, driver_error, meaning_of

TOPIC, OTHER = "joint_states", "/wrench"


def account(accepted: int, *reasons: str, lost: int = 0) -> Account:
    """With each reason counted once: rejected, dropped, and noted twice."""
    return Account(accepted, Counter(reasons), Counter(reasons), Counter(dict.fromkeys(reasons, 2)), lost)


def test_every_message_is_counted_once() -> None:
    ledger = Ledger()
    for _ in range(3):
        ledger.accept(TOPIC)
    ledger.reject(TOPIC, "a")
    ledger.reject(TOPIC, "a")
    ledger.drop(TOPIC, "b")
    ledger.note(TOPIC, "c")
    ledger.lose(TOPIC, 4)
    ledger.lose(TOPIC, 1)
    ledger.accept(OTHER, 2)
    ledger.revoke(OTHER, "too late")
    ledger.topics[TOPIC].rejected["a"] = 9
    assert ledger.topics[TOPIC] == Account(3, Counter(a=2), Counter(b=1), Counter(c=1), 5), "others get copies"
    assert ledger.topics[TOPIC].received == 6, "what is noted was accepted, and what is lost never came"
    assert ledger.topics[OTHER] == Account(1, Counter({"too late": 1}))


def test_since_another_time_is_the_difference() -> None:
    """Without the reasons that were not given again."""
    before = account(3, "a", lost=2)
    after = Account(10, Counter(a=4, b=1), Counter(a=1), Counter(a=2, c=1), 7)
    assert after.since(before) == Account(7, Counter(a=3, b=1), Counter(), Counter(c=1), 5)
    assert after.since(Account()) == after


def test_what_an_earlier_process_counted_is_added_but_not_to_what_this_one_has_counted_itself() -> None:
    ledger = Ledger()
    ledger.drop(TOPIC, "a")
    ledger.lose(TOPIC, 1)
    ledger.note(TOPIC, "a")
    ledger.restore({TOPIC: account(5, "a", "b", lost=3), OTHER: account(1)})
    assert ledger.topics[TOPIC] == Account(5, Counter(a=1, b=1), Counter(a=2, b=1), Counter(a=3, b=2), 4)
    assert ledger.topics[OTHER] == Account(accepted=1)
    for count in (lambda own: own.accept(OTHER), lambda own: own.reject(OTHER, "a")):
        ledger = Ledger()
        count(ledger)
        before = ledger.topics
        ledger.restore({TOPIC: account(5, "a")})
        assert ledger.topics == before


def test_nonsense_does_not_fill_the_memory() -> None:
    """Fifty reasons, each of two hundred characters; those that are known go on being counted."""
    reasons: Counter[str] = Counter()
    for index in range(60):
        count_reason(reasons, f"reason {index}")
    count_reason(reasons, "reason 3")
    assert len(reasons) == 51
    assert (reasons["other reasons"], reasons["reason 3"], reasons.total()) == (10, 2, 61)
    long: Counter[str] = Counter()
    for length in (200, 201, 300):
        count_reason(long, length * "x")
    assert long == {200 * "x": 1, 200 * "x" + "...": 2}


def test_what_follows_from_a_reason_survives_counting_copies_and_processes() -> None:
    ledger, other = Ledger(), Ledger()
    for reason in (driver_error("no joint names"), Reason("x" * 1000, "told"), "late"):
        ledger.reject(TOPIC, reason)
    other.add(pickle.loads(pickle.dumps(copy.deepcopy(ledger.topics))))
    for accounts in (ledger.topics, other.topics, {TOPIC: other.topics[TOPIC].since(Account()).plus(Account())}):
        meanings = [meaning_of(reason) for reason in accounts[TOPIC].rejected]
        assert meanings == ["driver error", "told", ""]
        assert "driver error: no joint names" in accounts[TOPIC].rejected
    assert driver_error("no joint names").sentence == "no joint names"
