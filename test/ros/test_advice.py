"""Sentences of diagnostics that carry advice."""

from __future__ import annotations

import copy

import pytest

from geomid_ros.signals.ledger import Ledger

pytest.importorskip("rclpy")

from geomid_ros.ros.diagnostics import NO_DESCRIPTION


def test_a_sentence_with_advice_can_be_counted_and_copied() -> None:
    """The ledger hands out copies: one that failed would silence all diagnostics."""
    ledger = Ledger()
    ledger.drop("joint_states", NO_DESCRIPTION)
    assert ledger.topics["joint_states"].dropped == {"no robot description yet": 1}
    assert copy.deepcopy(NO_DESCRIPTION).advice == NO_DESCRIPTION.advice
