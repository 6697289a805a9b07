"""Channels and recordings of which nothing can be said."""

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.gap.evidence.record import Records
from geomid_ros.gap.workflow import find_gap
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import REST, Samples
from geomid_ros.types import FloatArray

from . import planted

SEED, JOINT = 20, 1


def coulomb(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """An arm with Coulomb friction at one joint."""
    efforts = planted.rigid(planted.true_inertias(SEED, 0.1))(q, v, a)
    efforts[:, JOINT] += 0.3 * np.sign(v[:, JOINT])
    return efforts


def unmeasured(samples: Samples, joints: Sequence[int]) -> Samples:
    effort = samples.effort.copy()
    effort[:, list(joints)] = np.nan
    return replace(samples, effort=effort)


TRAIN, UNSEEN = planted.recording(coulomb, SEED), planted.recording(coulomb, SEED + 1000, 15.0)


@pytest.mark.parametrize("unseen", [unmeasured(UNSEEN, range(3)), UNSEEN.select(slice(0, 8))], ids=["nothing", "short"])
def test_unseen_data_that_judge_nothing_are_refused(unseen: Samples) -> None:
    with pytest.raises(InputError, match="nothing to judge on"):
        find_gap(planted.model(), [TRAIN], [unseen])


def test_a_joint_of_which_nothing_is_measured_is_left_out_without_a_word() -> None:
    rest = [0, 2]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = find_gap(planted.model(), [unmeasured(TRAIN, [JOINT])], [unmeasured(UNSEEN, [JOINT])])
    assert result.verdict == "no gap"
    assert np.all(np.isfinite(result.gap.after[rest]))
    assert np.isnan(result.gap.after[JOINT])


def test_a_moment_without_an_effort_costs_that_moment_of_delayed_efforts() -> None:
    effort, missing = TRAIN.effort.copy(), slice(1000, 1010)
    effort[missing, JOINT] = np.nan
    records = Records.make([replace(TRAIN, effort=effort)], planted.CUTOFF)
    whole = Records.make([TRAIN], planted.CUTOFF)
    lag = 0.004  # [s]
    found, exact = (each.advanced(lag).dense[0].effort[:, JOINT] for each in (records, whole))
    known = np.isfinite(found)
    np.testing.assert_array_equal(np.flatnonzero(~known), [*range(999, 1010), len(TRAIN) - 1])
    away = known & (np.abs(np.arange(len(TRAIN)) - 1005) > 30)
    np.testing.assert_allclose(found[away], exact[away], atol=1e-6)


def test_what_a_force_plate_measures_counts_while_joints_stand_still() -> None:
    urdf = (planted.BAGS / "arm3.urdf").read_text(encoding="utf-8")
    plate = WrenchSensor("/plate", "world", "external")
    model = MeasurementModel(Robot(urdf, floating_base=True), (), (plate,))
    effects = TRAIN.effects.copy()
    entries = TRAIN.entries
    for column in entries.columns:  # at rest all the time
        if JOINT in entries.of(column)[1]:
            effects[:, entries.at(column, JOINT)] = column == REST
    records = Records.make([replace(TRAIN, effects=effects)], planted.CUTOFF)
    targets = np.random.default_rng(1).normal(size=(len(records.samples), 6))
    assert not model.layout.efforts
    assert np.all(records.usable(model, targets))
    assert not np.any(records.usable(planted.model(), targets[:, :3])[:, JOINT])
