"""Features of what a model lacks."""

import numpy as np
import pytest

from geomid_ros.gap.features import Features, features
from geomid_ros.gap.linearised_problem import LinearisedProblem
from geomid_ros.gap.records import Records
from geomid_ros.inference.fit import fit_of_prior

from . import planted

MODEL = planted.model()
RECORDS = Records.make([planted.recording(planted.rigid(planted.true_inertias(1, 0.1)), 1, 20.0)], planted.CUTOFF)
PROBLEM = LinearisedProblem.at(MODEL, RECORDS, fit_of_prior(planted.prior()))


@pytest.fixture(scope="module")
def own() -> Features:
    return features(MODEL, PROBLEM.records, PROBLEM.situation, 1, PROBLEM.basis)


def of_variable(own: Features, variable: str) -> np.ndarray:
    chosen = [k for k, name in enumerate(own.depends_on) if name == variable]
    return own.columns[:, np.isin(own.block, chosen)]


def unexplained(columns: np.ndarray, values: np.ndarray) -> float:
    """Share of the values' size that no sum of the columns is."""
    left = values - columns @ np.linalg.lstsq(columns, values, rcond=1e-9)[0]
    return float(np.linalg.norm(left) / np.linalg.norm(values))


def test_every_variable_on_which_a_remainder_may_depend_has_features(own: Features) -> None:
    others = {name for name in MODEL.robot.joint_names if name != MODEL.robot.joint_names[1]}
    said = {"velocity", "position", "load", "time", "acceleration", "reversals"}
    assert set(own.depends_on) == said | others
    assert set(own.block.tolist()) == set(range(len(own.depends_on)))
    assert len(own.columns) == len(PROBLEM.records.samples)


@pytest.mark.parametrize("waves", [2, 32])
def test_cogging_is_a_feature_of_position(own: Features, waves: int) -> None:
    cogging = np.sin(waves * PROBLEM.records.samples.position[:, 1] + 0.3)
    assert unexplained(of_variable(own, "position"), cogging) < 1e-9


def test_a_drift_and_friction_that_warms_up_are_features_of_time(own: Features) -> None:
    samples = PROBLEM.records.samples
    time = (samples.stamps - samples.stamps[0]) / (samples.stamps[-1] - samples.stamps[0])
    columns = np.column_stack([of_variable(own, "time"), samples.velocity[:, 1]])
    assert unexplained(columns, 0.3 * time) < 1e-9
    assert unexplained(columns, (1.0 - 0.4 * time) * samples.velocity[:, 1]) < 1e-9


def test_what_another_joint_does_is_a_feature_of_it(own: Features) -> None:
    name, samples = MODEL.robot.joint_names[0], PROBLEM.records.samples
    pull = samples.velocity[:, 0] + np.cos(samples.position[:, 0] - samples.position[:, 1])
    assert unexplained(of_variable(own, name), pull) < 1e-9
