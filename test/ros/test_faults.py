"""What is wrong is said while it is."""

from __future__ import annotations

import numpy as np

from .stage import KINDS, NO_CHOICE, WRIST, Stage, description, messages

PARAMETERS = {**WRIST, **NO_CHOICE, "robot_description": description("arm3")}


def test_a_diagnostic_names_what_is_wrong_while_it_is(stage: Stage) -> None:
    node = stage.node(PARAMETERS)
    good = messages()
    nan = np.full(3, np.nan)
    bad = [item.changed(position=nan) if item.topic == "/joint_states" else item for item in good]
    stage.observer.publish(good[:200], KINDS)
    stage.observer.publish(bad[200:400], KINDS)
    reason = "joint_states rejected: position of 'joint1' not finite"
    stage.observer.diagnostics(lambda _, status: status.message.startswith(reason), reason)
    stage.observer.publish(good[400:], KINDS)
    last = stage.fed({"joint_states": 800, "/wrench": 800})
    stage.observer.diagnostics(lambda _, status: reason not in status.message, "it to be over")
    assert {pair.key: pair.value for pair in last.status[0].values}[reason] == "100", "it is still counted"
    assert node.end() == 0
    assert list(stage.folder.glob("process0/*")) == [], "without a folder nothing is written unasked"
