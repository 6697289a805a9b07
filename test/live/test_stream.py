"""The path of what is streamed: each message is predicted as it comes, as pinocchio and the rows predict it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from excitation.motions import lively
from files.recordings import BAGS, TYPES

import geomid_ros
from geomid_ros.api.identify import Identification
from geomid_ros.estimation.estimate import Estimate, Predictor
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.live.effort_predictor import EffortPredictor, Predicted
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


def stream_of(session: Session, estimate: Estimate) -> EffortPredictor:
    stream = EffortPredictor()
    stream.set_model(session, estimate)
    return stream


def as_described(estimate: Estimate, session: Session) -> Estimate:
    """The inertias of the session's description, without effects."""
    model = session.model
    return replace(estimate, predictor=Predictor(model.nominal_parameters, np.ones(len(model.channels))))


def motion_of(found: Iterable[Predicted]) -> FloatArray:
    """Positions, velocities and accelerations ``(3, N, joints)``."""
    return np.concatenate([predicted.motion for predicted in found], axis=1)


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
    stream, sent = stream_of(session, estimate), messages(names, velocities)
    found = [p for begin in range(0, len(sent), together) for p in stream.predict(sent[begin : begin + together])]
    assert np.concatenate([p.stamps for p in found]).tolist() == [round(1e9 * time) for time in TIMES]
    assert {predicted.joints for predicted in found} == {JOINTS}
    motion, seen = exact(), motion_of(found)
    np.testing.assert_allclose(seen[:2, 1:], motion[:2, 1:], atol=0.02)
    np.testing.assert_allclose(seen[2, 50:], motion[2, 50:], atol=0.1 * np.max(np.abs(motion[2])))
    expected = session.model.predicted_efforts(samples_of(motion), *estimate.predictor)
    errors = np.concatenate([predicted.efforts for predicted in found]) - expected
    sizes = np.sqrt(np.mean(expected**2, axis=0))
    assert np.all(np.sqrt(np.mean(errors[50:] ** 2, axis=0)) < 0.05 * np.max(sizes))


def test_efforts_are_those_of_the_rows(identification: Identification) -> None:
    """At any parameters, with all effects that a model may have, those that depend on loads, too; of a tilt those under
    gravity of that direction, with which rows are linear."""
    model = identification.session.model
    assert len({coefficient.effect.name for coefficient in model.coefficients}) > 6
    random = np.random.default_rng(3)
    coefficients = random.uniform(0.1, 1.0, len(model.coefficients))
    parameters = np.append(model.nominal_inertias * random.uniform(0.5, 2.0), coefficients)
    model = model.with_drive_gains(random.uniform(0.5, 2.0, len(model.channels)))
    states = random.normal(size=(3, 40, 3))
    tilts = [c.effect.turns_gravity for c in model.coefficients]
    assert np.count_nonzero(tilts) == 2
    level = np.append(parameters[: -len(tilts)], np.where(tilts, 0.0, coefficients))
    turned = model.with_gravity(model.gravity_at(parameters))
    expected = turned.predicted_efforts(samples_of(states), level)
    np.testing.assert_allclose(InverseDynamics(model, parameters)(states), expected, atol=1e-9)


def test_efforts_are_in_the_unit_of_the_messages(identification: Identification) -> None:
    urdf, found = (BAGS / "arm3.urdf").read_text(encoding="utf-8"), []
    for gains in ({f"joint.{joint}.effort_gain": gain for joint, gain in GAINS.items()}, {}):
        session = Session(urdf, Configuration({"candidates": [], **gains}), "arm3.urdf")
        estimate = as_described(identification.estimate, session)
        found.append(next(stream_of(session, estimate).predict(messages())).efforts)
    np.testing.assert_allclose(found[0] * [*GAINS.values()], found[1], atol=1e-9)


def test_what_is_carried_is_predicted_until_it_is_put_down(identification: Identification) -> None:
    """At once, whether an estimate comes before it or after it."""
    session, estimate = identification.session, identification.estimate
    stream, sent = EffortPredictor(), messages()
    columns = slice(len(session.model.nominal_inertias) - 10, len(session.model.nominal_inertias))
    body = pseudo_inertia.parameters_of(np.array([1.5, 0.0, 0.0, 0.1, 1e-2, 0.0, 1e-2, 0.0, 0.0, 1e-2]))
    heavier = estimate.predictor.parameters.copy()
    heavier[columns] += body
    carried = CarriedPayload("tool", columns, body, np.eye(10), 0, 0, 0)
    stream.set_payload(carried)
    stream.set_model(session, estimate)
    for parameters in (heavier, estimate.predictor.parameters):
        found = list(stream.predict(sent))
        expected = session.model.predicted_efforts(
            samples_of(found[0].motion), parameters, estimate.predictor.drive_gains
        )
        np.testing.assert_allclose(found[0].efforts, expected, atol=1e-6)
        stream.set_payload(None)


@pytest.mark.parametrize("velocities", [True, False])
def test_each_message_follows_the_one_before_however_many_come_at_once(
    velocities: bool, identification: Identification
) -> None:
    """A joint that turns around does not turn back at half a turn, and a new estimate disturbs no motion. Stamps that
    come twice or late change no acceleration."""
    urdf, random = (BAGS / "arm3.urdf").read_text(encoding="utf-8"), np.random.default_rng(1)
    endless = urdf.replace('<joint name="joint2" type="revolute">', '<joint name="joint2" type="continuous">')
    session = Session(endless, identification.session.configuration, "endless")
    estimate = as_described(identification.estimate, session)
    position, velocity, _ = exact()
    turned = position.copy()
    turned[:, 1] = np.remainder(turned[:, 1] - np.median(turned[:, 1]), 2.0 * np.pi)
    assert np.max(np.abs(np.diff(turned[:, 1]))) > 6.0
    speeds = velocity if velocities else velocity[:, :0]
    sent, plain = (
        [message(round(1e9 * time), JOINTS, *row) for time, *row in zip(TIMES, where, speeds, strict=True)]
        for where in (turned, position)
    )
    expected = motion_of(stream_of(session, estimate).predict(plain))
    for places in (np.arange(len(sent)), np.repeat(np.arange(len(sent)), 2), np.insert(np.arange(len(sent)), 500, 480)):
        stream, found, ends = EffortPredictor(), list[Predicted](), np.sort(random.choice(len(places), 40))
        for part in np.split(places, ends):
            stream.set_model(session, estimate)
            found += stream.predict([sent[place] for place in part])
        motion = motion_of(found)
        np.testing.assert_array_equal(motion[0], turned[places])
        newest = np.maximum.accumulate(places)
        np.testing.assert_allclose(motion[2], expected[2, newest], rtol=1e-9, atol=1e-9)
        late = places < newest
        np.testing.assert_allclose(motion[1, ~late], expected[1, places[~late]], rtol=1e-9, atol=1e-9)


def test_the_acceleration_is_that_of_a_first_order_low_pass(identification: Identification) -> None:
    """It is forgotten after a pause, and if the clock is set back so far."""
    stream, times = stream_of(identification.session, identification.estimate), 0.002 * np.arange(100)
    settings = identification.session.signals
    time_constant = 1.0 / (np.pi * SAMPLES_PER_CUTOFF_PERIOD * settings.cutoff)
    for begin in (10.0, 10.2 + 1e-9 * settings.max_gap_ns, 1.0):
        sent = [message(round(1e9 * (begin + t)), JOINTS, np.full(3, t), np.full(3, 3.0 * t)) for t in times]
        expected = 3.0 * (1.0 - np.exp(-times / time_constant))
        np.testing.assert_allclose(
            motion_of(stream.predict(sent))[2], expected[:, None] * np.ones(3), rtol=1e-6, atol=1e-9
        )


def test_a_clock_may_begin_at_zero(identification: Identification) -> None:
    """Of the first message no acceleration is known."""
    stream = stream_of(identification.session, identification.estimate)
    first = next(stream.predict(messages(first=0.001)[:2]))
    np.testing.assert_array_equal(first.motion[2, 0], 0.0)


def test_another_robot_begins_anew(identification: Identification) -> None:
    urdf, sent = (BAGS / "arm3.urdf").read_text(encoding="utf-8"), messages()
    locked = Session(urdf, Configuration({"locked_joints": ["joint2"]}), "locked")
    estimate = as_described(identification.estimate, locked)
    used = stream_of(identification.session, identification.estimate)
    assert [*used.predict(sent[:10])]
    used.set_model(locked, estimate)
    found = [motion_of(stream.predict(sent[10:20])) for stream in (used, stream_of(locked, estimate))]
    assert found[0].shape == (3, 10, 2)
    np.testing.assert_array_equal(*found)


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
