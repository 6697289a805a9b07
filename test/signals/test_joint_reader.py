"""Joint messages one by one: what is taken, what is left out, and since when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from geomid_ros.signals.joint_messages import JointReader, LockedJoints
from geomid_ros.signals.messages import Block

from .feeding import START, RejectedError, read
from .sent import JointMessage

NAMES = ("a", "b")
STEP = 10_000_000  # [ns]
MAX_GAP = 10 * STEP
NAN = float("nan")


def reader(notes: list[str] | None = None, continuous: Sequence[bool] = (False, False)) -> JointReader:
    note = (lambda _: None) if notes is None else notes.append
    return JointReader(NAMES, np.array([1.0, -2.0]), np.array(continuous), MAX_GAP, note)


def message(index: int, effort: Any = (1.0, 2.0), **other: Any) -> JointMessage:
    """Of joints that move, each time a little further, under efforts that change."""
    position = other.pop("position", (0.1 * index, -0.1 * index))
    velocity = other.pop("velocity", (1.0, -1.0))
    stamp = other.pop("stamp", START + index * STEP)
    effort = tuple(value + 1e-3 * index for value in effort)
    return JointMessage(stamp, other.pop("names", NAMES), position, velocity, effort)


def test_numbers_are_in_the_robot_s_order_and_efforts_in_its_units() -> None:
    mixed = {"position": (2.0, NAN, 1.0), "velocity": (4.0, 9.0, 3.0), "effort": (6.0, 1e99, 5.0)}
    values = read(reader(), message(0, names=("b", "other", "a"), **mixed))
    np.testing.assert_allclose(values, [1.0, 2.0, 3.0, 4.0, 5.0, -12.0])


def test_an_effort_that_fails_costs_messages_for_the_longest_gap_and_then_its_joint() -> None:
    own = reader()
    read(own, message(0))
    for index in range(1, 11):
        with pytest.raises(RejectedError, match="effort of 'b' missing"):
            read(own, message(index, effort=(1.0, NAN)))
        assert own.unmeasured == ()
    read(own, message(11, effort=(1.0, NAN)))
    assert own.unmeasured == ("b",)
    read(own, message(12))
    assert own.unmeasured == ()


def test_after_a_clock_was_set_back_nothing_is_known_of_before() -> None:
    own = reader()
    read(own, message(1000))
    own.restart()
    assert own.unmeasured == ()
    assert np.isnan(read(own, message(0, effort=(1.0, NAN)))[5])


def test_zeros_are_no_efforts_while_the_robot_moves() -> None:
    """Of a robot that stands still they may be right; one that is not zero shows that there is a sensor."""
    own = reader()
    still = read(own, JointMessage(START, NAMES, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0)))
    assert np.all(np.isnan(still[4:])), "nothing is known of the sensor yet"
    moving = read(own, JointMessage(START + STEP, NAMES, (0.1, 0.0), (1.0, 0.0), (0.0, 0.0)))
    assert np.all(np.isnan(moving[4:]))
    assert np.all(np.isfinite(read(own, message(2))[4:]))
    with pytest.raises(RejectedError, match="is zero while the robot moves"):
        read(own, JointMessage(START + 3 * STEP, NAMES, (0.3, 0.0), (1.0, 0.0), (0.0, 0.0)))
    read(own, message(4))
    resting = read(own, JointMessage(START + 5 * STEP, NAMES, (0.4, 0.0), (0.0, 0.0), (0.0, 0.0)))
    assert np.all(resting[4:] == 0.0), "a robot at rest may show zeros"
    later = JointMessage(START + 6 * STEP, NAMES, (0.5, 0.0), (1.0, 0.0), (0.0, 0.0))
    with pytest.raises(RejectedError, match="is zero while the robot moves"):
        read(own, later)


def test_a_joint_that_shows_exactly_zero_is_not_measured_until_it_shows_something_else() -> None:
    """As a gripper's driver does that measures none, while the other joint's does; whatever the effort is for."""
    own = reader()
    shown = [read(own, replace(message(index), effort=(0.0, 1.0 + index)))[4:] for index in range(3)]
    np.testing.assert_array_equal(shown, [[NAN, -2.0], [NAN, -4.0], [NAN, -6.0]])
    assert own.unmeasured == ("a",)
    shown = [read(own, replace(message(index), effort=(effort, 4.0)))[4] for index, effort in ((3, 0.5), (4, 0.0))]
    assert shown == [0.5, 0.0], "a driver that has a sensor may show that nothing acts"
    assert own.unmeasured == ()


def test_the_same_numbers_again_are_frozen_though_an_effort_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    """As it is in one block of both: what counts is what was sent."""
    own = reader()
    monkeypatch.setattr(type(own._saturation), "saturated", lambda *_: np.array([[False, True]]))
    assert np.isnan(read(own, message(0))[5])
    with pytest.raises(RejectedError, match="frozen"):
        read(own, message(0, stamp=START + STEP))


@pytest.mark.parametrize(
    ("step", "velocity", "frozen"),
    [
        (0.0, (1.0, 0.0), True),
        (0.0, (0.0, -1.0), True),
        (0.0, (0.009, 0.0), False),
        (0.011, (), True),
        (0.009, (), False),
    ],
)
def test_the_same_numbers_again_are_frozen_if_the_robot_moves(
    step: float, velocity: tuple[float, ...], frozen: bool
) -> None:
    """By more than a hundredth of a radian per second; without velocities positions tell, here in a second."""
    own, second = reader(), 1_000_000_000
    read(own, message(0, position=(0.0, 0.0), velocity=velocity))
    read(own, message(1, position=(0.0, -step), velocity=velocity, stamp=START + second))
    again = message(1, position=(0.0, -step), velocity=velocity, stamp=START + 2 * second)
    if frozen:
        with pytest.raises(RejectedError, match="frozen"):
            read(own, again)
    else:
        read(own, again)
    read(own, message(300, velocity=velocity))


def test_positions_of_a_joint_without_end_go_on_and_those_of_others_jump() -> None:
    own = reader(continuous=(True, False))
    turn = 2.0 * np.pi
    found = [read(own, message(k, position=(p, p)))[:2] for k, p in enumerate((3.0, 3.1 - turn, 3.2 - turn, 3.1, 0.1))]
    np.testing.assert_allclose([joint[0] for joint in found], [3.0, 3.1, 3.2, 3.1, 0.1 + 0.0], atol=1e-12)
    np.testing.assert_allclose([joint[1] for joint in found], [3.0, 3.1 - turn, 3.2 - turn, 3.1, 0.1])


def test_peculiarities_are_noted_once_and_not_without_end() -> None:
    notes: list[str] = []
    own = reader(notes)
    read(own, message(0, velocity=()))
    read(own, message(1, velocity=()))
    assert notes == ["no velocities: positions are differentiated"]
    for index in range(30):
        names = (*NAMES, f"extra {index}")
        read(
            own, message(2 + index, names=names, position=(0.1 * index, 0.0, 0.0), velocity=(), effort=(1.0, 2.0, 3.0))
        )
    assert len(notes) == len(NAMES) + 10
    assert notes[1] == "ignored, no moving joints of the robot: 'extra 0'"


@pytest.mark.parametrize(
    ("positions", "said"),
    [
        ((0.0, 0.005, -0.005), ""),
        ((np.pi, -np.pi + 0.005, np.pi), "joint 'lid' is locked at zero, but stands at 3.14"),
        ((NAN, 0.0, 0.1), "joint 'lid' is locked at zero, but moves: take it out"),
        ((2.0 * np.pi, 0.3, 0.0), "joint 'lid' is locked at zero, but moves: take it out"),
    ],
)
@pytest.mark.parametrize("together", [True, False])
def test_a_locked_joint_that_does_not_stand_at_zero_is_named(
    positions: tuple[float, ...], said: str, together: bool
) -> None:
    notes: list[str] = []
    locked = LockedJoints(["lid", "in no message"], 0.01, notes.append)
    places = [range(len(positions))] if together else [[place] for place in range(len(positions))]
    for part in places:
        values = np.array([[0.5 * place, positions[place]] for place in part])
        locked.watch(Block("joint_states", np.array(part), np.array(part), ("a", "lid"), (values, values, values)))
    assert [note.startswith(said) for note in notes] == [True] * bool(said)
