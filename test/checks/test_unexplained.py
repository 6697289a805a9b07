"""Channels that are badly explained are told: when, of what, and with what to look at."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands.running import found_only

from benchmarks.corruption.__main__ import judged
from benchmarks.corruption.faults import FAULTS
from benchmarks.corruption.recording import SOURCES, Recording
from checks.test_efforts import case
from geomid_ros import Identification, identify
from geomid_ros.checks.causes import Cause
from geomid_ros.checks.effort_data import EffortData
from geomid_ros.checks.unexplained import MOST, badly_explained, hint, rms, unexplained
from geomid_ros.signals.gates import LEAP
from geomid_ros.types import FloatArray

NAMES = ("shoulder", "elbow", "wrist")
INSTANTS = 400
VARIATION = np.array([10.0, 5.0, 0.1])
PLANT = {fault.name: fault.plant for fault in FAULTS}


def residuals(shares: tuple[float, float, float]) -> FloatArray:
    """Of efforts of standard deviations 10, 5 and 0.1 these shares are left."""
    left = np.random.default_rng(1).normal(size=(INSTANTS, 3))
    return left * shares * VARIATION / np.sqrt(np.mean(left**2, axis=0))


def told(left: FloatArray, units: tuple[str, ...] = ("N m",) * 3) -> list[Cause]:
    return badly_explained(
        [*zip(NAMES, units, strict=True)], rms(left), VARIATION, lambda joint, share: f"look at {joint}, {share:.2f}"
    )


def places(found: list[Cause]) -> tuple[str, ...]:
    return tuple(place for cause in found for place in cause.places)


def test_what_is_left_of_little_or_not_judged_is_not_told_and_the_worst_comes_first() -> None:
    """A wrist whose effort is all noise, beside a shoulder of a hundred times as much."""
    assert places(told(residuals((0.1, 0.1, 1.0)))) == ()
    assert places(told(residuals((0.1, 0.1, 1.0)), units=("N m", "N m", "N"))) == ("wrist",)
    assert places(told(residuals((0.6, 0.9, 0.1)))) == ("elbow", "shoulder")
    assert places(told(residuals((MOST - 0.02, MOST + 0.02, 0.1)))) == ("elbow",)
    (cause,) = told(residuals((0.1, 0.8, 0.1)))
    assert cause.sentence == "joint 'elbow' is not explained: 20 % (4 of 5 N m are left); look at elbow, 0.80"
    left = residuals((0.9, 0.9, 0.1))
    left[:, 1] = np.nan
    left[20:, 0] = np.nan
    assert places(told(left)) == ()


def test_what_is_planted_beside_links_and_friction_is_the_hint() -> None:
    """A coupling with another joint, a spring, and friction that drives; noise is nothing of these."""
    of = case("arm3", 1)
    names, own = of.model.robot.joint_names, of.samples
    size = 3.0 * np.std(own.effort[:, 1])
    hidden = {
        f"the effort of '{names[2]}': check a coupling": 4.0 * own.effort[:, 2],
        f"the position of '{names[1]}': check its axis": size * own.position[:, 1] ** 3,
        f"the speed of '{names[1]}': check the sign": -size * np.sign(own.velocity[:, 1]),
        "check the axis and the sign of the position in the URDF": size
        * np.random.default_rng(0).normal(size=len(own)),
    }
    for said, effort in hidden.items():
        measured = own.effort.copy()
        measured[:, 1] += effort
        recorded = replace(own, effort=measured).select(slice(None, None, len(own) // INSTANTS + 1))
        subject = EffortData.of_all(of.model.robot, recorded)
        assert said in hint(subject, names[1], float(subject.nominal.sigmas[1]))


def test_a_joint_that_stands_still_has_a_hint() -> None:
    of = case("arm3", 1)
    samples = of.samples.select(slice(None, None, len(of.samples) // INSTANTS + 1))
    still = {name: getattr(samples, name).copy() for name in ("position", "velocity", "acceleration")}
    still["position"][:, 1], still["velocity"][:, 1], still["acceleration"][:, 1] = 0.3, 0.0, 0.0
    noisy = samples.effort + 9.0 * np.eye(3)[1] * np.random.default_rng(0).normal(size=(len(samples), 1))
    subject = EffortData.of_all(of.model.robot, replace(samples, **still, effort=noisy))
    assert "check the axis and the sign" in hint(subject, subject.names[1], 1.0)


def test_what_a_model_without_friction_leaves_is_the_friction_s() -> None:
    """Not what one leaves that has it, nor what is left of a coupling."""
    of = case("arm3", 1)
    samples = of.samples.select(slice(None, None, len(of.samples) // INSTANTS + 1))
    subject = EffortData.of_all(of.model.robot, samples)
    spread, joint = 3.0 * subject.measured_std[1], subject.names[1]
    efforts = subject.measured + np.eye(len(subject.joints))[1] * spread * np.sign(samples.velocity[:, [1]])
    coupled = subject.measured + np.outer(4.0 * subject.measured[:, 2], np.eye(len(subject.joints))[1])
    rubbed, of_another = subject.with_efforts(efforts), subject.with_efforts(coupled)
    for of_efforts, share, said in ((rubbed, 0.9, True), (rubbed, 0.11, False), (of_another, 0.9, False)):
        assert ("friction (--effects)" in hint(of_efforts, joint, share)) == said


BEFORE = [
    ("ur10", "position frozen", (0, 0.15), "the position of joint 'shoulder_pan_joint' is frozen"),
    ("ur10", "parallel drive", 4, "the motor of joint 'wrist_2_joint' seems to drive 'wrist_3_joint', too: plus"),
    ("ur10", "two exchanged", (1, 2), "the efforts of joints 'shoulder_lift_joint' and 'elbow_joint' are swapped"),
    ("lwr4", "position turned round", 3, "joint 'lwr_3_joint' seems to turn opposite"),
    ("med7", "unit in mid-run", 0.07, "the efforts of all joints have 0.0"),
]


def identified(recording: Recording, bag: Path, **options: Any) -> Identification:
    """What is identified from a bag, without what else is made of it."""
    own = recording.source
    with pytest.MonkeyPatch.context() as patch:
        found_only(patch)
        return identify(bag, recording.urdf, config=dict(own.settings), wrench=own.wrench or (), **options)


@cache
def whole() -> Identification:
    """What is identified from the large arm's shipped recording."""
    return identified(Recording.read(SOURCES["arm7"]), SOURCES["arm7"].bag, candidates=[])


def planted(source: str, fault: str, size: Any, folder: Path) -> tuple[Recording, Path]:
    """A recording with a fault, and its bag."""
    if not SOURCES[source].bag.is_dir():
        pytest.skip(f"the measured recording is not at {SOURCES[source].bag}")
    recording = PLANT[fault](Recording.read(SOURCES[source]), size)
    return recording, recording.write(folder / "bag")


@pytest.mark.parametrize(("source", "fault", "size", "said"), BEFORE)
def test_faults_are_told_before_anything_is_solved(
    source: str, fault: str, size: Any, said: str, tmp_path: Path
) -> None:
    assert said in judged(*planted(source, fault, size, tmp_path)).review.findings[0].sentence


def test_what_no_links_explain_is_told_in_the_end(tmp_path: Path) -> None:
    verdict = identified(*planted("airbot", "axis of the URDF", 1, tmp_path)).verdict
    assert verdict.status == 4
    assert "'joint2' is not explained" in verdict.reasons[0]


@pytest.mark.parametrize(("fault", "size"), [("positions leap", 0.5), ("two robots", 1)])
def test_where_positions_leap_nothing_is_said_to_begin(fault: str, size: Any, tmp_path: Path) -> None:
    """Another recording does, perhaps of another robot: no unit changes, and nothing is picked up."""
    (finding,) = judged(*planted("arm7", fault, size, tmp_path)).review.findings
    assert LEAP.sentence in finding.sentence


def test_leaps_are_no_motion(tmp_path: Path) -> None:
    """They are told, and what was recorded between them is explained as well as ever."""
    found = identified(*planted("arm7", "positions leap", 0.5, tmp_path), candidates=[])
    assert len(found.verdict.reasons) == 1
    assert np.all(found.estimate.rms < 0.2 * whole().estimate.rms_nominal[: len(found.estimate.rms)])


def test_what_was_fitted_is_judged_too() -> None:
    """A part in which a joint is not explained, though what was held out is."""
    found = whole()
    assert found.verdict.status == 0
    model, sound = found.session.model, found.session.review.check.recorded
    assert sound is not None
    effort = sound.effort.copy()
    effort[: len(effort) // 2, 1] += 3.0 * np.std(effort[:, 1]) * np.sign(np.sin(np.arange(len(effort) // 2)))
    for recorded, expected in ((sound, ()), (replace(sound, effort=effort), ("joint2",))):
        assert places(unexplained(model, found.held_out, found.estimate.predictor, recorded)) == expected
