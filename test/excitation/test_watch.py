"""The watch over a motion: what it stops, when, and what it lets pass. Time is counted, not waited for."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from signals.sent import JointMessage

from excitation.motions import Motion, bump
from geomid_ros.excitation.limits import JointState, MotionMonitor, RobotLimits
from geomid_ros.files.trajectories import read_trajectory
from geomid_ros.types import FloatArray

JOINTS = ("a", "b")
MOTION = bump(JOINTS, 4.0, amplitude=1.0)
LIMITS = RobotLimits(JOINTS, np.full(2, -0.5), np.full(2, 1.3), np.full(2, 5.0), np.array([20.0, np.inf]))
BEGIN = 1_700_000_000_000_000_000
PERIOD = 0.004
LOOK = 0.005  # [s] that a look lasts at most
TOLERANCE, SILENCE = 0.1, 0.04
FAULT = 1.6  # [s] after the start


def monitor(
    folder: Path, motion: Motion = MOTION, limits: RobotLimits = LIMITS, tolerance: float = TOLERANCE
) -> MotionMonitor:
    trajectory = read_trajectory(motion.write(folder / "trajectory.yaml", 80))
    return MotionMonitor(trajectory, limits, tolerance=tolerance, silence=SILENCE, begin=BEGIN)


@pytest.fixture
def watch(tmp_path: Path) -> MotionMonitor:
    return monitor(tmp_path)


def state(
    time: float, motion: Motion = MOTION, push: FloatArray | float = 0.0, effort: FloatArray | float = 1.0
) -> JointState:
    at = np.array([min(time, motion.duration)])
    return JointState(
        BEGIN + round(1e9 * time), motion.rows(at)[0] + push, motion.rows(at, 1)[0], np.broadcast_to(effort, 2)
    )


def stopped(watch: MotionMonitor, states: Callable[[float], JointState]) -> tuple[float, str]:
    """When and why the watch stops a robot whose states come in time, one a look; never and nothing if it does not."""
    for time in np.arange(PERIOD, MOTION.duration + 0.5, PERIOD).tolist():
        if why := watch.check([states(time)], PERIOD):
            return time, why
    return np.inf, ""


@pytest.mark.parametrize("lag", [0.0, 0.03])
def test_a_robot_that_follows_is_not_stopped(watch: MotionMonitor, lag: float) -> None:
    """Even if it is a little late, and its sensors are noisy."""
    random = np.random.default_rng(0)

    def states(time: float) -> JointState:
        old = state(max(0.0, time - lag), push=random.normal(0.0, 1e-3, 2))
        return replace(old, stamp=BEGIN + round(1e9 * time))

    assert stopped(watch, states) == (np.inf, "")
    assert watch.elapsed > MOTION.duration


def test_a_tolerated_push_and_efforts_that_are_not_measured_stop_nothing(watch: MotionMonitor) -> None:
    assert stopped(watch, lambda time: state(time, push=np.array([0.0, -0.09]), effort=np.nan)) == (np.inf, "")


STOPS = {
    "pushed away": (
        lambda time: state(time, push=np.array([0.0, -0.11 if time > FAULT else 0.0])),
        "joint 'b' is 0.110 rad (m) off its trajectory",
    ),
    "effort": (
        lambda time: state(time, effort=np.array([-20.5 if time > FAULT else 19.5, 900.0])),
        "the effort of joint 'a' is -20.5, its limit 20",
    ),
}


@pytest.mark.parametrize("case", STOPS)
def test_what_is_beyond_a_limit_stops_it_at_once(case: str, watch: MotionMonitor) -> None:
    states, said = STOPS[case]
    time, why = stopped(watch, states)
    assert FAULT < time <= FAULT + 1.5 * PERIOD
    assert why.startswith(said)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_that_leaves_its_range_stops_it_at_once(sign: float, tmp_path: Path) -> None:
    """The motion itself reaches 1.2 (or -0.8), the range ends at 1.0 (or -0.6)."""
    motion = bump(JOINTS, 4.0, amplitude=sign)
    narrow = RobotLimits(JOINTS, np.array([-0.6, -0.6]), np.array([1.0, 1.3]), LIMITS.speeds, LIMITS.efforts)
    time, why = stopped(monitor(tmp_path, motion, narrow), lambda time: state(time, motion))
    assert 0.805 < sign * (motion.rows(np.array([time]))[0, 0] - 0.2) < 0.82
    assert re.fullmatch("joint 'a' is at .* outside its range -0.6 to 1", why)


@pytest.mark.parametrize("slow", [1.0, 4.0])
def test_a_dead_controller_is_told_within_half_a_second(slow: float, tmp_path: Path) -> None:
    """Of a motion that is under way, however far its joints may be from where they should."""
    motion = bump(JOINTS, slow * 4.0, amplitude=1.0)
    watch, dead = monitor(tmp_path, motion, tolerance=9.0), 0.3 * motion.duration
    for time in np.arange(PERIOD, motion.duration, PERIOD).tolist():
        stuck = replace(state(min(time, dead), motion), stamp=BEGIN + round(1e9 * time), velocity=np.zeros(2))
        if why := watch.check([stuck], PERIOD):
            break
    assert why.startswith("the controller does not follow: joint 'a' was commanded to move by")
    assert dead < time < dead + 0.5


def test_one_joint_that_sticks_is_not_a_dead_controller(tmp_path: Path) -> None:
    def states(time: float) -> JointState:
        now = state(time)
        return replace(now, position=np.array([now.position[0], 0.2]))

    assert stopped(monitor(tmp_path, tolerance=9.0), states) == (np.inf, "")


def silent_after(watch: MotionMonitor, old: JointState | None) -> float:
    """The time of looking without a new message after which the watch stops the robot."""
    assert stopped_before(watch, FAULT) == ""
    for count in range(1, 1000):
        if why := watch.check([old] if old else [], LOOK):
            assert why.startswith("no joint states for")
            return count * LOOK
    raise AssertionError("never")


def stopped_before(watch: MotionMonitor, end: float) -> str:
    return "".join(watch.check([state(time)], PERIOD) for time in np.arange(PERIOD, end, PERIOD).tolist())


@pytest.mark.parametrize("repeated", [None, state(FAULT - PERIOD)], ids=["nothing", "a message that is repeated"])
def test_silence_stops_it_within_50_ms(repeated: JointState | None, watch: MotionMonitor) -> None:
    """As looks last 5 ms, and a command takes none. The robot is taken to be where it should."""
    passed = silent_after(watch, repeated)
    assert SILENCE < passed <= 0.05
    position, velocity = watch.present_state
    now = state(FAULT + passed)
    np.testing.assert_allclose(position, now.position, atol=0.01)
    np.testing.assert_allclose(velocity, now.velocity, atol=0.05)


def test_a_pause_of_this_process_is_no_silence(watch: MotionMonitor) -> None:
    """Half a second in which nobody looked counts as one look."""
    assert stopped_before(watch, FAULT) == ""
    assert watch.check([], 0.5) == ""
    assert watch.check([state(FAULT + 0.5)], 0.5) == ""


def test_where_the_robot_is_as_measured(watch: MotionMonitor) -> None:
    stopped_before(watch, FAULT)
    push = np.array([0.02, -0.03])
    watch.check([state(FAULT, push=push)], PERIOD)
    position, velocity = watch.present_state
    np.testing.assert_array_equal(position, state(FAULT).position + push)
    np.testing.assert_array_equal(velocity, state(FAULT).velocity)


def test_a_velocity_that_is_not_measured_follows_from_positions(watch: MotionMonitor) -> None:
    for time in np.arange(PERIOD, FAULT, PERIOD).tolist():
        watch.check([replace(state(time), velocity=np.full(2, np.nan))], PERIOD)
    _, velocity = watch.present_state
    np.testing.assert_allclose(velocity, state(FAULT - 0.03).velocity, atol=0.02)


def test_a_message_has_the_state_in_the_order_of_the_motion() -> None:
    message = JointMessage(7, ("b", "x", "a"), np.array([1.0, 2.0, 3.0]), np.array([]), np.array([4.0, np.nan, 6.0]))
    found = JointState.of(message, JOINTS)
    assert found is not None
    assert found.stamp == 7
    np.testing.assert_array_equal(found.position, [3.0, 1.0])
    np.testing.assert_array_equal(found.velocity, [np.nan, np.nan])
    np.testing.assert_array_equal(found.effort, [6.0, 4.0])
    assert JointState.of(message, ("a", "c")) is None
    absent = JointMessage(7, ("a", "b"), np.array([1.0, np.nan]), np.zeros(2), np.zeros(2))
    assert JointState.of(absent, JOINTS) is None
