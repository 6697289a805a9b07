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
from geomid_ros.live.stream import Stream
from geomid_ros.model.dynamics import InverseDynamics
from geomid_ros.model.samples import samples_of
from geomid_ros.monitoring.payload_watch import Carried
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
    kinds, (position, velocity, _) = TYPES.types, exact()
    order, found = [JOINTS.index(name) for name in names if name in JOINTS], []
    for row, time in enumerate(TIMES - TIMES[0] + first):
        seconds, nanoseconds = divmod(round(1e9 * time), 10**9)
        stamp = kinds["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        message = kinds["sensor_msgs/msg/JointState"](
            header=kinds["std_msgs/msg/Header"](stamp=stamp, frame_id=""),
            name=list(names),
            position=position[row, order],
            velocity=velocity[row, order] if velocities else np.zeros(0),
            effort=np.zeros(len(order)),
        )
        found.append(bytes(TYPES.serialize_cdr(message, "sensor_msgs/msg/JointState")))
    return found


@pytest.mark.parametrize("together", [1, 7])
@pytest.mark.parametrize(("names", "velocities"), [(JOINTS, True), (JOINTS[::-1], True), (JOINTS, False)])
def test_messages_are_predicted_as_rows_predict_their_motion(
    together: int, names: tuple[str, ...], velocities: bool, identification: Identification
) -> None:
    """The acceleration lags by a few milliseconds; nothing else does."""
    session, estimate = identification.session, identification.estimate
    stream, sent = Stream(), messages(names, velocities)
    stream.use(session, estimate)
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
    streams = Stream(), Stream()
    estimate = replace(identification.estimate, parameters=other.model.nominal_parameters)
    streams[0].use(other, estimate)
    plain = geomid_ros.identify(BAGS / "arm3", BAGS / "arm3.urdf", candidates=[]).session
    streams[1].use(plain, estimate)
    with_gains, without = (next(s.predict(messages())).efforts for s in streams)
    np.testing.assert_allclose(with_gains * [*GAINS.values()], without, atol=1e-9)


def test_what_is_carried_is_predicted_until_it_is_put_down(identification: Identification) -> None:
    """At once, whether an estimate comes before it or after it."""
    session, estimate = identification.session, identification.estimate
    stream, sent = Stream(), messages()
    columns = slice(len(session.model.nominal_inertias) - 10, len(session.model.nominal_inertias))
    body = pseudo_inertia.parameters_of(np.array([1.5, 0.0, 0.0, 0.1, 1e-2, 0.0, 1e-2, 0.0, 0.0, 1e-2]))
    heavier = estimate.parameters.copy()
    heavier[columns] += body
    carried = Carried("tool", columns, body, np.eye(10), 0, 0)
    stream.carry(carried)
    stream.use(session, estimate)
    for parameters in (heavier, estimate.parameters):
        found = list(stream.predict(sent))
        expected = session.model.predicted_efforts(samples_of(found[0].motion), parameters)
        np.testing.assert_allclose(found[0].efforts, expected, atol=1e-6)
        stream.carry(None)


@pytest.mark.parametrize("velocities", [True, False])
def test_stamps_twice_and_in_the_wrong_order_change_no_acceleration(
    velocities: bool, identification: Identification
) -> None:
    def motion_of(sent: list[bytes]) -> FloatArray:
        stream = Stream()
        stream.use(identification.session, identification.estimate)
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
    stream, sent = Stream(), messages()
    assert [*stream.predict(sent[:3])] == []
    stream.use(identification.session, identification.estimate)
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
