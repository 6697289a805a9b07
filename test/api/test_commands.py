"""Motors without torque sensors: efforts by the set-points of their controllers."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands.running import found_only
from files.recordings import BAGS, TYPES, Recorded, recorded, write_bag
from signals.unitree import low_cmd, low_state, write_unitree_bag

import geomid_ros
from geomid_ros.errors import InputError

pytestmark = pytest.mark.usefixtures("found_only")

BAG, URDF = BAGS / "arm3", BAGS / "arm3.urdf"
TOPIC, GAINS = "/desired", ("200:4", "joint2=300:5")
KP, KD = np.array([200.0, 300.0, 200.0]), np.array([4.0, 5.0, 4.0])
JOINTS = ("joint1", "joint2", "joint3")
DELAY = 30_000_000  # [ns]
PERIOD = 10_000_000  # of the bag's messages [ns]


def commanded(reported: float | None) -> Iterator[Recorded]:
    """The messages of a bag, and the set-points that made the efforts measured in it, each sent a while before it acts;
    ``reported`` times the efforts are in the joint states, none if it is None."""
    stamp_type = TYPES.types["builtin_interfaces/msg/Time"]
    for item in recorded(BAG):
        if item.topic != "/joint_states":
            continue
        message = item.message
        order = [list(message.name).index(joint) for joint in JOINTS]
        fields = message.position, message.velocity, message.effort
        position, velocity, effort = (np.array(own)[order] for own in fields)
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec - DELAY
        header = replace(message.header, stamp=stamp_type(*divmod(stamp, 1_000_000_000)))
        wanted = position + (effort + KD * velocity) / KP
        none = np.zeros(0)
        command = replace(message, header=header, name=list(JOINTS), position=wanted, velocity=none, effort=none)
        yield Recorded(TOPIC, item.kind, item.time - 1, command)
        own = none if reported is None else reported * np.array(message.effort)
        yield item.changed(effort=own)


@pytest.fixture(scope="module")
def without_efforts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("commands") / "bag", commanded(None))


def masses(found: geomid_ros.Identification) -> np.ndarray:
    return np.array([link.mass for link in found.links])


@pytest.fixture(scope="module")
def measured() -> geomid_ros.Identification:
    """From the efforts that were measured."""
    with pytest.MonkeyPatch.context() as patch:
        found_only(patch)
        return geomid_ros.identify(BAG, URDF, candidates=())


@pytest.fixture(scope="module")
def found(without_efforts: Path) -> geomid_ros.Identification:
    """From the commands alone."""
    with pytest.MonkeyPatch.context() as patch:
        found_only(patch)
        return geomid_ros.identify(without_efforts, URDF, command=TOPIC, gains=GAINS, candidates=())


def test_efforts_are_those_of_commands_and_their_delay_is_found(
    measured: geomid_ros.Identification, found: geomid_ros.Identification
) -> None:
    """A command that holds until the next one comes is late by half of the time between them: it is found to act that
    much earlier."""
    (left,) = (effect for effect in found.effects if effect.name == "command_delay")
    delay = found.session.configuration["command.delay"] + left.value
    assert delay == pytest.approx(1e-9 * (DELAY - PERIOD / 2), abs=1.5e-3)
    assert f"commands act {1e3 * found.session.configuration['command.delay']:.1f} ms" in " ".join(found.session.notes)
    np.testing.assert_allclose(masses(found), masses(measured), rtol=0.03)
    assert found.verdict.word == measured.verdict.word
    for joint in JOINTS:
        assert found.rms[joint] < 1.3 * measured.rms[joint]


def test_wrong_gains_are_named_by_reported_efforts_and_those_of_a_controller_s_file_are_right(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", commanded(0.5))
    (reason,) = geomid_ros.identify(bag, URDF, command=TOPIC, gains=GAINS, candidates=()).verdict.reasons
    assert "'joint1', given is 200:4" in reason
    file = tmp_path / "controller.yaml"
    gains = {joint: {"p": p, "d": d} for joint, p, d in zip(JOINTS, KP.tolist(), KD.tolist(), strict=True)}
    file.write_text(json.dumps({"controller": {"ros__parameters": {"gains": gains}}}))
    bag = write_bag(tmp_path / "right", commanded(1.0))
    right = geomid_ros.identify(bag, URDF, command=TOPIC, gains=str(file), candidates=())
    assert not [each for each in right.verdict.reasons if "gains" in each]


@pytest.mark.parametrize(
    ("gains", "said"),
    [
        ("200", "KP:KD"),
        ("-1:2", "KP above 0"),
        ("joint9=200:4", "joint9"),
        ("joint1=200:4", "'joint2' has no gains"),
    ],
)
def test_bad_gains_and_an_absent_topic_are_named(without_efforts: Path, gains: str, said: str) -> None:
    with pytest.raises(InputError, match="gains") as error:
        geomid_ros.identify(without_efforts, URDF, command=TOPIC, gains=gains)
    assert said in str(error.value)
    with pytest.raises(InputError, match="--command"):
        geomid_ros.identify(without_efforts, URDF, command="/other", gains=GAINS)


@pytest.fixture(scope="module")
def model(found: geomid_ros.Identification, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("model")
    found.save(folder, report=False)
    return folder / "estimate.json"


def test_a_gap_is_judged_beside_the_delay_of_commands(without_efforts: Path, model: Path) -> None:
    """On the recording that a model is from nothing is found beside it, as far as it goes."""
    gap = geomid_ros.find_gap(without_efforts, URDF, model=model, command=TOPIC, gains=GAINS)
    (note,) = (note for note in gap.session.notes if note.startswith("commands act"))
    assert float(note.split()[2]) == pytest.approx(1e-6 * (DELAY - PERIOD / 2), abs=1.5)
    assert not gap.findings


def test_set_points_that_would_not_be_read_are_refused(without_efforts: Path, model: Path) -> None:
    said = "--command /desired without --gains: .* leave --command out"
    with pytest.raises(InputError, match=said):
        geomid_ros.weigh_payload(BAG, without_efforts, URDF, command=TOPIC)
    with pytest.raises(InputError, match=said):
        geomid_ros.verify(model, without_efforts, URDF, command=TOPIC)
    with pytest.raises(InputError, match=said):
        geomid_ros.identify_fleet(str(without_efforts.parent), URDF, out=model.parent / "fleet", command=TOPIC)


def unitree() -> Iterator[tuple[str, int, bytes]]:
    """The same messages as a Unitree robot sends them: every five seconds its controllers have half of the
    gains, or all of them again, and make the same efforts."""
    states = (item for item in commanded(1.0) if item.topic == "/joint_states")
    for place, item in enumerate(states):
        order = [list(item.message.name).index(joint) for joint in JOINTS]
        fields = item.message.position, item.message.velocity, item.message.effort
        position, velocity, effort = (np.array(own)[order] for own in fields)
        kp, kd = (own / (1.0 + place // 500 % 2) for own in (KP, KD))
        wanted, none = position + (effort + kd * velocity) / kp, np.zeros(3)
        yield "/lowstate", item.time, low_state(np.array([position, velocity, effort]).T, none, none)
        yield "/lowcmd", item.time + 1, low_cmd(np.array([wanted, none, none, kp, kd]).T)


def test_commands_of_unitree_have_the_gains_that_come_with_them(
    measured: geomid_ros.Identification, tmp_path: Path
) -> None:
    bag, given = write_unitree_bag(tmp_path / "bag", unitree()), {"command": "/lowcmd", "gains": GAINS}
    motors = {"motors": list(JOINTS)}
    found = geomid_ros.identify(bag, URDF, config=motors, joint_topic="/lowstate", candidates=(), **given)
    np.testing.assert_allclose(masses(found), masses(measured), rtol=0.02)
    assert found.verdict.word == measured.verdict.word
    for joint in JOINTS:
        assert found.rms[joint] < 1.2 * measured.rms[joint]
