"""Natural adaptation: its steps are theorems, a planted payload is found, and what is wrong switches it off."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pinocchio as pin
import pytest
from excitation.motions import lively
from files.recordings import BAGS, QUICK

import geomid_ros
from benchmarks.adaptation import LATE, Robot
from geomid_ros.api.feedforward import robot_to_move
from geomid_ros.control.correction import (
    FASTEST,
    LARGEST_SHARE,
    LONGEST_FAULT,
    MARGIN,
    Adaptation,
    CommandedMotion,
    Correction,
    FaultLatch,
    Reading,
    divergence,
    removed_fraction,
    shortest_change,
)
from geomid_ros.control.feedforward import MotorEfforts
from geomid_ros.errors import InputError
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.geometry.manifold import ONE_BODY
from geomid_ros.session.options import FillOptions
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.recording import simulate
from geomid_ros.types import FloatArray

URDF = BAGS / "arm7.urdf"
PERIOD, DELAY, GRID = 0.01, 0.01, 0.002  # [s]
HEAVIEST = 3.0  # [kg]
Change: TypeAlias = Callable[[Reading], Reading]
LOADS = [(mass, 0.2 * axis) for mass in (1.0, 2.9) for axis in (*np.eye(3), *-np.eye(3))]
LOAD = pin.Inertia(1.5, np.array([0.02, -0.03, 0.1]), 0.002 * np.eye(3))


def body(rng: np.random.Generator) -> FloatArray:
    factor = rng.normal(size=(4, 4)) * [[0.1], [0.1], [0.1], [1.0]]
    return pseudo_inertia.to_parameters(factor @ factor.T)


def carried(mass: float, centre: FloatArray) -> FloatArray:
    return np.array(pin.Inertia(mass, centre, 1e-3 * mass * np.eye(3)).toDynamicParameters())


def test_a_trajectory_replaces_the_one_before_once_it_starts() -> None:
    """Not when it is sent; one that starts earlier takes back what was to follow."""

    def at_speed(*speeds: float) -> Trajectory:
        """From 0 on at these speeds, 10 s long."""
        velocities = np.array([speeds, speeds])
        return Trajectory(
            ("b", "a"), np.array([0.0, 10.0]), np.outer([0.0, 10.0], speeds), velocities, np.zeros((2, 0))
        )

    commanded = CommandedMotion(["a", "b"])
    commanded.position = np.array([0.5, 0.7])
    np.testing.assert_allclose(commanded(100.0), [[0.5, 0.7], [0.0, 0.0], [0.0, 0.0]])
    commanded.follow(at_speed(1.0, 2.0), 100.0, 100.0)
    commanded.follow(at_speed(3.0, 4.0), 105.0, 101.0)
    commanded.follow(at_speed(5.0, 6.0), 104.0, 102.0)
    expected = {99.9: (0.0, 0.0), 103.9: (2.0, 1.0), 104.1: (6.0, 5.0), 105.1: (6.0, 5.0), 114.1: (0.0, 0.0)}
    for time, velocity in expected.items():
        np.testing.assert_allclose(commanded(time)[1], velocity, atol=1e-9, err_msg=str(time))
    np.testing.assert_allclose(commanded(114.1)[0], [60.0, 50.0])
    for second in range(120, 160):
        commanded.follow(None, float(second), float(second))
    np.testing.assert_allclose(commanded(159.0)[0], [0.5, 0.7])
    assert len(commanded._trajectories) == 2


def test_the_step_is_the_shortest_that_explains_residuals_within_their_noise() -> None:
    """It minimises ``|A x - r|^2 + |x|^2``, by least squares of both at once."""
    rng = np.random.default_rng(1)
    point, rows, residuals = ONE_BODY.point(body(rng)), rng.normal(size=(7, 10)), rng.normal(size=7)
    steps = 1e-6 * np.eye(10)
    ends = [(ONE_BODY.exp(point, step).parameters, ONE_BODY.exp(point, -step).parameters) for step in steps]
    jacobian = np.array([(after - before) / 2e-6 for after, before in ends]).T
    both = np.vstack([rows @ jacobian, np.eye(10)])
    expected = np.linalg.lstsq(both, np.append(residuals, np.zeros(10)), rcond=None)[0]
    np.testing.assert_allclose(shortest_change(ONE_BODY, point, rows, residuals), expected, atol=1e-6)


def test_it_depends_neither_on_frames_nor_on_units() -> None:
    rng = np.random.default_rng(1)
    parameters, rows, residuals = body(rng), rng.normal(size=(5, 10)), rng.normal(size=5)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    units = np.sqrt(2.2) * np.diag([1e3, 1e3, 1e3, 1.0])  # of mass and length
    change = units @ pseudo_inertia.change_of_frame(rotation, rng.normal(size=3))

    def moved(pseudo: FloatArray) -> FloatArray:
        return pseudo_inertia.to_parameters(spd.congruence(change, pseudo))

    transform = moved(pseudo_inertia.from_parameters(np.eye(10))).T
    other = ONE_BODY.point(transform @ parameters)
    first = ONE_BODY.exp(
        ONE_BODY.point(parameters), shortest_change(ONE_BODY, ONE_BODY.point(parameters), rows, residuals)
    )
    second = ONE_BODY.exp(other, shortest_change(ONE_BODY, other, rows @ np.linalg.inv(transform), residuals))
    np.testing.assert_allclose(second.parameters, moved(first.pseudo_inertias[0]), rtol=1e-6, atol=1e-6)


def test_the_body_stays_possible_and_within_the_bound_whatever_comes() -> None:
    rng = np.random.default_rng(5)
    adaptation = Adaptation(body(rng), HEAVIEST)
    start, largest = adaptation.point, 0.0
    for size in rng.choice([1e-3, 1.0, 1e3], 1500).tolist():
        adaptation.step(size * adaptation.shortest_change(rng.normal(size=(7, 10)), rng.normal(size=7)))
        assert np.linalg.eigvalsh(adaptation.point.pseudo_inertias[0])[0] > 0.0
        largest = max(largest, divergence(adaptation.point, start))
    inside = max(divergence(ONE_BODY.point(start.parameters + carried(mass, end)), start) for mass, end in LOADS)
    for _ in range(1500):
        adaptation.step(np.full(10, 0.01))
    assert inside < divergence(adaptation.point, start) < 100.0 * inside
    assert largest < 100.0 * inside


def test_twice_the_delay_is_stable_and_four_times_is_not() -> None:
    """An integrator of the residual behind the delay, without what is taken off for the correction under way."""

    def left(times: float) -> float:
        steps = 20  # in the delay that the gain is set for
        share, behind = removed_fraction(DELAY / steps, DELAY), round(times * steps)
        errors = [1.0] * (behind + 1)
        for _ in range(200 * steps):
            errors.append(errors[-1] - share * errors[-1 - behind])
        return float(np.max(np.abs(errors[-20 * steps :])))

    assert left(1.0) < 1e-9
    assert left(1.0 / MARGIN) < 1e-9
    assert left(4.0) > 1e3
    # A fast loop learns no faster than one of ten milliseconds: else it follows friction that the model lacks.
    steps = [removed_fraction(0.001, delay) for delay in (0.002, 0.01, 0.02)]
    assert steps[0] == steps[1] == pytest.approx(2.0 * steps[2], rel=0.1)
    assert 1.0 / MARGIN < np.pi / 2.0 / MARGIN < 4.0


class Arm:
    """An arm whose model is exact, and that may carry a load; its efforts are pinocchio's."""

    def __init__(self) -> None:
        session = robot_to_move(FillOptions(URDF.read_text()), None)
        self.joints = session.robot.joint_names
        self.body = session.robot.body_names[-1]
        self.efforts = MotorEfforts(
            session.model, session.known_parameters, session.effort_gains, self.joints, "a motion"
        )
        self._models = [pin.buildModelFromUrdf(str(URDF)) for _ in range(2)]
        loaded = self._models[1]
        frame = loaded.frames[loaded.getFrameId(self.body)]
        loaded.appendBodyToJoint(frame.parentJoint, LOAD, frame.placement)
        self._places = [loaded.joints[loaded.getJointId(joint)].idx_v for joint in self.joints]
        motion, times = lively(self.joints, 20.0, 0.6), GRID * np.arange(round(20.0 / GRID) + 1)
        self._commanded = np.array([motion.rows(times, order) for order in range(3)])
        self._learned = self.correction()
        self.learn(self._learned, 0.0, BEGIN)

    def learned(self) -> Correction:
        """One that has carried the load until BEGIN."""
        assert self._learned.latch.reason == ""
        return copy.deepcopy(self._learned, {id(self.efforts): self.efforts})

    def correction(self, body: str = "") -> Correction:
        return Correction(self.efforts, self.joints, body or self.body, HEAVIEST)

    @property
    def commanded_speeds(self) -> FloatArray:
        """All of the motion ``(N, joints)``."""
        return self._commanded[1]

    def commanded(self, time: float) -> FloatArray:
        return self._commanded[:, round(time / GRID)]

    def reading(self, time: float, loaded: bool, wrench: FloatArray | None = None) -> Reading:
        """What is measured; under a ``wrench (6,)`` of the last link's frame on its surroundings."""
        model = self._models[loaded]
        data, q, v, a = model.createData(), *np.zeros((3, model.nv))
        q[self._places], v[self._places], a[self._places] = self.commanded(time)
        efforts = np.array(pin.rnea(model, data, q, v, a))
        if wrench is not None:
            frame = model.getFrameId(self.body)
            efforts += pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED).T @ wrench
        return Reading(time, q[self._places], v[self._places], efforts[self._places])

    def learn(self, correction: Correction, begin: float, end: float, change: Change = lambda reading: reading) -> None:
        """Read and correct; ``change`` what is read."""
        for time in np.arange(begin, end, PERIOD):
            correction.learn(time + DELAY, change(self.reading(time, loaded=True)), self.commanded(time))
            correction(time + DELAY, self.commanded(time + DELAY))


@pytest.fixture(scope="module")
def arm() -> Arm:
    return Arm()


def test_a_planted_payload_is_found_and_its_efforts_are_added(arm: Arm) -> None:
    correction = arm.learned()
    arm.learn(correction, BEGIN, 6.0)
    assert correction.latch.reason == ""
    missing = []
    for time in np.arange(6.0, 8.0, PERIOD):
        loads = arm.reading(time, loaded=True).effort - arm.reading(time, loaded=False).effort
        missing.append([loads, loads - correction(time, arm.commanded(time))])
        correction.learn(time, arm.reading(time, loaded=True), arm.commanded(time))
    carried, left = np.sqrt(np.mean(np.square(missing[20:]), axis=0))
    assert np.max(carried) > 3.0
    assert np.all(left < 0.02 * np.max(carried))
    np.testing.assert_allclose(correction.adaptation.change[0], LOAD.mass, atol=0.1)


@pytest.mark.parametrize("friction", [False, True])
def test_friction_that_has_changed_is_found_if_it_adapts(friction: bool, arm: Arm) -> None:
    """A body explains little of it."""
    session = robot_to_move(FillOptions(URDF.read_text()), None)
    viscous = [c.effect.name == "viscous_friction" for c in session.model.coefficients]
    places = len(session.model.nominal_inertias) + np.flatnonzero(viscous)
    truth, model = (np.array(session.known_parameters) for _ in range(2))
    truth[places], model[places] = 5.0, 3.0
    true, known = (MotorEfforts(session.model, p, session.effort_gains, arm.joints, "a motion") for p in (truth, model))
    correction, left = Correction(known, arm.joints, arm.body, HEAVIEST, friction), []
    for time in np.arange(0.0, 6.0, PERIOD):
        motion = arm.commanded(time)
        effort = true(motion[:, None])[0]
        left.append(effort - known(motion[:, None])[0] - correction(time, motion))
        correction.learn(time, Reading(time, motion[0], motion[1], effort), motion)
    remaining = float(np.sqrt(np.mean(np.square(left[len(left) // 2 :]))))
    added = 2.0 * float(np.sqrt(np.mean(np.square(arm.commanded_speeds))))
    assert (remaining < 0.3 * added) == friction
    assert np.all(correction.adaptation.change[10:] > 0.5)


def assert_gradual(arm: Arm, sent: list[FloatArray], period: float = PERIOD) -> None:
    """Efforts that were sent every ``period`` [s]."""
    assert np.max(np.abs(np.diff(sent, axis=0)) / arm.efforts.limits) <= FASTEST * period * (1.0 + 1e-9)


def test_corrections_are_small_and_slow(arm: Arm) -> None:
    """However much is missing."""
    correction = arm.learned()
    correction.adaptation.point = ONE_BODY.point(1e3 * correction.adaptation.point.parameters)
    times = np.arange(BEGIN, BEGIN + LONGEST_FAULT, PERIOD)
    sent = [correction(time, arm.commanded(time)) for time in times]
    assert np.max(np.abs(sent) / arm.efforts.limits) == pytest.approx(LARGEST_SHARE)
    assert_gradual(arm, sent)


def frozen() -> Change:
    kept: list[Reading] = []

    def change(reading: Reading) -> Reading:
        kept.append(reading)
        return reading if reading.time < BEGIN else replace(kept[0], time=reading.time)

    return change


def efforts_times(factor: float, when: Callable[[float], bool] = lambda _: True) -> Change:
    """From BEGIN on, as long as ``when``."""
    return lambda r: replace(r, effort=r.effort * (factor if r.time >= BEGIN and when(r.time) else 1.0))


def at(stamp: Callable[[float], float]) -> Change:
    """With another stamp from BEGIN on."""
    return lambda reading: replace(reading, time=stamp(reading.time) if reading.time >= BEGIN else reading.time)


BEGIN = 4.0
FAULTS: dict[str, tuple[Change, str]] = {
    "frozen": (frozen(), "joint states repeat while the robot is to move"),
    "late": (at(lambda time: max(BEGIN - PERIOD, time - 0.1)), "joint states are .* ms late"),  # no fresh one till then
    "set back": (at(lambda time: time - 3.0), r"the clock of joint states went back by 2\.99 s"),
    "silent": (at(lambda _: BEGIN), "no joint states for 1.0 ms"),
    "nothing measured": (efforts_times(np.nan), "no joint states for 1.0 ms"),
    "saturated": (efforts_times(1e3), r"the effort of joint '\w+' saturates"),
    "for 80 of 100 ms": (
        efforts_times(1e3, lambda time: round(time / PERIOD) % 10 < 8),
        r"the effort of joint '\w+' saturates",
    ),
}


@pytest.mark.parametrize("case", FAULTS)
def test_what_goes_wrong_switches_it_off(case: str, arm: Arm) -> None:
    """Nothing is learned from it, and the correction ends soon and gradually."""
    change, said = FAULTS[case]
    correction = arm.learned()
    before = correction.adaptation.point
    arm.learn(correction, BEGIN, BEGIN + 0.2, change)
    assert re.search(said, correction.latch.reason)
    assert divergence(correction.adaptation.point, before) < 1e-2
    arm.learn(correction, BEGIN + 0.2, BEGIN + 0.2 + LARGEST_SHARE / FASTEST, change)
    np.testing.assert_array_equal(correction(BEGIN + 0.3, arm.commanded(BEGIN)), 0.0)


def test_what_is_seldom_wrong_is_forgotten() -> None:
    """Only one of ten milliseconds and less; a fifth of the time adds up."""
    often, seldom = FaultLatch(), FaultLatch()
    for time in range(5000):
        often.record(1e-3 * time, ["wrong"] if time % 50 < 10 else [])
        seldom.record(1e-3 * time, ["wrong"] if time % 50 < 4 else [])
    assert (often.reason, seldom.reason) == ("wrong", "")


def test_a_clock_that_goes_back_ends_it_gradually(arm: Arm) -> None:
    """Though no joint states come."""
    correction = arm.learned()
    sent = [correction(BEGIN + DELAY, arm.commanded(BEGIN))]
    assert np.any(sent[0])
    times = np.arange(1.0, 1.0 + LARGEST_SHARE / FASTEST + 2.0 * PERIOD, PERIOD)
    sent += [correction(time, arm.commanded(time)) for time in times]
    assert re.match(r"the clock went back by 3\.01 s", correction.latch.reason)
    np.testing.assert_array_equal(sent[-1], 0.0)
    assert_gradual(arm, sent)


def test_a_motion_that_is_no_number_ends_it(arm: Arm) -> None:
    correction = arm.learned()
    for time in BEGIN + np.array([0.0, 0.02, 0.04, 0.06, 0.08, 0.1]):
        sent = correction(time, np.full_like(arm.commanded(time), np.nan))
        assert np.isfinite(sent).all()
    assert "are not finite" in correction.latch.reason
    np.testing.assert_array_equal(sent, 0.0)


def test_another_correction_goes_on_gradually(arm: Arm) -> None:
    before, after = arm.learned(), arm.correction()
    sent = [before(BEGIN + DELAY, arm.commanded(BEGIN))]
    after.continue_from(before)
    sent += [after(BEGIN + DELAY + step * 0.002, arm.commanded(BEGIN)) for step in range(1, 40)]
    assert_gradual(arm, sent, 0.002)
    np.testing.assert_array_equal(sent[-1], 0.0)


@pytest.mark.parametrize("force", [(40.0, 0.0, 0.0), (0.0, -40.0, 0.0), (0.0, 0.0, -80.0)])
def test_a_contact_switches_it_off(force: tuple[float, float, float], arm: Arm) -> None:
    """No body pulls sideways for long, nor upwards by more than the heaviest payload and the link weigh."""
    correction = arm.learned()
    wrench = np.append(force, np.zeros(3))
    arm.learn(correction, BEGIN, BEGIN + 0.2, lambda reading: arm.reading(reading.time, loaded=True, wrench=wrench))
    assert "no payload explains the efforts" in correction.latch.reason


def test_picking_up_and_putting_down_are_no_contacts(arm: Arm) -> None:
    correction = arm.correction()
    for begin in (0.0, 2.0, 4.0):
        arm.learn(correction, begin, begin + 1.0)
        arm.learn(correction, begin + 1.0, begin + 2.0, lambda reading: arm.reading(reading.time, loaded=False))
        assert correction.latch.reason == ""
        assert abs(correction.adaptation.change[0]) < 0.2


def test_the_gain_follows_the_delay(arm: Arm) -> None:
    """A loop that is later learns more slowly."""
    found = []
    for delay in (0.0, 0.03, 0.1):
        correction = arm.correction()
        for time in np.arange(0.0, 0.1, PERIOD):
            correction.learn(time + delay, arm.reading(time, loaded=True), arm.commanded(time))
        found.append(divergence(correction.adaptation.point, arm.correction().adaptation.point))
    assert found[0] > 1.5 * found[1] > 2.0 * found[2] > 0.0


def test_what_cannot_adapt_is_refused(arm: Arm) -> None:
    with pytest.raises(InputError, match="unknown link 'hand'"):
        arm.correction("hand")
    text = re.sub(r'effort="[^"]*"', 'effort="0"', URDF.read_text(), count=1)
    session = robot_to_move(FillOptions(text), None)
    efforts = MotorEfforts(session.model, session.known_parameters, session.effort_gains, arm.joints, "a motion")
    with pytest.raises(InputError, match="'joint1' has no effort limit"):
        Correction(efforts, arm.joints, arm.body, HEAVIEST)


def test_a_simulated_robot_carries_what_no_model_has(tmp_path: Path) -> None:
    """The position controller alone, with the model's efforts, is off by ten times as much."""
    simulate(tmp_path / "arm3_1", SimulationOptions(robot="arm3", seed=1, duration=8.0, longest_step=QUICK))
    geomid_ros.identify(tmp_path / "arm3_1", candidates=[]).save(tmp_path / "arm3_1_estimate", report=False)
    robot = Robot("arm3", 1, tmp_path)
    model = robot.model()(robot.commanded)
    without, run = robot.run(model), robot.run(model, robot.adapting(LATE))
    assert run.adapting is not None
    assert run.adapting.correction.latch.reason == ""
    assert run.errors[1] < without.errors[1] / 2.0
    assert run.errors[2] < without.errors[2] / 10.0
