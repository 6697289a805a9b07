"""``geomid excite run`` on a simulated robot whose joint_trajectory_controller is a process of its own."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from excitation.motions import Motion, bump
from files.recordings import BAGS, Recorded, recorded
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from benchmarks.trajectory_controller import GONE, STRONG
from geomid_ros.excitation.limits import MotionMonitor
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.trajectories import read_trajectory
from geomid_ros.ros.excite import MotionRequest, prepared_run
from geomid_ros.session.options import RunOptions

from .processes import Process
from .stage import Stage

JOINTS = ("joint1", "joint2", "joint3")
URDF = BAGS / "arm3.urdf"
START = 0.2  # [rad] of all joints
# However busy the machine is, a robot that does as it is told must not be stopped.
PATIENT = ("--silence", "100", "--tolerance", "0.5")
FAST = ("--speed", "1", "--execute")


def controller(stage: Stage, start: float = START) -> Process:
    return stage.start("benchmarks.trajectory_controller", "--urdf", URDF, "--rate", "50", "--start", str(start))


def excite(stage: Stage, motion: Motion, *arguments: str | Path) -> Process:
    path = motion.write(stage.folder / "trajectory.yaml", 100)
    return stage.start("geomid_ros", "excite", "run", path, "--out", stage.folder / "out", *arguments)


def status(stage: Stage, process: Process) -> int:
    """The exit status of a process; messages come meanwhile."""
    stage.observer.wait_for(lambda: not process.running, "the end of a process")
    return process.status()


def states(bag: Path) -> list[Recorded]:
    """The joint states in a bag, which must be whole and have its checksums."""
    with Bag(bag) as opened:
        assert opened.warnings == ()
        assert opened.has_checksums
    return [item for item in recorded(bag) if item.topic == "/joint_states"]


def column(messages: list[Any], name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([list(getattr(message, name)) for message in messages])


def test_without_execute_nothing_moves(stage: Stage) -> None:
    commands = stage.observer.collect(JointTrajectory, "/joint_trajectory_controller/joint_trajectory")
    heard = stage.observer.collect(JointState, "/joint_states")
    controller(stage, start=0.5)
    process = excite(stage, bump(JOINTS, 4.0))
    assert status(stage, process) == 0, process.output
    assert "Approach: 0.300 rad (m) to the start" in process.output
    assert "Motion: 20.0 s at 20 % of its speed" in process.output
    assert "Nothing has moved" in process.output
    assert commands == []
    assert np.all(column(heard, "position") == 0.5)
    assert not (stage.folder / "out").exists()


def test_it_goes_slowly_to_the_start_then_through_the_motion_and_records_both(stage: Stage) -> None:
    controller(stage, start=-0.3)
    motion = bump(JOINTS, 3.0)
    process = excite(stage, motion, "--speed", "0.5", "--execute", *PATIENT)
    assert status(stage, process) == 0, process.output
    bag = stage.folder / "out/run1"
    assert f"Next: geomid identify {bag}" in process.output
    (description,) = [item for item in recorded(bag) if item.topic == "/robot_description"]
    assert description.message.data == URDF.read_text()
    items = states(bag)
    stamps = [item.message.header.stamp.sec * 10**9 + item.message.header.stamp.nanosec for item in items]
    times = 1e-9 * (np.array(stamps) - stamps[0])
    assert np.all(np.diff(times) > 0.0)
    positions, velocities = (column([item.message for item in items], name) for name in ("position", "velocity"))
    np.testing.assert_allclose(positions[0], -0.3, atol=1e-6)
    away = int(np.argmax(positions[:, 0] > START + 0.01))  # then the motion has begun
    assert np.abs(velocities[:away]).max() < 0.26
    assert np.ptp(positions[:away]) > 0.49
    # The motion is recorded at half of its speed, whenever it began.
    rising = np.linspace(0.0, motion.duration / 2.0, 2000)
    begin = times[away] - 2.0 * np.interp(positions[away, 0], motion.rows(rising)[:, 0], rising)
    wanted = motion.rows(np.clip(0.5 * (times - begin), 0.0, motion.duration))
    np.testing.assert_allclose(positions[away:], wanted[away:], atol=2e-3)
    np.testing.assert_allclose(positions[-1], START, atol=1e-6)


def under_way(stage: Stage, motion: Motion, *arguments: str) -> tuple[Process, list[Any], list[Any]]:
    """A run in the middle of its motion, with the joint states and commands so far."""
    commands = stage.observer.collect(JointTrajectory, "/joint_trajectory_controller/joint_trajectory")
    heard = stage.observer.collect(JointState, "/joint_states")
    process = excite(stage, motion, *FAST, *arguments)

    def moving() -> bool:
        assert process.running, process.output
        return "the motion:" in process.output and bool(heard) and heard[-1].position[0] > START + 0.1

    stage.observer.wait_for(moving, "the motion")
    return process, heard, commands


def rests(stage: Stage, heard: list[Any], commands: list[Any]) -> None:
    """The last command leads to rest, and the robot has followed it."""
    (point,) = commands[-1].points
    assert list(point.velocities) == [0.0] * 3
    stage.observer.wait_for(lambda: np.allclose(heard[-1].position, point.positions, atol=1e-6), "rest")


# What is done to the robot, and what is said. That of Ctrl-C is in test_excite_learn.py.
STOPS = {
    "an effort": (STRONG, "the effort of joint 'joint1' is"),
    "a controller that is gone": (GONE, "the controller "),  # is gone, or does not follow: whichever is seen first
}


@pytest.mark.parametrize("case", STOPS)
def test_what_goes_wrong_stops_it_and_the_bag_is_whole(case: str, stage: Stage) -> None:
    fault, said = STOPS[case]
    robot = controller(stage)
    process, heard, commands = under_way(stage, bump(JOINTS, 20.0, amplitude=1.5), *PATIENT)
    faults = stage.observer.node.create_publisher(String, "/joint_trajectory_controller/fault", 10)
    stage.observer.wait_for(faults.get_subscription_count, "the robot")
    faults.publish(String(data=fault))
    assert status(stage, process) == 2
    assert f"Error: the motion was stopped: {said}" in process.output
    assert f"stopping: {said}" in process.output
    assert len(states(stage.folder / "out/run1")) > 10
    assert robot.running
    if fault != GONE:
        rests(stage, heard, commands)
    assert "The robot is at rest" in process.output


def test_an_error_of_our_own_stops_it_too(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process, with a watch that fails; until then a signal to end is taken as Ctrl-C is."""
    controller(stage)
    commands = stage.observer.collect(JointTrajectory, "/joint_trajectory_controller/joint_trajectory")
    path = bump(JOINTS, 20.0).write(stage.folder / "trajectory.yaml", 100)
    order = MotionRequest(
        motion=read_trajectory(path),
        source=str(path),
        speed=1.0,
        urdf=None,
        options=RunOptions(tolerance=0.5, silence=100.0),
    )

    def fail(*_: object) -> str:
        assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
        raise RuntimeError("a defect")

    monkeypatch.setenv("ROS_DOMAIN_ID", str(stage.domain))
    before = signal.getsignal(signal.SIGINT)
    said: list[str] = []
    with prepared_run(order) as run:
        monkeypatch.setattr(MotionMonitor, "check", fail)
        with pytest.raises(RuntimeError, match="a defect"):
            run.execute(stage.folder / "run1", said.append)
    assert said[-1] == "stopping: RuntimeError('a defect')"
    assert signal.getsignal(signal.SIGINT) is before
    stage.observer.wait_for(lambda: commands and len(commands[-1].points) == 1, "the command to rest")
    states(stage.folder / "run1")


def test_a_robot_that_is_killed_is_silent(stage: Stage) -> None:
    robot = controller(stage)
    process, _, commands = under_way(stage, bump(JOINTS, 20.0, amplitude=1.5), "--silence", "3", "--tolerance", "0.5")
    robot.send(signal.SIGKILL)
    assert status(stage, process) == 2
    (point,) = commands[-1].points
    assert list(point.velocities) == [0.0] * 3
    assert "stopping: no joint states for" in process.output
    assert "It is not known whether the robot is at rest" in process.output
    assert len(states(stage.folder / "out/run1")) > 10


def refused(stage: Stage, *runs: Sequence[str | Path], motion: Path | None = None) -> list[str]:
    """What runs with these arguments say that must not begin, all at once: each waits for what is not there."""
    path = motion or bump(JOINTS, 4.0).write(stage.folder / "trajectory.yaml", 100)
    out = ("--out", stage.folder / "out")
    started = [stage.start("geomid_ros", "excite", "run", path, *out, *arguments) for arguments in runs]
    assert [status(stage, process) for process in started] == [2] * len(runs)
    assert not (stage.folder / "out").exists()
    return [process.output.partition("Error: ")[2] for process in started]


def test_what_is_not_there_is_named(stage: Stage) -> None:
    described, heard = refused(stage, (), ("--urdf", URDF))
    assert "no message on robot_description; give the URDF with --urdf" in described
    assert "no joint states on /joint_states: check that the driver runs" in heard
    controller(stage)
    (message,) = refused(stage, ("--controller", "/arm_controller", "--execute"))
    assert "nothing subscribes to /arm_controller/joint_trajectory" in message
    assert "available: /joint_trajectory_controller" in message
    other = stage.folder / "changed.yaml"
    other.write_text(yaml.safe_dump({**bump(JOINTS, 4.0).document(20), "joint_names": ["joint1", "joint2", "x"]}))
    assert "unknown joint of topic robot_description" in refused(stage, (), motion=other)[0]


def test_a_robot_that_is_out_of_its_range_is_not_moved(stage: Stage) -> None:
    """The first joint's range ends at 2.8."""
    controller(stage, start=2.9)
    (message,) = refused(stage, ("--execute",))
    assert "joint 'joint1' is at 2.900, outside its range -2.8 to 2.8 in the URDF: move it back" in message


def test_what_is_in_the_way_is_named_before_anything_moves(stage: Stage) -> None:
    controller(stage)
    inside = ("--execute", "--avoid", "box:0,0,0.6,0.5,0.5,0.5")
    overlap, excluded = refused(stage, inside, ("--no-collision", "--avoid", "plane:0,0,1,-1"))
    assert "at the present pose, " in overlap
    assert " and box:0,0,0.6,0.5,0.5,0.5 overlap by " in overlap
    assert "exclude each other" in excluded
