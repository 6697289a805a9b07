"""What is found does not depend on how the robot is written down."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.frames import rewritten

from geomid_ros.gap.result import GapResult
from geomid_ros.gap.workflow import find_gap
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot

from . import planted

SAME = 1e-3  # of a standard deviation, or relative: the fits end at a tolerance
URDF = (planted.BAGS / "arm3.urdf").read_text(encoding="utf-8")


def found(model: MeasurementModel, unit: float) -> GapResult:
    """With friction at the second joint; efforts times ``unit``."""
    rigid = planted.rigid(planted.true_inertias(71, 0.2))
    parts = [
        planted.recording(lambda q, v, a: rigid(q, v, a) + np.array([0.0, 0.3, 0.0]) * v, seed, seconds)
        for seed, seconds in ((71, 30.0), (72, 12.0))
    ]
    train, held_out = (replace(part, effort=unit * part.effort) for part in parts)
    return find_gap(model, [train], [held_out])


@pytest.mark.parametrize(("length", "mass"), [(1.0, 1.0), (100.0, 1000.0)], ids=["m kg", "cm g"])
def test_frames_and_units_do_not_matter(length: float, mass: float) -> None:
    other, unit = rewritten(URDF, 5, length, mass), mass * length**2
    there_model = MeasurementModel(Robot(other.urdf, gravity=np.array([0.0, 0.0, -9.81 * length])), ())
    here, there = found(planted.model(), 1.0), found(there_model, unit)
    assert there.verdict == here.verdict == "named"
    for one, two in zip(here.findings, there.findings, strict=True):
        assert (two.effect, two.joint, two.confidence) == (one.effect, one.joint, one.confidence)
        for name, quantity in one.parameters.items():
            assert abs(two.parameters[name].value / unit - quantity.value) < SAME * quantity.std
            assert two.parameters[name].std == pytest.approx(unit * quantity.std, rel=SAME)
    np.testing.assert_allclose(there.floor, unit * here.floor, rtol=SAME)
    np.testing.assert_allclose(there.gap.after, here.gap.after, rtol=SAME)
    for body, one, two in zip(here.bodies, here.inertias, there.inertias, strict=True):
        expected = pseudo_inertia.from_parameters(other.parameters(body, one))
        assert spd.distance(expected, pseudo_inertia.from_parameters(two)) < 10.0 * SAME
