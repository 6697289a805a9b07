"""The watch over a motion: what it stops, when, and what it lets pass. Time is counted, not waited for."""

from __future__ import annotations

from collections.abc import Callable
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


def stopped(watch: MotionMonitor, states: Callable[[float], JointState | None]) -> tuple[float, str]:
    """When and why the watch stops a robot whose states come in time, one a look; never and nothing if it does not."""
    for time in np.arange(PERIOD, MOTION.duration + 0.5, PERIOD).tolist():
        new = states(time)
        why = watch.check([new] if new else [], PERIOD)
        if why:
            return time, why
    return np.inf, ""


@pytest.mark.parametrize("lag", [0.0, 0.03])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_robot_that_follows_is_not_stopped(watch: MotionMonitor, lag: float, noise: float) -> None:
    """Even if it is a little late, and its sensors are noisy."""
    random = np.random.default_rng(0)
    late = [state(max(0.0, time - lag), push=random.normal(0.0, noise, 2)) for time in np.arange(0.0, 4.6, PERIOD)]
    stamped = iter(late)

    def states(time: float) -> JointState:
        old = next(stamped)
        return JointState(BEGIN + round(1e9 * time), old.position, old.velocity, old.effort)

    assert stopped(watch, states) == (np.inf, "")
    assert watch.elapsed > MOTION.duration


def test_a_joint_that_is_pushed_away_stops_it_at_once(watch: MotionMonitor) -> None:
    time, why = stopped(watch, lambda time: state(time, push=np.array([0.0, -0.11 if time > FAULT else 0.0])))
    assert FAULT < time <= FAULT + 1.5 * PERIOD
    assert why.startswith("joint 'b' is 0.110 rad (m) off its trajectory")


def test_a_push_that_is_tolerated_does_not(watch: MotionMonitor) -> None:
    assert stopped(watch, lambda time: state(time, push=np.array([0.0, -0.09]))) == (np.inf, "")


def test_an_effort_beyond_its_limit_stops_it_at_once(watch: MotionMonitor) -> None:
    time, why = stopped(watch, lambda time: state(time, effort=np.array([-20.5 if time > FAULT else 19.5, 900.0])))
    assert FAULT < time <= FAULT + 1.5 * PERIOD
    assert why == "the effort of joint 'a' is -20.5, its limit 20"


def test_efforts_that_are_not_measured_stop_nothing(watch: MotionMonitor) -> None:
    assert stopped(watch, lambda time: state(time, effort=np.nan)) == (np.inf, "")


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_that_leaves_its_range_stops_it_at_once(sign: float, tmp_path: Path) -> None:
    """The motion itself reaches 1.2 (or -0.8), the range ends at 1.0 (or -0.6)."""
    motion = bump(JOINTS, 4.0, amplitude=sign)
    narrow = RobotLimits(JOINTS, np.array([-0.6, -0.6]), np.array([1.0, 1.3]), LIMITS.speeds, LIMITS.efforts)
    time, why = stopped(monitor(tmp_path, motion, narrow), lambda time: state(time, motion))
    assert 0.805 < sign * (motion.rows(np.array([time]))[0, 0] - 0.2) < 0.82
    assert why.startswith("joint 'a' is at")
    assert why.endswith("outside its range -0.6 to 1")


@pytest.mark.parametrize("slow", [1.0, 4.0])
def test_a_dead_controller_is_told_within_half_a_second(slow: float, tmp_path: Path) -> None:
    """Of a motion that is under way, however far its joints may be from where they should."""
    motion = bump(JOINTS, slow * 4.0, amplitude=1.0)
    watch, dead = monitor(tmp_path, motion, tolerance=9.0), 0.3 * motion.duration
    for time in np.arange(PERIOD, motion.duration, PERIOD).tolist():
        still = state(min(time, dead), motion)
        stuck = JointState(BEGIN + round(1e9 * time), still.position, np.zeros(2), still.effort)
        why = watch.check([stuck], PERIOD)
        if why:
            break
    assert why.startswith("the controller does not follow: joint 'a' was commanded to move by")
    assert dead < time < dead + 0.5


def test_one_joint_that_sticks_is_not_a_dead_controller(tmp_path: Path) -> None:
    def states(time: float) -> JointState:
        now = state(time)
        return JointState(now.stamp, np.array([now.position[0], 0.2]), now.velocity, now.effort)

    assert stopped(monitor(tmp_path, tolerance=9.0), states) == (np.inf, "")


def silent_after(watch: MotionMonitor, look: Callable[[float], JointState | None], seconds: float = LOOK) -> float:
    """The time of looking without a message after which the watch stops the robot."""
    assert stopped_before(watch, FAULT) == ""
    for count in range(1, 1000):
        new = look(FAULT + count * seconds)
        if why := watch.check([new] if new else [], seconds):
            assert why.startswith("no joint states for")
            return count * seconds
    raise AssertionError("never")


def stopped_before(watch: MotionMonitor, end: float) -> str:
    return "".join(watch.check([state(time)], PERIOD) for time in np.arange(PERIOD, end, PERIOD).tolist())


def test_silence_stops_it_within_50_ms(watch: MotionMonitor) -> None:
    """As looks last 5 ms, and a command takes none."""
    assert SILENCE < silent_after(watch, lambda _: None) <= 0.05


def test_a_message_that_is_repeated_is_silence(watch: MotionMonitor) -> None:
    old = state(FAULT - PERIOD)
    assert SILENCE < silent_after(watch, lambda _: old) <= 0.05


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
        now = state(time)
        watch.check([JointState(now.stamp, now.position, np.full(2, np.nan), now.effort)], PERIOD)
    _, velocity = watch.present_state
    np.testing.assert_allclose(velocity, state(FAULT - 0.03).velocity, atol=0.02)


def test_in_silence_the_robot_is_taken_to_be_where_it_should(watch: MotionMonitor) -> None:
    passed = silent_after(watch, lambda _: None)
    position, velocity = watch.present_state
    now = state(FAULT + passed)
    np.testing.assert_allclose(position, now.position, atol=0.01)
    np.testing.assert_allclose(velocity, now.velocity, atol=0.05)


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
