"""The node notices by itself what its robot picks up and puts down."""

from __future__ import annotations

from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import InertiaStamped

from geomid_ros.simulation.options import Hidden

from .observer import latched
from .spoiling import later
from .stage import NO_CHOICE, description, staged
from .test_payload import MASS, feed, simulated

MINUTE = 60_000_000_000  # [ns]


def test_a_payload_is_picked_up_and_put_down(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    bare, loaded = (
        simulated(tmp_path / f"{k}", k, *hide) for k, hide in ((1, ()), (2, [Hidden("payload", "tool", MASS)]))
    )
    with staged(tmp_path) as stage:
        node = stage.node({"robot_description": description("arm3"), **NO_CHOICE})
        carried = stage.observer.collect(InertiaStamped, "/geomid/payload/inertia", latched())
        said = stage.observer.collect(DiagnosticArray, "/diagnostics", 10)
        count = 0
        for turn, part in enumerate((bare, bare, loaded, bare)):
            count += len(part)
            feed(stage, [later(item, turn * MINUTE) for item in part], count)
            if part is loaded:
                stage.observer.wait_for(lambda: carried, "a payload")
                stage.observer.wait_for(lambda: _sentences(said), "a sentence on it")
        stage.observer.wait_for(lambda: carried[-1].inertia.m == 0.0, "that it was put down")
        assert node.end() == 0
    *bodies, _ = carried
    assert {message.header.frame_id for message in carried} == {"link3"}
    assert bodies[-1].inertia.m == pytest.approx(MASS, rel=0.05)
    assert "kg (95 %), at 'link3' since" in _sentences(said)[-1]


def _sentences(said: list[DiagnosticArray]) -> list[str]:
    return [status.message for array in said for status in array.status if status.name == "geomid: payload"]
