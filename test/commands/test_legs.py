"""A quadruped without force sensors and odometry, from a simulated recording to its links; and what is refused."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from files.recordings import Recorded, recorded, write_bag
from model.robots import urdf
from signals.unitree import low_state, write_unitree_bag

import geomid_ros
from benchmarks.legs import CONTACTS, FEET, IMU, misplaced, true_parameters
from geomid_ros.checks.verdict import DOUBTFUL, USABLE
from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import Bag
from geomid_ros.model.effects import DEFAULT_EFFECTS
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Topics, read_samples
from geomid_ros.session.session import Session
from geomid_ros.simulation.walking import WalkOptions, simulate_walk

from .running import NO_CHOICE, found_only, geomid, refused

CONFIG = Path(__file__).parents[2] / "config"
LEGS = ("--imu", f"/imu:{IMU}", "--contacts", ",".join(CONTACTS), "--cutoff", "15", "--no-report", *NO_CHOICE)
# The simulated efforts have no offsets: to find that out takes two thirds of a solve.
EFFECTS = [name for name in DEFAULT_EFFECTS if name != "effort_offset"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With ``walk``, its truth, and the robot's description ``go2.urdf``."""
    folder = tmp_path_factory.mktemp("legs")
    description = folder / "go2.urdf"
    description.write_text(urdf("go2.urdf"), encoding="utf-8")
    simulate_walk(folder / "walk", walk(folder))
    return folder


def walk(folder: Path) -> WalkOptions:
    gaits = ("wobble", "lift")
    return WalkOptions(robot=str(folder / "go2.urdf"), feet=FEET, imu=IMU, gaits=gaits, duration=20.0, rate=125.0)


@cache
def until(walk: Path, seconds: int) -> list[Recorded]:
    """The beginning of the recording."""
    return [item for item in recorded(walk) if item.time < (1_700_000_000 + seconds) * 1_000_000_000]


def spoiled(folder: Path, out: Path, change: Callable[[Recorded], Recorded | None]) -> Path:
    """Six seconds of the recording with changed messages."""
    return write_bag(out / "spoiled", filter(None, map(change, until(folder / "walk", 6))))


def test_masses_are_found(folder: Path) -> None:
    """The total mass to a hundredth and the trunk's with its payload as surely as is said; all links are possible."""
    found = identified(folder / "walk", folder / "go2.urdf", hold_out=0.0, effects=DEFAULT_EFFECTS)
    assert found.verdict.word == USABLE, found.verdict
    for wrong in ("never long enough in the air", "on the base"):
        assert not [each for each in found.warnings if wrong in each]
    robot = Robot(urdf("go2.urdf"), floating_base=True)
    truth = dict(zip(robot.body_names, true_parameters(robot, folder / "walk.truth.json"), strict=True))
    links = {link.name: link for link in found.links}
    total = sum(link.mass for link in links.values())
    assert total == pytest.approx(sum(body[0] for body in truth.values()), abs=0.15)
    covariance, links_end = found.estimate.posterior.parameter_covariance, 10 * len(links)
    std = np.sqrt(np.sum(covariance[:links_end:10, :links_end:10]))
    assert std > 0.003 * total, "an accelerometer's bias is in all of it"
    trunk, true = links["base"], truth["base"]
    assert trunk.mass - 2.5 > robot.bodies[robot.body_names.index("base")].parameters[0], "the payload is found"
    assert abs(trunk.mass - true[0]) < 3.0 * trunk.std_mass
    np.testing.assert_allclose(trunk.com, true[1:4] / true[0], atol=0.015)
    model = pin.buildModelFromXML(found.urdf(), pin.JointModelFreeFlyer())
    for inertia in model.inertias[1:]:
        moments = np.linalg.eigvalsh(inertia.inertia)
        assert inertia.mass > 0.0
        assert moments[0] > 0.0
        assert moments[0] + moments[1] > moments[2]


def identified(bag: Path, urdf: Path, **options: Any) -> geomid_ros.Identification:
    """What the command would write, which takes as long as to find it."""
    usual: dict[str, Any] = {"imu": f"/imu:{IMU}", "contacts": CONTACTS, "cutoff": 15.0, "effects": EFFECTS}
    with pytest.MonkeyPatch.context() as patch:
        found_only(patch)
        return geomid_ros.identify(bag, urdf, **{**usual, "candidates": [], **options})


@pytest.mark.usefixtures("in_a_step")
def test_a_foot_that_no_contact_names_is_found(folder: Path) -> None:
    """By what its leg bears; and nothing is said that follows from that."""
    found = identified(folder / "walk", folder / "go2.urdf", contacts=CONTACTS[:3], alike="none")
    assert found.verdict.word == DOUBTFUL
    (sentence,) = found.verdict.reasons
    share = float(re.findall(r"(\d+) % at 'RR_foot'", sentence)[0])
    assert 10.0 < share < 50.0
    assert found.warnings == []
    assert not any(effect.name == "drive_gain" for effect in found.effects), "what the ground does is not measured"


def test_an_imu_that_is_turned_is_told(folder: Path, tmp_path: Path) -> None:
    """By the angle, and the total mass is as right as without. The simulated legs are not alike, and two of them stand
    in all that is fitted: what the others tell of them is wrong."""
    (tmp_path / "turned.urdf").write_text(misplaced(urdf("go2.urdf"), np.deg2rad(4.0), 0.0), encoding="utf-8")
    found = identified(folder / "walk", tmp_path / "turned.urdf", alike="none")
    (sentence,) = (each for each in found.warnings if "the IMU" in each)
    angle = float(sentence.partition("turned by ")[2].partition(" degrees")[0])
    assert found.verdict.word == USABLE, found.verdict
    assert angle == pytest.approx(4.0, abs=1.0)
    (standing,) = (each for each in found.warnings if "never long enough in the air" in each)
    assert standing.startswith("the training data show RL_foot, RR_foot never")
    assert "--hold-out 0" in standing


def test_an_imu_elsewhere_is_told(folder: Path, tmp_path: Path) -> None:
    """By how far and where: it is doubted, as the centre of mass is off."""
    (tmp_path / "moved.urdf").write_text(misplaced(urdf("go2.urdf"), 0.0, 0.1), encoding="utf-8")
    found = identified(folder / "walk", tmp_path / "moved.urdf")
    assert found.verdict.word == DOUBTFUL
    (sentence,) = (each for each in found.verdict.reasons if "IMU" in each)
    place = [float(number) for number in re.findall(r"[+-]\d+", sentence)]
    np.testing.assert_allclose(place, [-100.0, 0.0, 0.0], atol=15.0)


@pytest.mark.usefixtures("found_only")
def test_a_load_on_the_trunk_is_named(folder: Path, tmp_path: Path) -> None:
    """Beside a model of the same robot without it, from another motion: nothing else is sure."""
    loaded = write_bag(tmp_path / "loaded", until(folder / "walk", 10))
    simulate_walk(tmp_path / "empty", replace(walk(folder), motion_seed=5, duration=10.0, payload=0.0))
    identified(tmp_path / "empty", folder / "go2.urdf").save(tmp_path / "model", report=False)
    arguments = [loaded, "--urdf", folder / "go2.urdf", *LEGS[:-2], "--alike", "none"]
    geomid("gap", *arguments, "--model", tmp_path / "model" / "estimate.json", "--out", tmp_path / "gap")
    document = json.loads((tmp_path / "gap" / "gap.json").read_text(encoding="utf-8"))
    (sure,) = (finding for finding in document["findings"] if finding["probability"] > 0.95)
    assert (sure["effect"], sure["link"]) == ("payload", "base")
    numbers = {name: parameter["value"] for name, parameter in sure["parameters"].items()}
    assert numbers["mass"] == pytest.approx(walk(folder).payload, rel=0.05)
    np.testing.assert_allclose([numbers[f"com_{axis}"] for axis in "xyz"], walk(folder).payload_at, atol=0.01)


def samples_of(folder: Path, bag: Path, topics: Topics, **values: object) -> Samples:
    """What is read of a recording with the quadruped's parameters."""
    configuration = Configuration.read(CONFIG / "quadruped.yaml").with_values(values)
    session = Session(urdf("go2.urdf"), configuration, str(folder / "go2.urdf"))
    with Bag(bag) as opened:
        return Samples.concatenate(list(read_samples(opened, session, session.new_pipeline(), topics)))


def test_the_messages_of_unitree_say_what_those_of_ros_do(folder: Path, tmp_path: Path) -> None:
    """In the order of Unitree's motors and in single precision; without the order they are refused."""
    motors = Configuration.read(CONFIG / "quadruped.yaml")["motors"]
    joints: dict[int, Any] = {}
    states: list[tuple[str, int, bytes]] = []
    with Bag(folder / "walk") as bag:
        for topic, time, message in islice(bag.messages(["/joint_states", "/imu"]), 3000):
            if topic == "/joint_states":
                joints[time] = message
            if topic == "/imu" and time in joints:
                own = joints[time]
                places = [list(own.name).index(joint) for joint in motors]
                numbers = np.array([own.position, own.velocity, own.effort])[:, places].T
                sensed = message.angular_velocity, message.linear_acceleration
                states.append(("/lowstate", time, low_state(numbers, *(np.array([v.x, v.y, v.z]) for v in sensed))))
    write_unitree_bag(tmp_path / "unitree", states)
    topics = Topics("/lowstate", "", "/lowstate")
    found = samples_of(folder, tmp_path / "unitree", topics)
    expected = samples_of(folder, folder / "walk", Topics("joint_states", "")).select(slice(len(found)))
    np.testing.assert_array_equal(found.stamps, expected.stamps)
    for name in ("position", "effort", "base_velocity", "base_acceleration"):
        np.testing.assert_allclose(found.arrays[name], expected.arrays[name], rtol=0.0, atol=1e-4)
    with pytest.raises(InputError, match=r"quadruped\.yaml: motors: expected .* there are: none"):
        samples_of(folder, tmp_path / "unitree", topics, motors=[])


def scaled(key: str, factor: float) -> Callable[[Recorded], Recorded]:
    """Messages with a field multiplied."""

    def change(item: Recorded) -> Recorded:
        value = getattr(item.message, key, None)
        if value is None:
            return item
        if key == "effort":
            return item.changed(effort=factor * value)
        return item.changed(**{key: replace(value, **{axis: factor * getattr(value, axis) for axis in "xyz"})})

    return change


@cache
def trunk_held() -> pin.Model:
    """The legs' joints alone."""
    return pin.buildModelFromXML(urdf("go2.urdf"))


def hanging(item: Recorded) -> Recorded:
    """Messages with the efforts that hold legs which do not touch the ground."""
    if item.topic != "/joint_states":
        return item
    model = trunk_held()
    return item.changed(effort=pin.computeGeneralizedGravity(model, model.createData(), item.message.position))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (scaled("linear_acceleration", 1.0 / 9.81), "imu: the acceleration is not gravity on average: it is in g, "),
        (scaled("linear_acceleration", 0.0), "or the driver has removed gravity: publish"),
        (hanging, "no ground contact at feet FL_foot, FR_foot, RL_foot, RR_foot"),
        (scaled("effort", np.nan), "or compute them from set-points: --command TOPIC with --gains KP:KD"),
        (lambda item: None if item.topic == "/imu" else item, "has no topic /imu; --imu names another"),
    ],
)
def test_recordings_that_cannot_be_used_are_refused(
    folder: Path, tmp_path: Path, change: Callable[[Recorded], Recorded | None], message: str
) -> None:
    bag = spoiled(folder, tmp_path, change)
    said = refused("identify", bag, "--urdf", folder / "go2.urdf", *LEGS, "--out", tmp_path / "out")
    assert message in " ".join(said.split())
    assert not (tmp_path / "out").exists()


def test_a_link_at_the_knee_is_no_foot(folder: Path, tmp_path: Path) -> None:
    """It is named, and not the feet beside it."""
    bag = spoiled(folder, tmp_path, lambda item: item)
    with pytest.raises(
        InputError, match=r"forces on FL_calf are not identifiable .*\(--contacts\), not those at a knee"
    ):
        identified(bag, folder / "go2.urdf", contacts=["FL_calf", *CONTACTS[1:]])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--contacts", "FL_fot"), "contacts need an IMU on the base (--imu TOPIC:FRAME, imu.frame) or its pose"),
        (("--imu", "/imu:imu", "--contacts", "FL_fot"), "unknown link of a contact 'FL_fot'"),
        (("--imu", "/imu:imo", "--contacts", "FL_foot"), "imu.frame: unknown link 'imo'. Did you mean 'imu'"),
        (("--imu", "/imu:imu"), "a floating base needs --contacts"),
        (("--imu", "imu"), "TOPIC:FRAME"),
    ],
)
def test_options_that_cannot_be_are_refused(folder: Path, tmp_path: Path, options: Sequence[str], message: str) -> None:
    said = refused("identify", folder / "walk", "--urdf", folder / "go2.urdf", *options, "--out", tmp_path / "out")
    assert message in " ".join(said.split())


def late(item: Recorded) -> Recorded:
    """The messages of an IMU whose clock is 100 ms ahead."""
    if item.topic != "/imu":
        return item
    header = item.message.header
    sec, nanosec = divmod(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec + 100_000_000, 1_000_000_000)
    return item.changed(header=replace(header, stamp=replace(header.stamp, sec=sec, nanosec=nanosec)))


def turned(item: Recorded) -> Recorded:
    """The messages of an IMU that is turned about the vertical, where gravity tells nothing of it."""
    if item.topic != "/imu":
        return item
    cos, sin = np.cos(0.5), np.sin(0.5)
    sensed = {key: getattr(item.message, key) for key in ("angular_velocity", "linear_acceleration")}
    return item.changed(
        **{key: replace(v, x=cos * v.x + sin * v.y, y=cos * v.y - sin * v.x) for key, v in sensed.items()}
    )


def reversed_hip(item: Recorded) -> Recorded:
    if item.topic != "/joint_states":
        return item
    signs = np.where(np.array(item.message.name) == "FL_hip_joint", -1.0, 1.0)
    return item.changed(effort=signs * item.message.effort)


def without_a_leg(item: Recorded) -> Recorded:
    if item.topic != "/joint_states":
        return item
    silent = np.char.startswith(np.array(item.message.name), "FL_")
    return item.changed(effort=np.where(silent, np.nan, item.message.effort))


def with_friction(item: Recorded) -> Recorded:
    """Of 1.5 N m at each joint, as much as a leg in the air weighs there."""
    if item.topic != "/joint_states":
        return item
    return item.changed(effort=item.message.effort + 1.5 * np.tanh(item.message.velocity / 0.01))


@pytest.mark.usefixtures("in_a_step")
def test_a_leg_whose_joints_have_friction_is_in_the_air_all_the_same(folder: Path, tmp_path: Path) -> None:
    """Which is known after a first look."""
    bag = write_bag(tmp_path / "rubbed", map(with_friction, until(folder / "walk", 20)))
    found = identified(bag, folder / "go2.urdf", hold_out=0.0)
    assert not [each for each in found.warnings if "never long enough" in each]
    assert np.all(np.isfinite([*found.rms.values()]))
    friction = [effect.value for effect in found.effects if effect.name == "coulomb_friction"]
    np.testing.assert_allclose(friction, 1.5, atol=0.4)


@pytest.mark.usefixtures("in_a_step")
@pytest.mark.parametrize(
    ("change", "seconds", "reason"),
    [
        (without_a_leg, 20, "what it carries are not identified: ground reaction forces are unknown"),
        (late, 20, r"\b(9[4-9]|10[0-6]) ms late\b.*synchronise its clock"),
        (turned, 20, r"turned by about (2[5-9]|3[0-2]) degrees against its frame"),
        (reversed_hip, 20, "effort of joint 'FL_hip_joint' is reversed: with joint.FL_hip_joint.effort_gain: -1.0"),
        (scaled("effort", -1.0), 6, "leg efforts support -1"),
        (scaled("effort", 10.0), 6, "leg efforts support 1"),
    ],
)
def test_what_the_legs_contradict_is_doubted_first(
    change: Callable[[Recorded], Recorded], seconds: int, reason: str, folder: Path, tmp_path: Path
) -> None:
    """An IMU whose clock is off or that is turned, a reversed effort, efforts of another sign or unit."""
    bag = write_bag(tmp_path / "spoiled", map(change, until(folder / "walk", seconds)))
    found = identified(bag, folder / "go2.urdf", alike="none", hold_out=0.0)
    assert found.verdict.word == DOUBTFUL
    assert re.search(reason, found.verdict.reasons[0]), found.verdict.reasons
    assert found.warnings == [] or change is not reversed_hip, "what else is strange follows from it"


def test_a_base_that_is_said_to_be_fixed_is_refused(folder: Path, tmp_path: Path) -> None:
    """The bag has an IMU, and the legs carry the robot: how to name both is said before anything is solved."""
    bag = spoiled(folder, tmp_path, lambda item: item)
    feet = ",".join(f"{foot}:RADIUS" for foot in FEET)
    with pytest.raises(InputError, match=f"is not fixed. Say so with --imu /imu:FRAME and --contacts {feet}"):
        geomid_ros.identify(bag, folder / "go2.urdf", candidates=[])
