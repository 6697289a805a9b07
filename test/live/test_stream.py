"""The path of what is streamed: each message is predicted as it comes, as pinocchio and the rows predict it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from excitation.motions import lively
from files.recordings import BAGS, TYPES

import geomid_ros
from geomid_ros.api.identify import Identification
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.live.effort_predictor import EffortPredictor
from geomid_ros.model.dynamics import InverseDynamics
from geomid_ros.model.samples import samples_of
from geomid_ros.monitoring.payload_watch import CarriedPayload
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.signals.settings import SAMPLES_PER_CUTOFF_PERIOD
from geomid_ros.types import FloatArray

JOINTS = ("joint1", "joint2", "joint3")
RATE = 500.0  # Hz
MOTION = lively(JOINTS, 4.0, 0.4)
TIMES = np.arange(0.5, 3.5, 1.0 / RATE)
GAINS = {"joint1": 2.0, "joint2": -0.5, "joint3": 1.0}


@pytest.fixture(scope="module")
def identification() -> Identification:
    return geomid_ros.identify(BAGS / "arm3", BAGS / "arm3.urdf")


def exact() -> FloatArray:
    """Positions, velocities and accelerations ``(3, N, joints)``."""
    return np.array([MOTION.rows(TIMES, order) for order in range(3)])


def messages(names: tuple[str, ...] = JOINTS, velocities: bool = True, first: float = TIMES[0]) -> list[bytes]:
    position, velocity, _ = exact()
    order = [JOINTS.index(name) for name in names if name in JOINTS]
    return [
        message(round(1e9 * time), names, position[row, order], velocity[row, order] if velocities else np.zeros(0))
        for row, time in enumerate(TIMES - TIMES[0] + first)
    ]


def message(stamp: int, names: tuple[str, ...], position: FloatArray, velocity: FloatArray) -> bytes:
    """A message (CDR) at a ``stamp`` [ns], without efforts."""
    kinds, (seconds, nanoseconds) = TYPES.types, divmod(stamp, 10**9)
    own = kinds["sensor_msgs/msg/JointState"](
        header=kinds["std_msgs/msg/Header"](
            stamp=kinds["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds), frame_id=""
        ),
        name=list(names),
        position=position,
        velocity=velocity,
        effort=np.zeros(len(position)),
    )
    return bytes(TYPES.serialize_cdr(own, "sensor_msgs/msg/JointState"))


@pytest.mark.parametrize("together", [1, 7])
@pytest.mark.parametrize(("names", "velocities"), [(JOINTS, True), (JOINTS[::-1], True), (JOINTS, False)])
def test_messages_are_predicted_as_rows_predict_their_motion(
    together: int, names: tuple[str, ...], velocities: bool, identification: Identification
) -> None:
    """The acceleration lags by a few milliseconds; nothing else does."""
    session, estimate = identification.session, identification.estimate
    stream, sent = EffortPredictor(), messages(names, velocities)
    stream.set_model(session, estimate)
    found = [p for begin in range(0, len(sent), together) for p in stream.predict(sent[begin : begin + together])]
    assert np.concatenate([p.stamps for p in found]).tolist() == [round(1e9 * time) for time in TIMES]
    assert {predicted.joints for predicted in found} == {JOINTS}
    motion, seen = exact(), np.concatenate([p.motion for p in found], axis=1)
    np.testing.assert_allclose(seen[:2, 1:], motion[:2, 1:], atol=0.02)
    np.testing.assert_allclose(seen[2, 50:], motion[2, 50:], atol=0.1 * np.max(np.abs(motion[2])))
    expected = session.model.predicted_efforts(samples_of(motion), estimate.parameters)
    errors = np.concatenate([predicted.efforts for predicted in found]) - expected
    sizes = np.sqrt(np.mean(expected**2, axis=0))
    assert np.all(np.sqrt(np.mean(errors[50:] ** 2, axis=0)) < 0.05 * np.max(sizes))


def test_efforts_are_those_of_the_rows(identification: Identification) -> None:
    """At any parameters, with all effects that a model may have, those that depend on loads, too."""
    model = identification.session.model
    assert len({coefficient.effect.name for coefficient in model.coefficients}) > 6
    random = np.random.default_rng(3)
    coefficients = random.uniform(0.1, 1.0, len(model.coefficients))
    parameters = np.append(model.nominal_inertias * random.uniform(0.5, 2.0), coefficients)
    states = random.normal(size=(3, 40, 3))
    expected = model.predicted_efforts(samples_of(states), parameters)
    np.testing.assert_allclose(InverseDynamics(model, parameters)(states), expected, atol=1e-9)


def test_efforts_are_in_the_unit_of_the_messages(identification: Identification) -> None:
    options = {"gain": GAINS, "candidates": []}
    other = geomid_ros.identify(BAGS / "arm3", BAGS / "arm3.urdf", **options).session
    streams = EffortPredictor(), EffortPredictor()
    estimate = replace(identification.estimate, parameters=other.model.nominal_parameters)
    streams[0].set_model(other, estimate)
    plain = geomid_ros.identify(BAGS / "arm3", BAGS / "arm3.urdf", candidates=[]).session
    streams[1].set_model(plain, estimate)
    with_gains, without = (next(s.predict(messages())).efforts for s in streams)
    np.testing.assert_allclose(with_gains * [*GAINS.values()], without, atol=1e-9)


def test_what_is_carried_is_predicted_until_it_is_put_down(identification: Identification) -> None:
    """At once, whether an estimate comes before it or after it."""
    session, estimate = identification.session, identification.estimate
    stream, sent = EffortPredictor(), messages()
    columns = slice(len(session.model.nominal_inertias) - 10, len(session.model.nominal_inertias))
    body = pseudo_inertia.parameters_of(np.array([1.5, 0.0, 0.0, 0.1, 1e-2, 0.0, 1e-2, 0.0, 0.0, 1e-2]))
    heavier = estimate.parameters.copy()
    heavier[columns] += body
    carried = CarriedPayload("tool", columns, body, np.eye(10), 0, 0)
    stream.set_payload(carried)
    stream.set_model(session, estimate)
    for parameters in (heavier, estimate.parameters):
        found = list(stream.predict(sent))
        expected = session.model.predicted_efforts(samples_of(found[0].motion), parameters)
        np.testing.assert_allclose(found[0].efforts, expected, atol=1e-6)
        stream.set_payload(None)


def spoiled(random: np.random.Generator) -> list[tuple[int, FloatArray, FloatArray]]:
    """Stamps [ns], positions and velocities, some unknown, of a joint that turns around: stamps come twice, late, after
    a pause, and from a clock that is set back."""
    stamps = np.cumsum(random.integers(1, 4, 400)) * 1_000_000 + 5_000_000_000
    stamps[150:] += 700_000_000
    stamps[300:] -= 3_000_000_000
    position = np.cumsum(random.normal(0.0, 0.2, (400, 3)), axis=0)
    position[:, 1] = np.remainder(position[:, 1], 2.0 * np.pi)
    velocity = random.normal(size=(400, 3))
    velocity[random.uniform(size=velocity.shape) < 0.3] = np.nan
    sent = list(zip(stamps.tolist(), position, velocity, strict=True))
    for place in random.integers(5, 399, 60).tolist():
        sent[place : place + 1] = [sent[place], sent[place - random.integers(0, 4)]]
    return sent


def one_by_one(
    sent: list[tuple[int, FloatArray, FloatArray]], pause: int, time_constant: float, turning: int
) -> FloatArray:
    """Positions, velocities and accelerations ``(3, N, joints)`` by the definition, message by message."""
    found: list[FloatArray] = []
    latest, last = -pause, np.zeros((3, 3))
    for stamp, position, measured in sent:
        motion, step = np.array([position, measured, last[2]]), stamp - latest
        unknown = np.isnan(measured)
        if -pause < step <= 0:
            motion[1, unknown] = last[1, unknown]
            found.append(motion)
            continue
        if abs(step) >= pause:
            motion[1, unknown], motion[2] = 0.0, 0.0
        else:
            moved = position - last[0]
            moved[turning] -= 2.0 * np.pi * np.round(moved[turning] / (2.0 * np.pi))
            motion[1, unknown] = (moved / (1e-9 * step))[unknown]
            motion[2] += (1.0 - np.exp(-1e-9 * step / time_constant)) * (
                (motion[1] - last[1]) / (1e-9 * step) - last[2]
            )
        latest, last = stamp, motion
        found.append(motion)
    return np.stack(found, axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_each_message_follows_the_one_before_however_many_come_at_once(
    seed: int, identification: Identification
) -> None:
    random, urdf = np.random.default_rng(seed), (BAGS / "arm3.urdf").read_text(encoding="utf-8")
    endless = urdf.replace('<joint name="joint2" type="revolute">', '<joint name="joint2" type="continuous">')
    session = Session(endless, identification.session.configuration, "endless")
    sent, stream = spoiled(random), EffortPredictor()
    estimate = replace(identification.estimate, parameters=session.model.nominal_parameters)
    data = [message(stamp, JOINTS, position, velocity) for stamp, position, velocity in sent]
    found, begin = list[FloatArray](), 0
    while begin < len(data):
        stream.set_model(session, estimate)  # a new estimate does not disturb the motion
        end = begin + int(random.choice([1, 2, 5, 60]))
        found += [predicted.motion for predicted in stream.predict(data[begin:end])]
        begin = end
    settings = session.signals
    time_constant = 1.0 / (np.pi * SAMPLES_PER_CUTOFF_PERIOD * settings.cutoff)
    expected = one_by_one(sent, settings.max_gap_ns, time_constant, 1)
    assert 0.3e9 < settings.max_gap_ns < 3e9
    scale = np.max(np.abs(expected), axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(np.concatenate(found, axis=1) / scale, expected / scale, atol=1e-12)


def test_a_clock_may_begin_at_zero(identification: Identification) -> None:
    """Of the first message no acceleration is known."""
    stream = EffortPredictor()
    stream.set_model(identification.session, identification.estimate)
    first = next(stream.predict(messages(first=0.001)[:2]))
    np.testing.assert_array_equal(first.motion[2, 0], 0.0)


def test_another_robot_begins_anew(identification: Identification) -> None:
    urdf, sent = (BAGS / "arm3.urdf").read_text(encoding="utf-8"), messages()
    locked = Session(urdf, Configuration({"locked_joints": ["joint2"]}), "locked")
    estimate = replace(identification.estimate, parameters=locked.model.nominal_parameters)
    streams = EffortPredictor(), EffortPredictor()
    streams[0].set_model(identification.session, identification.estimate)
    assert [*streams[0].predict(sent[:10])]
    found = []
    for stream in streams:
        stream.set_model(locked, estimate)
        found.append(np.concatenate([each.motion for each in stream.predict(sent[10:20])], axis=1))
    assert found[0].shape == (3, 10, 2)
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("velocities", [True, False])
def test_stamps_twice_and_in_the_wrong_order_change_no_acceleration(
    velocities: bool, identification: Identification
) -> None:
    def motion_of(sent: list[bytes]) -> FloatArray:
        stream = EffortPredictor()
        stream.set_model(identification.session, identification.estimate)
        return np.concatenate([predicted.motion for predicted in stream.predict(sent)], axis=1)

    sent = messages(velocities=velocities)
    plain = motion_of(sent)
    for places in (np.repeat(np.arange(len(sent)), 2), np.insert(np.arange(len(sent)), 500, [400, 499, 480])):
        found = motion_of([sent[place] for place in places])
        np.testing.assert_array_equal(found[0], plain[0, places])
        np.testing.assert_array_equal(found[2], plain[2, np.maximum.accumulate(places)])
        assert np.isfinite(found[1]).all()


def test_what_cannot_be_used_costs_itself(identification: Identification) -> None:
    """Messages of other joints, torn ones, and those after a pause, of which no acceleration is known."""
    stream, sent = EffortPredictor(), messages()
    assert [*stream.predict(sent[:3])] == []
    stream.set_model(identification.session, identification.estimate)
    torn = [b"", sent[0][:40], *messages(("joint1", "joint2", "elbow"))[:1]]
    assert sum(len(p.stamps) for p in stream.predict([*torn, *sent[:10]])) == 10
    assert stream.refused.total() == 1
    assert "joint 'joint3' is missing" in next(iter(stream.refused))
    (late,) = stream.predict(messages(first=1000.0)[:2])
    np.testing.assert_array_equal(late.motion[2, 0], 0.0)
    assert np.max(np.abs(late.motion[2, 1])) > 0.0
    stream.obstacle = "a robot before"
    stream.forget()
    assert (stream.ready, stream.obstacle, stream.refused.total()) == (False, "", 0)
    assert [*stream.predict(sent)] == []
