"""Efforts of trajectories: what they are by an independent route, between points, and on a simulated robot."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from excitation.motions import lively
from files.recordings import BAGS

import geomid_ros
from benchmarks.feedforward import errors
from geomid_ros.control.feedforward import SHORTEST, MotorEfforts, with_efforts
from geomid_ros.errors import InputError
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.model.effects import MotionEffect
from geomid_ros.types import FloatArray

URDF = BAGS / "arm3.urdf"
JOINTS = ("joint1", "joint2", "joint3")


def motion(accelerated: bool = True, points: int = 12) -> Trajectory:
    times = np.linspace(0.0, 4.0, points)
    positions, velocities, accelerations = (lively(JOINTS, 4.0, 0.4).rows(times, derivative) for derivative in range(3))
    return Trajectory(JOINTS, times, positions, velocities, accelerations if accelerated else np.zeros((points, 0)))


def rnea(states: FloatArray) -> FloatArray:
    """Efforts ``(N, joints)`` of the URDF by the recursive Newton-Euler algorithm."""
    model = pin.buildModelFromUrdf(str(URDF))
    data, places = model.createData(), [model.joints[model.getJointId(joint)].idx_v for joint in JOINTS]
    efforts = []
    for row in states.transpose(1, 0, 2):
        q, v, a = np.zeros((3, model.nv))
        q[places], v[places], a[places] = row
        efforts.append(np.array(pin.rnea(model, data, q, v, a))[places])
    return np.array(efforts)


def test_without_a_model_they_are_those_of_the_urdf_in_the_unit_of_the_messages() -> None:
    """In the order of the trajectory's joints. A driver that says half of the torque, with the other sign at one joint,
    takes commands in the same unit."""
    given, places, gains = motion(), [2, 0, 1], np.array([2.0, -0.5, 1.0])
    columns = {name: getattr(given, name)[:, places] for name in ("positions", "velocities", "accelerations")}
    other = replace(given, joints=tuple(JOINTS[place] for place in places), efforts=None, **columns)
    text = URDF.read_text().replace('effort="', 'effort="1').replace('effort="1', 'effort="3', 1)  # all different
    plain = geomid_ros.feedforward(other, None, urdf=text)
    assert len(set(plain.limits.tolist())) > 1
    found = geomid_ros.feedforward(other, None, urdf=text, gain=dict(zip(JOINTS, gains, strict=True)))
    for result, factors in ((plain, np.ones(3)), (found, gains[places])):
        expected = rnea(given.states(result.trajectory.times)[:3])[:, places]
        np.testing.assert_allclose(result.trajectory.efforts * factors, expected, atol=1e-9)
        np.testing.assert_allclose(result.limits * np.abs(factors), plain.limits)


def linear(found: Trajectory, times: FloatArray) -> FloatArray:
    """Efforts ``(N, joints)`` between the points, as a controller interpolates them."""
    return np.array([np.interp(times, found.times, efforts) for efforts in found.efforts.T]).T


def test_a_reversal_between_two_points_is_seen() -> None:
    """Dry friction of an axis without gravity turns twice between two points."""
    times = np.array([0.0, 4.0])
    given = Trajectory(("a",), times, np.array([[0.0], [1.0]]), np.array([[1.0], [1.0]]), np.zeros((2, 0)))
    assert np.min(given.states(np.linspace(0.0, 4.0, 50))[1]) < 0.0 < np.max(given.states(times)[1])

    def efforts(states: FloatArray) -> FloatArray:
        return 2.0 * states[2] + 1.5 * np.sign(states[1])

    found = with_efforts(given, efforts, 0.01)
    at = np.linspace(0.0, 4.0, 4001)
    off = np.abs(linear(found, at) - efforts(given.states(at)[:3]))
    assert np.mean(off > 0.1) < 0.005


def test_errors_that_are_opposite_about_the_middle_are_seen() -> None:
    """Between two points so near each other that nothing else is looked at between them."""
    times, lengths = np.array([0.0, 8.0 * SHORTEST]), np.array([[0.0], [1.0]])
    given = Trajectory(("joint1",), times, lengths, np.full((2, 1), 1.0 / times[1]), np.zeros((2, 1)))
    found = with_efforts(given, lambda states: 1.0 + 0.5 * np.sin(2.0 * np.pi * states[0]), 0.1)
    between = np.linspace(*times, 200)
    off = linear(found, between)[:, 0] - 1.0 - 0.5 * np.sin(2.0 * np.pi * between / times[1])
    assert np.max(np.abs(off)) < 0.2


@pytest.mark.parametrize("accelerated", [True, False])
def test_the_motion_stays_what_it_is(accelerated: bool) -> None:
    given = motion(accelerated, 6)
    result = geomid_ros.feedforward(given, None, urdf=URDF, tolerance=1e-3)
    assert repr(result).startswith("Trajectory with efforts: ")
    found = result.trajectory
    assert np.all(result.errors > 0.0)
    assert np.all(result.errors < (1e-3 if accelerated else 1.0) * result.largest)
    assert len(found.times) > 3 * len(given.times)
    assert set(given.times) <= set(found.times)
    assert found.accelerations.shape[1] == given.accelerations.shape[1]
    times = np.linspace(0.0, 4.0, 997)
    np.testing.assert_allclose(found.states(times)[0], given.states(times)[0], atol=1e-10)
    np.testing.assert_allclose(found.states(times)[1], given.states(times)[1], atol=1e-8)


@pytest.mark.parametrize("tolerance", [0.1, 0.001])
def test_straight_lines_between_them_are_as_near_as_asked_for(tolerance: float) -> None:
    given, times = motion(), np.linspace(0.0, 4.0, 3001)
    found = with_efforts(given, rnea, tolerance)
    off = np.max(np.abs(linear(found, times) - rnea(given.states(times)[:3])), axis=0)
    assert np.all(off < 1.2 * tolerance * np.max(np.abs(found.efforts), axis=0))


def test_no_more_points_than_they_need() -> None:
    """Efforts that are straight lines need none; a jump needs some, until it is as short as a controller's cycle."""
    given = motion()
    straight = with_efforts(given, lambda states: states[0], 0.5)
    assert len(straight.times) == len(given.times)
    steep = with_efforts(given, lambda states: np.sign(states[0] - 0.25), 0.01)
    assert SHORTEST <= np.min(np.diff(steep.times)) < 2.0 * SHORTEST
    assert len(steep.times) < len(given.times) + 12 * 3 * np.count_nonzero(
        np.diff(np.sign(given.positions - 0.25), axis=0)
    )


def test_a_motion_of_a_trapezoid_of_speed_is_cubic() -> None:
    """q = t^2 / 2: by positions and velocities alone the acceleration is 1 between all points."""
    times, between = np.array([0.0, 0.5, 2.0]), np.array([0.1, 0.7, 1.9])
    given = Trajectory(("a",), times, 0.5 * times[:, None] ** 2, times[:, None], np.zeros((3, 0)))
    np.testing.assert_allclose(given.states(between)[:3, :, 0], [0.5 * between**2, between, np.ones(3)])


REFUSED = {
    "another robot": (lambda t: replace(t, joints=("joint1", "joint2", "elbow")), {}, "unknown joint 'elbow'"),
    "a joint is missing": (
        lambda t: Trajectory(JOINTS[:2], t.times, t.positions[:, :2], t.velocities[:, :2], t.accelerations[:, :2]),
        {},
        "does not contain joint3; if they stay at zero, name them in locked_joints",
    ),
    "too fast": (lambda t: t.at_speed(40.0), {}, r"joint 'joint\d' would need .* % more than its limit"),
    "no robot": (lambda t: t, {"urdf": None}, "no robot is given: give a model"),
    "too long": (lambda t: t.at_speed(1e-3), {}, "takes 4000 s, expected at most 600 s"),
    "tolerance": (lambda t: t, {"tolerance": 0.0}, "tolerance is 0, expected 0 < tolerance < 1"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_moved_is_refused(case: str) -> None:
    change, options, said = REFUSED[case]
    with pytest.raises(InputError, match=said):
        geomid_ros.feedforward(change(motion()), None, **({"urdf": URDF} | options))


def test_a_simulated_robot_tracks_with_what_was_identified(tmp_path: Path) -> None:
    """Its URDF is wrong, its joints have friction and rotors: a fiftieth of the error of PD alone is left."""
    alone, urdf, identified = errors("arm3", 1, False, tmp_path, 12.0).values()
    assert identified < alone / 50.0
    assert identified < urdf / 10.0


@pytest.fixture(scope="module")
def estimate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("estimate")
    return geomid_ros.identify(BAGS / "arm3", URDF, candidates=[]).save(folder, report=False)[0]


def test_only_what_the_motors_do_is_commanded(estimate: Path) -> None:
    """An offset of the effort's sensor moves nothing; friction has to be overcome."""
    session = geomid_ros.feedforward(motion(), estimate, force=True).session
    model, states = session.model, motion().states(np.linspace(0.0, 4.0, 50))[:3]

    def efforts(added: str) -> FloatArray:
        parameters = session.known_parameters.copy()
        first = len(model.nominal_inertias)
        parameters[first:] += [5.0 * (c.effect.name == added) for c in model.coefficients]
        return MotorEfforts(model, parameters, session.effort_gains, JOINTS, "a motion")(states)

    np.testing.assert_array_equal(efforts("effort_offset"), efforts("nothing"))
    np.testing.assert_allclose(efforts("viscous_friction") - efforts("nothing"), 5.0 * states[1], atol=1e-9)


def test_what_a_body_adds_is_scaled_by_its_drives(estimate: Path) -> None:
    session = geomid_ros.feedforward(motion(), estimate, force=True).session
    model, states = session.model.with_drive_gains(np.array([1.2, 0.9, 1.1])), motion().states(np.array([1.3]))[:3]
    added = np.zeros(len(session.known_parameters))
    added[model.body_names.index("link3") * 10] = 1.0
    alone, loaded = (
        MotorEfforts(model, session.known_parameters + more, session.effort_gains, JOINTS, "a motion")
        for more in (0.0 * added, added)
    )
    rows, _ = alone.of_body("link3")
    difference = loaded(states)[0] - alone(states)[0]
    np.testing.assert_allclose(rows(states[:, 0]) @ np.eye(10)[0], difference, rtol=1e-9, atol=1e-12)


def test_coefficients_of_motion_add_their_columns(estimate: Path) -> None:
    session = geomid_ros.feedforward(motion(), estimate, force=True).session
    model, states, parameters = session.model, motion().states(np.array([1.3]))[:3], session.known_parameters
    first = len(model.nominal_inertias)
    positive = np.array([c.positive and isinstance(c.effect, MotionEffect) for c in model.coefficients])
    without = np.where(np.append(np.zeros(first, dtype=bool), positive), 0.0, parameters)
    joints = JOINTS[::-1]
    whole, rest = (MotorEfforts(model, p, session.effort_gains, joints, "a motion") for p in (parameters, without))
    reversed_states = states[:, :, ::-1]
    columns, values = whole.of_coefficients()
    difference = whole(reversed_states)[0] - rest(reversed_states)[0]
    assert np.min(np.abs(difference)) > 0.0
    np.testing.assert_allclose(columns(reversed_states[:, 0]) @ values, difference, atol=1e-9)
    assert rest.of_coefficients()[0](states[:, 0]).shape == (len(joints), 0)


def test_a_robot_on_its_legs_and_efforts_that_cannot_be_predicted_are_refused(estimate: Path, tmp_path: Path) -> None:
    document, legs = json.loads(estimate.read_text()), estimate.with_name("legs.json")
    document["channels"].append({"channel": "base/fx", "unit": "N"})
    legs.write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"legs\.json: floating base: leg efforts"):
        geomid_ros.feedforward(motion(), legs, force=True)
    alone = shutil.copy(estimate, tmp_path)
    with pytest.raises(InputError, match=r"estimate\.json: identified\.urdf is missing .*; give the urdf"):
        geomid_ros.feedforward(motion(), alone, force=True)
    sensors = ("/tip:tool:external:fx,fy,fz", "/wrench:wrist_ft:mounted")
    with pytest.raises(InputError, match="efforts cannot be predicted"):
        geomid_ros.feedforward(motion(), None, urdf=URDF, wrench=sensors)
