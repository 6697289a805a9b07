"""A payload is noticed, weighed and taken back by change points; what no payload explains is none."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from estimation.arms import Truth, efforts, motion, samples, shipped, truth

from benchmarks.alarms.cases import Alarm, Case, Outcome
from geomid_ros.errors import InputError
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import ONE_BODY, ParameterManifold
from geomid_ros.inference.prior import PAYLOAD_PRIOR_STD, default_payload
from geomid_ros.model.effects import DEFAULT_EFFECTS, identified_effect
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.monitoring.change_detection import ALARM, ChangeDetector, ChannelGap
from geomid_ros.monitoring.payload_watch import REMEMBERED, CarriedPayload, ChannelNoise, PayloadWatch
from geomid_ros.types import FloatArray

RATE = 50.0  # [Hz]
BEFORE, EXCHANGED, AFTER, END = 50.0, 58.0, 65.0, 80.0  # [s]
NOISE = 0.02  # [N m]
CENTRE = np.array([0.03, -0.02, 0.08])  # [m]
MASS = 1.5  # [kg]


def ball(mass: float) -> FloatArray:
    """A payload's parameters ``(10,)``."""
    return mass * pseudo_inertia.parameters_of(np.array([1.0, *CENTRE, 3e-3, 0.0, 3e-3, 0.0, 0.0, 3e-3]))


BALL = ball(MASS)


@dataclass(frozen=True)
class State:
    """What the watch says at a ``time`` [s]."""

    time: float
    carried: CarriedPayload | None
    gaps: tuple[ChannelGap, ...]

    @property
    def open(self) -> bool:
        """True if a channel has a gap."""
        return any(gap.since is not None for gap in self.gaps)


def test_the_bench_counts_alarms_after_a_payload_is_off_as_false() -> None:
    alarms = tuple(Alarm("joint2", second) for second in (100.0, 122.0, 156.0))
    found = Outcome(Case("payload", "arm3", 1), alarms, 1.0, 0.0, 1.0)
    assert found.false == (alarms[0], alarms[2])
    assert found.first == alarms[1]


class Arm:
    """A small arm of which some parameters are others between two instants."""

    def __init__(self, seed: int = 1) -> None:
        self.rng = np.random.default_rng(seed)
        self.robot = Robot(shipped("arm3"))
        self.model = MeasurementModel(self.robot, [identified_effect(name) for name in DEFAULT_EFFECTS])
        self.moving = motion(self.rng, len(self.robot.joints), END, RATE)
        self.truth = truth(self.rng, self.robot)

    @property
    def loaded(self) -> Truth:
        """The arm with a payload."""
        return self.carrying(MASS)

    def carrying(self, mass: float) -> Truth:
        """The arm with a payload of this mass [kg]."""
        links = self.truth.links.copy()
        links[-1] += ball(mass)
        return replace(self.truth, links=links)

    def measured(self, changed: Truth, noise: float = NOISE, then: Truth | None = None) -> Samples:
        """Between ``BEFORE`` and ``AFTER``, it is ``changed``; and from ``EXCHANGED`` on, ``then``."""
        times = np.arange(len(self.moving)) / RATE
        felt = efforts(self.robot, self.truth, self.moving)
        for begin, arm in ((BEFORE, changed), (EXCHANGED, then or changed)):
            between = (times >= begin) & (times < AFTER)
            felt[between] = efforts(self.robot, arm, self.moving)[between]
        return samples(self.moving, felt + noise * self.rng.normal(size=felt.shape), RATE)

    def watch(self, gain: float = 0.0) -> PayloadWatch:
        """For a payload of the last link."""
        links = self.model.nominal_inertias.reshape(-1, 10)
        last = len(links) - 1
        columns = slice(10 * last, 10 * last + 10)
        return PayloadWatch(
            self.model.channels,
            "tool",
            columns,
            links.size,
            prior_mean=default_payload(links, last),
            gain=gain,
            prior_std=PAYLOAD_PRIOR_STD,
            threshold=ALARM,
        )

    def watched(self, measured: Samples, watch: PayloadWatch | None = None) -> list[State]:
        """Five times a second."""
        rows, step, watch = self.model.rows(measured), 10, watch or self.watch()
        self.detector = detector = ChangeDetector(self.model.channels, payload=watch)
        states = []
        for begin in range(0, len(measured), step):
            part = slice(begin, begin + step)
            detector.add(begin, measured.stamps[part], replace(rows, **{k: v[part] for k, v in vars(rows).items()}))
            while detector.test():
                pass
            states.append(State(1e-9 * float(measured.stamps[part][-1]), watch.payload, detector.gaps))
        return states


def test_a_payload_is_picked_up_weighed_and_put_down() -> None:
    arm = Arm(1)
    states = arm.watched(arm.measured(arm.loaded))
    carrying = [state for state in states if state.carried is not None]
    times = [state.time for state in carrying]
    assert BEFORE < times[0] < BEFORE + 2.0
    assert AFTER < times[-1] + 0.2 < AFTER + 1.0
    assert np.ptp(np.diff(times)) < 0.1  # and never lost meanwhile
    settled = next(state.carried for state in carrying if state.time > times[0] + 3.0)
    assert settled is not None
    assert settled.mass == pytest.approx(MASS, rel=0.05)
    assert settled.interval[0] < MASS < settled.interval[1]
    assert settled.parameters[1:4] / settled.mass == pytest.approx(CENTRE, abs=0.01)
    assert abs(1e-9 * settled.since - BEFORE) < 1.0
    assert not any(state.open for state in states)


@pytest.mark.parametrize("second", [0.6, 1.2])
def test_a_payload_is_exchanged_for_another(second: float) -> None:
    """It is weighed by its own rows alone; and all this time something is carried."""
    arm = Arm(1)
    measured = arm.measured(arm.loaded, then=arm.carrying(second)).select(slice(0, round(AFTER * RATE) - 1))
    states = arm.watched(measured)
    carried = [state.carried for state in states if BEFORE + 2.0 < state.time < AFTER]
    assert all(carried)
    last = carried[-1]
    assert last is not None
    assert last.mass == pytest.approx(second, rel=0.05)
    assert last.interval[0] < second < last.interval[1] < MASS
    assert abs(1e-9 * last.since - EXCHANGED) < 0.5
    assert len({each.since for each in carried if each}) == 2
    assert {each.picked_up for each in carried if each} == {last.picked_up}
    assert abs(1e-9 * last.picked_up - BEFORE) < 1.0
    assert [stamp for stamp, _ in arm.detector.changes] == [last.picked_up, last.since]


@pytest.mark.parametrize("seed", [2, 3])
def test_one_payload_is_not_exchanged_for_itself(seed: int) -> None:
    """Though its first rows are those of a filter that it runs through, and tell it roughly."""
    arm = Arm(seed)
    assert len({state.carried.since for state in arm.watched(arm.measured(arm.loaded)) if state.carried}) == 1


def test_a_payload_is_noticed_by_what_an_earlier_watch_knew() -> None:
    arm = Arm(1)
    measured, watch = arm.measured(arm.loaded), arm.watch()
    begin = round((BEFORE + 1.0) * RATE)
    arm.watched(measured.select(slice(0, round((BEFORE - 5.0) * RATE))), watch)
    later = arm.watch()
    later.restore(watch.memory)
    arm.watched(measured.select(slice(begin, begin + 150)), later)
    assert later.payload is not None
    assert later.payload.mass == pytest.approx(MASS, rel=0.1)
    with pytest.raises(InputError, match="other shapes"):
        later.restore(replace(watch.memory, noise=np.ones((2, 2))))


def test_gains_of_each_joint_widen_the_interval_of_the_mass() -> None:
    """The mass follows from differences between joints, so their gains count for more than a common one."""
    arm, gain = Arm(1), 0.3
    states = arm.watched(arm.measured(arm.loaded), arm.watch(gain))
    carried = next(state.carried for state in states if state.time > BEFORE + 6.0)
    assert carried is not None
    assert np.sqrt(carried.covariance[0, 0]) > 1.1 * gain * carried.mass


def test_the_most_probable_payload_is_found_from_everywhere() -> None:
    """Even if the efforts ask for a body that cannot be, as a model's errors do."""
    arm = Arm(1)
    links, impossible = arm.truth.links.copy(), np.array([MASS, *CENTRE, -2e-2, 0.0, -2e-2, 0.0, 0.0, -2e-2])
    links[-1] += pseudo_inertia.parameters_of(impossible)
    measured, watch = arm.measured(replace(arm.truth, links=links), 5.0 * NOISE), arm.watch()
    arm.watched(measured.select(slice(0, round((AFTER - 1.0) * RATE))), watch)
    assert watch.payload is not None
    assert watch._loaded is not None
    starts = ONE_BODY.point(default_payload(arm.model.nominal_inertias.reshape(-1, 10), -1)), ONE_BODY.point(BALL)
    assert ONE_BODY.distance(*(watch._fit(watch._likelihood(watch._loaded), [start]).point for start in starts)) < 0.05


def test_without_a_payload_there_is_none() -> None:
    arm = Arm()
    assert all(state.carried is None and not state.open for state in arm.watched(arm.measured(arm.truth, 10.0 * NOISE)))


def test_friction_of_a_joint_is_no_payload() -> None:
    """It opens a gap instead."""
    arm = Arm()
    effects = {name: value.copy() for name, value in arm.truth.effects.items()}
    effects["coulomb_friction"][1] *= 3.0
    states = arm.watched(arm.measured(replace(arm.truth, effects=effects)))
    assert all(state.carried is None for state in states)
    assert any(state.open for state in states)


def test_another_robot_costs_few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no payload can explain enough, none is fitted to the end, for each tail of the window in each block."""
    arm, steps, step = Arm(), list[int](), ParameterManifold.exp
    monkeypatch.setattr(ParameterManifold, "exp", lambda *given: steps.append(1) or step(*given))
    links = np.array([body.parameters for body in arm.robot.bodies])
    none = {name: np.zeros_like(values) for name, values in arm.truth.effects.items()}
    states = arm.watched(arm.measured(replace(arm.truth, links=links, effects=none)))
    assert any(state.open for state in states)
    assert len(steps) < REMEMBERED * len(states)


def test_a_gap_that_was_open_before_stays_open_since_then() -> None:
    arm, joint, since = Arm(), 1, 25.0
    effects = {name: value.copy() for name, value in arm.truth.effects.items()}
    effects["coulomb_friction"][1] *= 3.0
    rough = replace(arm.truth, effects=effects)
    times = np.arange(len(arm.moving)) / RATE
    measured = arm.measured(replace(arm.loaded, effects=effects))
    alone = (times >= since) & ((times < BEFORE) | (times >= AFTER))
    more = efforts(arm.robot, rough, arm.moving) - efforts(arm.robot, arm.truth, arm.moving)
    states = arm.watched(replace(measured, effort=measured.effort + more * alone[:, None]))
    assert any(state.carried is not None for state in states)
    opened = [state.gaps[joint].since for state in states if state.time > since + 5.0]
    assert None not in opened
    np.testing.assert_allclose(1e-9 * np.array(opened, dtype=float), since, atol=2.0)


def test_what_was_learned_of_the_robot_is_forgotten_as_time_goes_by() -> None:
    arm = Arm()
    measured, share = arm.measured(arm.truth), 0.9
    rows = arm.model.rows(measured)
    watch = arm.watch()
    same = replace(rows, **{name: values[:10] for name, values in vars(rows).items()})
    learned = []
    for block in range(60):
        watch.update(10 * block, measured.stamps[:10], same, [ChannelNoise(1.0, 0.0)] * 3, share)
        learned.append(watch._baselines[0].information.copy())
    np.testing.assert_allclose(learned[59], (1.0 + share**20) * learned[39], rtol=1e-9)


def test_a_payload_that_was_there_from_the_beginning_is_no_payload_when_it_is_put_down() -> None:
    """What is known of the link is learned anew: the next payload is noticed."""
    arm = Arm(1)
    times = np.arange(len(arm.moving)) / RATE
    felt = efforts(arm.robot, arm.truth, arm.moving)
    for begin, end in ((0.0, 30.0), (70.0, END)):
        carrying = (times >= begin) & (times < end)
        felt[carrying] = efforts(arm.robot, arm.loaded, arm.moving)[carrying]
    states = arm.watched(samples(arm.moving, felt + NOISE * arm.rng.normal(size=felt.shape), RATE))
    assert not any(state.carried for state in states if state.time < 70.0)
    last = states[-1].carried
    assert last is not None
    assert last.mass == pytest.approx(MASS, rel=0.05)
    assert abs(1e-9 * last.since - 70.0) < 1.0


@pytest.mark.parametrize("seed", [1, 2])
def test_a_push_upwards_is_not_learned_as_normal(seed: int) -> None:
    """Nothing is carried when it ends."""
    arm = Arm(seed)
    times = np.arange(len(arm.moving)) / RATE
    felt, loaded = (efforts(arm.robot, each, arm.moving) for each in (arm.truth, arm.loaded))
    pushed = (times >= 50.0) & (times < 56.0)
    felt[pushed] = (2.0 * felt - loaded)[pushed]
    states = arm.watched(samples(arm.moving, felt + NOISE * arm.rng.normal(size=felt.shape), RATE))
    assert not any(state.carried for state in states)
