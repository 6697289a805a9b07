"""What a name closes where something else is left without a name."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geomid_ros.gap.judgement import closing
from geomid_ros.gap.result import GapResult
from geomid_ros.gap.search.beam_search import Search
from geomid_ros.gap.workflow import GapSettings, find_gap
from geomid_ros.types import FloatArray

from . import planted, small

SETTINGS = GapSettings(cutoff=planted.CUTOFF)
JOINT = planted.model().robot.joint_names[1]

Torque = Callable[[FloatArray, FloatArray], FloatArray]  # of position and velocity


def found(torque: Torque, seed: int) -> GapResult:
    """In an arm with a torque at its second joint."""
    rigid = planted.rigid(planted.true_inertias(seed, 0.1))

    def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        whole = rigid(q, v, a)
        whole[:, 1] += torque(q[:, 1], v[:, 1])
        return whole

    unseen = planted.recording(efforts, 100 + seed, 20.0)
    return find_gap(planted.model(), [planted.recording(efforts, seed)], [unseen], SETTINGS)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_name_is_sure_beside_cogging_that_a_curve_says(seed: int) -> None:
    """Cogging at the same joint has no name, and leaves more than the friction closes."""
    result = found(lambda q, v: 0.08 * np.sin(25.0 * q) + 0.1 * v, seed)
    (finding,) = result.findings
    assert (finding.effect, finding.joint, finding.confidence) == ("viscous_friction", JOINT, "confident")
    friction = finding.parameters["coefficient"]
    assert abs(friction.value - 0.1) < 3.0 * friction.std
    assert result.verdict == "unexplained"
    assert {entry.joint for entry in result.unexplained} == {JOINT}


@pytest.mark.parametrize("seed", [2, 3])
def test_dry_friction_is_sure_though_it_changes_with_position(seed: int) -> None:
    """A curve of position says that, and contains the dry friction."""
    result = found(lambda q, v: 0.4 * (1.0 + 0.3 * np.tanh(2.0 * q)) * np.tanh(v / 0.02), seed)
    finding = result.findings[0]
    assert (finding.effect, finding.joint, finding.confidence) == ("coulomb_friction", JOINT, "confident")
    assert finding.parameters["level"].value == pytest.approx(0.4, rel=0.2)
    assert finding.share > 0.5
    assert result.verdict == "unexplained"


@pytest.mark.parametrize("alike", [True, False])
def test_a_curve_contains_a_name_if_it_leaves_a_hundredth_of_it(alike: bool) -> None:
    name, curve = small.at("viscous_friction", 0), small.curve(0, "velocity", "curve")
    recording = small.Recording(1, [name, curve], {curve.terms[0]: name.terms[0]} if alike else None)
    search = Search(recording.design({name.terms[0]: 1.0}), small.PRIOR, [name], [curve])
    analysis: Any = SimpleNamespace(search=search)
    assert closing.contains(analysis, search.fit([]), curve, name) == alike


@pytest.mark.parametrize(("certainty", "moved"), [(100.0, False), (4.0, True)])
def test_without_a_payload_the_inertias_of_an_identified_robot_are_as_they_were(certainty: float, moved: bool) -> None:
    """Of a robot whose inertias are guessed they take its place."""
    prior = replace(small.PRIOR, spread=0.01, certainty=certainty)
    search = Search(small.Recording(1, []).design({}, link=1.5 * small.LINK), prior, [small.PAYLOAD])
    analysis: Any = SimpleNamespace(search=search)
    rest = closing.without(analysis, search.fit([small.PAYLOAD]), small.PAYLOAD)
    assert (rest.spreads[0] > 0.05) == moved
