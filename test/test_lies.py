"""What SECURITY.md says of lies: who publishes efforts decides what is found, but makes no impossible body of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from files.recordings import BAGS, recorded
from signals.feeding import completed

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

ARM3 = (BAGS / "arm3.urdf").read_text(encoding="utf-8")
HONEST = [item.parsed for item in recorded(BAGS / "arm3") if item.topic == "/joint_states"]


def found(lie: Callable[[FloatArray], FloatArray]) -> Estimate:
    """What is identified from efforts that somebody has changed."""
    session = Session(ARM3, Configuration(), "arm3.urdf")
    lies = (replace(each, arrays=(*each.arrays[:2], lie(each.arrays[2]))) for each in HONEST)
    for samples in completed(session.pipeline, lies):
        session.identifier.add(samples)
    return session.identifier.solve()


def assert_possible(estimate: Estimate) -> None:
    """Every link is finite and has a density: Sigma, the second moment of mass, is positive definite."""
    for link in estimate.links:
        assert np.all(np.isfinite(link.parameters))
        second_moments = 0.5 * np.trace(link.inertia) * np.eye(3) - link.inertia
        assert link.mass > 0.0
        assert np.linalg.eigvalsh(second_moments).min() > 0.0


def test_efforts_three_times_as_large_are_believed() -> None:
    """Nothing in the data says otherwise: the bodies are possible, the solve converges, the masses are far off."""
    honest, lied = found(lambda effort: effort), found(lambda effort: 3.0 * effort)
    assert honest.converged
    assert lied.converged
    assert_possible(lied)
    for link, truth in zip(lied.links[1:], honest.links[1:], strict=True):
        assert 2.0 < link.mass / truth.mass < 4.0
        assert link.mass - truth.mass > 1.96 * link.std_mass


@pytest.mark.parametrize("factor", [-1.0, 1e6])
def test_absurd_efforts_make_no_impossible_body(factor: float) -> None:
    assert_possible(found(lambda effort: factor * effort))


def test_efforts_that_no_robot_measures_are_not_taken() -> None:
    with pytest.raises(InputError, match="no usable rows"):
        found(lambda effort: 1e12 * np.sign(effort))
