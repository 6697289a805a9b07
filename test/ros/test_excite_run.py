"""``geomid excite run`` on a simulated robot whose joint_trajectory_controller is a process of its own."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
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

from benchmarks.trajectory_controller import STRONG
from geomid_ros.excitation.limits import MotionMonitor
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.trajectories import read_trajectory
from geomid_ros.ros.excite import MotionRequest, prepared_run
from geomid_ros.session.options import RunOptions

from .observer import MATCHING
from .processes import Process
from .stage import Stage, staged

JOINTS = ("joint1", "joint2", "joint3")
URDF = BAGS / "arm3.urdf"
START = 0.2  # [rad] of all joints
# However busy the machine is, a robot that does as it is told must not be stopped.
PATIENT = ("--silence", "100", "--tolerance", "0.5")


def controller(stage: Stage, start: float = START) -> Process:
    return stage.start("benchmarks.trajectory_controller", "--urdf", URDF, "--rate", "50", "--start", str(start))


class Robot:
    """A simulated robot, and what it is commanded and says."""

    def __init__(self, stage: Stage, start: float) -> None:
        self.stage, self.observer = stage, stage.observer
        self.commands = stage.observer.collect(JointTrajectory, "/joint_trajectory_controller/joint_trajectory")
        self.heard = stage.observer.collect(JointState, "/joint_states")
        self.process = controller(stage, start)

    def excite(self, motion: Motion, out: str, *arguments: str | Path) -> Process:
        path = motion.write(self.stage.folder / f"{out}.yaml", 100)
        return self.stage.start("geomid_ros", "excite", "run", path, "--out", self.stage.folder / out, *arguments)

    def under_way(self, out: str, *arguments: str) -> Process:
        """A run in the middle of its motion."""
        process = self.excite(bump(JOINTS, 20.0, amplitude=1.5), out, "--speed", "1", "--execute", *arguments)

        def moving() -> bool:
            assert process.running, process.output
            return "the motion:" in process.output and bool(self.heard[-1].position[0] > START + 0.1)

        self.observer.wait_for(moving, "the motion")
        return process

    def set_fault(self, fault: str) -> None:
        faults = self.observer.node.create_publisher(String, "/joint_trajectory_controller/fault", 10)
        self.observer.wait_for(faults.get_subscription_count, "the robot")
        faults.publish(String(data=fault))


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    with staged(tmp_path_factory.mktemp("robot")) as stage:
        yield Robot(stage, start=-0.3)


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


def test_without_execute_nothing_moves(robot: Robot) -> None:
    process = robot.excite(bump(JOINTS, 4.0), "nothing")
    assert status(robot.stage, process) == 0, process.output
    assert "Approach: 0.500 rad (m) to the start" in process.output
    assert "Motion: 20.0 s at 20 % of its speed" in process.output
    assert "Nothing has moved" in process.output
    assert robot.commands == []
    assert np.all(column(robot.heard, "position") == -0.3)
    assert not (robot.stage.folder / "nothing").exists()


def test_what_is_missing_or_in_the_way_is_named_before_anything_moves(robot: Robot) -> None:
    other = robot.stage.folder / "changed.yaml"
    other.write_text(yaml.safe_dump({**bump(JOINTS, 4.0).document(20), "joint_names": ["joint1", "joint2", "x"]}))
    missing, overlap = refused(
        robot.stage,
        ("--controller", "/arm_controller", "--execute"),
        ("--execute", "--avoid", "box:0,0,0.6,0.5,0.5,0.5"),
    )
    assert "nothing subscribes to /arm_controller/joint_trajectory" in missing
    assert "available: /joint_trajectory_controller" in missing
    assert "at the present pose, " in overlap
    assert " and box:0,0,0.6,0.5,0.5,0.5 overlap by " in overlap
    assert "unknown joint of topic robot_description" in refused(robot.stage, (), motion=other)[0]
    assert robot.commands == []


def test_it_goes_slowly_to_the_start_then_through_the_motion_and_records_both(robot: Robot) -> None:
    motion = bump(JOINTS, 3.0)
    process = robot.excite(motion, "slowly", "--speed", "0.5", "--execute", *PATIENT)
    assert status(robot.stage, process) == 0, process.output
    bag = robot.stage.folder / "slowly/run1"
    assert f"Next: geomid identify {bag}" in process.output
    (description,) = [item for item in recorded(bag) if item.topic == "/robot_description"]
    assert description.message.data == URDF.read_text()
    items = states(bag)
    stamps = [item.message.header.stamp.sec * 10**9 + item.message.header.stamp.nanosec for item in items]
    times = 1e-9 * (np.array(stamps) - stamps[0])
    assert np.all(np.diff(times) > 0.0)
    positions, velocities = (column([item.message for item in items], name) for name in ("position", "velocity"))
    np.testing.assert_allclose(positions[0], -0.3, atol=2e-3)  # the recorder may miss the first instants
    away = int(np.argmax(positions[:, 0] > START + 0.01))  # then the motion has begun
    assert np.abs(velocities[:away]).max() < 0.26
    assert np.ptp(positions[:away]) > 0.49
    # The motion is recorded at half of its speed, whenever it began.
    rising = np.linspace(0.0, motion.duration / 2.0, 2000)
    begin = times[away] - 2.0 * np.interp(positions[away, 0], motion.rows(rising)[:, 0], rising)
    wanted = motion.rows(np.clip(0.5 * (times - begin), 0.0, motion.duration))
    np.testing.assert_allclose(positions[away:], wanted[away:], atol=2e-3)
    np.testing.assert_allclose(positions[-1], START, atol=1e-6)


def test_an_error_of_our_own_stops_it_too(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process, with a watch that fails; until then a signal to end is taken as Ctrl-C is."""
    path, bag = bump(JOINTS, 20.0).write(robot.stage.folder / "failing.yaml", 100), robot.stage.folder / "failing"
    order = MotionRequest(
        motion=read_trajectory(path),
        source=str(path),
        speed=1.0,
        urdf=None,
        options=RunOptions(tolerance=0.5, silence=100.0),
    )

    topic, check = "/joint_trajectory_controller/joint_trajectory", MotionMonitor.check
    others = robot.observer.node.count_publishers(topic)

    def fail(monitor: MotionMonitor, *given: Any) -> str:
        assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
        if robot.observer.node.count_publishers(topic) == others:  # who sends is not known yet, and would not be heard
            return check(monitor, *given)
        robot.observer.spin(MATCHING)
        raise RuntimeError("a defect")

    monkeypatch.setenv("ROS_DOMAIN_ID", str(robot.stage.domain))
    before, earlier = signal.getsignal(signal.SIGINT), len(robot.commands)
    said: list[str] = []
    with prepared_run(order) as run:
        monkeypatch.setattr(MotionMonitor, "check", fail)
        with pytest.raises(RuntimeError, match="a defect"):
            run.execute(bag, said.append)
    assert said[-1] == "stopping: RuntimeError('a defect')"
    assert signal.getsignal(signal.SIGINT) is before
    robot.observer.wait_for(
        lambda: len(robot.commands) > earlier and len(robot.commands[-1].points) == 1, "the command to rest"
    )
    states(bag)


def test_what_goes_wrong_stops_it_and_the_bag_is_whole(robot: Robot) -> None:
    """An effort; Ctrl-C is in test_excite_learn.py. The last command leads to rest, and the robot follows it."""
    process, said = robot.under_way("effort", *PATIENT), "the effort of joint 'joint1' is"
    robot.set_fault(STRONG)
    assert status(robot.stage, process) == 2
    assert f"Error: the motion was stopped: {said}" in process.output
    assert f"stopping: {said}" in process.output
    assert "The robot is at rest" in process.output
    assert len(states(robot.stage.folder / "effort/run1")) > 10
    assert robot.process.running
    (point,) = robot.commands[-1].points
    assert list(point.velocities) == [0.0] * 3
    robot.observer.wait_for(lambda: np.allclose(robot.heard[-1].position, point.positions, atol=1e-6), "rest")


def test_a_robot_that_is_killed_is_silent(robot: Robot) -> None:
    """At the end of all tests of it."""
    robot.set_fault("")
    process = robot.under_way("killed", "--silence", "3", "--tolerance", "0.5")
    robot.process.send(signal.SIGKILL)
    assert status(robot.stage, process) == 2
    (point,) = robot.commands[-1].points
    assert list(point.velocities) == [0.0] * 3
    assert "stopping: no joint states for" in process.output
    assert "It is not known whether the robot is at rest" in process.output
    assert len(states(robot.stage.folder / "killed/run1")) > 10


def refused(stage: Stage, *runs: Sequence[str | Path], motion: Path | None = None) -> list[str]:
    """What runs with these arguments say that must not begin, all at once: each waits for what is not there."""
    path = motion or bump(JOINTS, 4.0).write(stage.folder / "trajectory.yaml", 100)
    out = ("--out", stage.folder / "out")
    started = [stage.start("geomid_ros", "excite", "run", path, *out, *arguments) for arguments in runs]
    assert [status(stage, process) for process in started] == [2] * len(runs)
    assert not (stage.folder / "out").exists()
    return [process.output.partition("Error: ")[2] for process in started]


def test_without_a_robot_or_out_of_its_range_nothing_is_commanded(stage: Stage) -> None:
    """The first joint's range ends at 2.8."""
    described, heard = refused(stage, (), ("--urdf", URDF))
    assert "no message on robot_description; give the URDF with --urdf" in described
    assert "no joint states on /joint_states: check that the driver runs" in heard
    node = stage.observer.node
    states = node.create_publisher(JointState, "joint_states", 10)

    def say() -> None:
        message = JointState(name=JOINTS, position=[2.9] * 3, velocity=[0.0] * 3, effort=[0.0] * 3)
        message.header.stamp = node.get_clock().now().to_msg()
        states.publish(message)

    node.create_timer(0.02, say)
    (message,) = refused(stage, ("--urdf", URDF, "--execute"))
    assert "joint 'joint1' is at 2.900, outside its range -2.8 to 2.8 in the URDF: move it back" in message
