"""How fast ``geomid excite run`` stops a robot: ``python -m benchmarks.excite_run``.

A simulated arm of seven joints and its controller, the run, and this observer are processes of their own; what is
measured here includes the way over DDS and back. In each round something happens in the middle of a motion, and the
observer measures the time to the command that leads to rest, to the rest, and to the sentence that says why.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
import rclpy
import yaml
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from benchmarks.report import Report, chosen
from benchmarks.trajectory_controller import DEAF, GONE, PUSHED, SILENT, STRONG
from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import Bag

ROOT = Path(__file__).parents[1]
URDF = ROOT / "bags/arm7.urdf"
CONTROLLER = "joint_trajectory_controller"
JOINTS = tuple(f"joint{number}" for number in range(1, 8))
AMPLITUDE, PERIOD, WAVES = 0.25, 2.5, 8  # [rad], [s]: up to 0.63 rad/s
FASTEST = 0.3  # [rad/s] of a joint when something happens
STILL = 1e-3  # [rad/s]
PATIENCE = 60.0  # [s]
EVENTS = ("Ctrl-C", PUSHED, STRONG, SILENT, DEAF, GONE, "killed")
DEAD = (DEAF, GONE, "killed")


@dataclass
class Round:
    """What happened, and when [s]: the event, the command, the rest, the sentence."""

    event: str
    happened: float = np.nan
    commanded: float = np.nan
    rested: float = np.nan
    said: float = np.nan
    sentence: str = ""
    status: int = 0
    whole: bool = False
    moving: list[tuple[float, float]] = field(default_factory=list)  # times of joint states, and the fastest joint


def trajectory(path: Path) -> Path:
    """A motion of all joints to and fro."""
    times = np.linspace(0.0, PERIOD * WAVES, 50 * WAVES + 1)
    rate = 2.0 * np.pi / PERIOD
    rows = (
        -AMPLITUDE * (1.0 - np.cos(rate * times)),
        -AMPLITUDE * rate * np.sin(rate * times),
        -AMPLITUDE * rate**2 * np.cos(rate * times),
    )
    names = ("positions", "velocities", "accelerations")
    points: list[dict[str, Any]] = [
        {name: [float(row[index])] * 7 for name, row in zip(names, rows, strict=True)} for index in range(len(times))
    ]
    for point, at in zip(points, times.tolist(), strict=True):
        # The sixth joint's range begins at -0.4.
        for name in names:
            point[name][5] *= 0.5
        point["time_from_start"] = {"sec": int(at), "nanosec": round(1e9 * (at - int(at)))}
    path.write_text(yaml.safe_dump({"joint_names": list(JOINTS), "points": points}), encoding="utf-8")
    return path


class Observer:
    """Hears what the robot and the run say."""

    def __init__(self) -> None:
        self._node = rclpy.create_node("observer")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self.round = Round("")
        self._node.create_subscription(JointState, "joint_states", self._state, 1000)
        self._node.create_subscription(JointTrajectory, f"{CONTROLLER}/joint_trajectory", self._command, 10)
        self._faults = self._node.create_publisher(String, f"{CONTROLLER}/fault", 10)

    def _state(self, message: JointState) -> None:
        now, fastest = time.monotonic(), float(np.max(np.abs(message.velocity)))
        self.round.moving.append((now, fastest))
        wrong = abs(message.effort[0]) > 150.0 or message.position[0] > 0.2
        if wrong and np.isnan(self.round.happened):
            self.round.happened = now

    def _command(self, message: JointTrajectory) -> None:
        if len(message.points) == 1 and np.isnan(self.round.commanded):
            self.round.commanded = time.monotonic()

    def spin_until(self, found: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE
        while not found():
            if time.monotonic() > end:
                raise RuntimeError("nothing comes of it")
            self._executor.spin_once(timeout_sec=0.001)

    def fault(self, name: str) -> None:
        self._faults.publish(String(data=name))


def start(*arguments: str | Path, **options: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", *map(str, arguments)]
    return subprocess.Popen(command, cwd=ROOT, text=True, **options)  # noqa: S603 it is a module of ours


def listen(lines: IO[str], heard: Round, begun: threading.Event) -> None:
    """Note when the run says what."""
    for line in lines:
        if line.startswith("the motion:"):
            begun.set()
        if line.startswith("stopping:"):
            heard.said, heard.sentence = time.monotonic(), line.strip()


def play(observer: Observer, event: str, folder: Path, rate: float) -> Round | None:
    """One round; None if the motion was stopped before anything happened, as on a machine that is too busy."""
    observer.round = now = Round(event)
    robot = start("benchmarks.trajectory_controller", "--urdf", URDF, "--rate", str(rate))
    arguments = (trajectory(folder / "trajectory.yaml"), "--speed", "1", "--execute", "--out", folder)
    run = start("geomid_ros", "excite", "run", *arguments, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
    begun = threading.Event()
    reader = threading.Thread(target=listen, args=(run.stderr, now, begun))
    reader.start()
    observer.spin_until(lambda: begun.is_set() or run.poll() is not None)
    wait = time.monotonic() + PERIOD  # into the motion
    observer.spin_until(lambda: run.poll() is not None or (time.monotonic() > wait and now.moving[-1][1] > FASTEST))
    if run.poll() is not None:
        reader.join()
        robot.send_signal(signal.SIGINT)
        robot.wait()
        return None
    if event == "Ctrl-C":
        now.happened = time.monotonic()
        run.send_signal(signal.SIGINT)
    elif event == "killed":
        now.happened = time.monotonic()
        robot.kill()
    else:
        observer.fault(event)
        now.happened = time.monotonic() if event in DEAD else np.nan
    observer.spin_until(lambda: run.poll() is not None)
    reader.join()
    if event == SILENT:
        now.happened = now.moving[-1][0]
    fast = [at for at, speed in now.moving if speed > STILL]
    now.rested = max(fast)
    now.status = run.returncode
    try:
        with Bag(folder / "run1") as bag:
            now.whole = bag.has_checksums and not bag.warnings
    except InputError:
        now.whole = False
    if event != "killed":
        robot.send_signal(signal.SIGINT)
    robot.wait()
    return now


def row(event: str, rounds: Sequence[Round]) -> list[str]:
    """A line of the table."""

    def times(of: Callable[[Round], float]) -> str:
        values = np.array([1e3 * of(each) for each in rounds])
        return f"{np.median(values):.0f}, {np.max(values):.0f}"

    rests = event not in (*DEAD, SILENT, PUSHED)
    return [
        event,
        times(lambda each: each.commanded - each.happened),
        times(lambda each: each.rested - each.commanded) if rests else "",
        times(lambda each: each.said - each.happened),
        f"{sum(each.status != 0 for each in rounds)} of {len(rounds)}",
        f"{sum(each.whole for each in rounds)} of {len(rounds)}",
        rounds[0].sentence.removeprefix("stopping: ")[:60],
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("events", nargs="*", metavar="EVENT", help=f"any of {', '.join(EVENTS)}")
    parser.add_argument("--rounds", type=int, default=5, help="of each event (%(default)s)")
    parser.add_argument("--rate", type=float, default=250.0, help="joint states a second (%(default)g)")
    parser.add_argument("--out", type=Path, default=Path("out/excite"), help="folder for results (%(default)s)")
    arguments = parser.parse_args()
    os.environ["ROS_DOMAIN_ID"] = str(102 + os.getpid() % 120)
    report = Report(arguments.out)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    rows, observer, early = [], Observer(), 0
    for event in chosen(parser, arguments.events, EVENTS):
        rounds: list[Round] = []
        while len(rounds) < arguments.rounds:
            with tempfile.TemporaryDirectory(prefix="geomid-") as folder:
                played = play(observer, event, Path(folder), arguments.rate)
            rounds += [played] if played is not None else []
            early += played is None
            report.progress(f"{event}: {played.sentence if played is not None else observer.round.sentence}")
        rows.append(row(event, rounds))
        report.result(event, [vars(each) | {"moving": len(each.moving)} for each in rounds])
    headings = ["event", "to the command [ms]", "to rest [ms]", "until said [ms]", "status not 0", "bag whole", "said"]
    caption = (
        f"median, worst; to rest: from the command. {early} more motions were stopped before anything happened. Load "
        f"average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    )
    report.table(f"stopping a motion, joint states at {arguments.rate:g} Hz", headings, rows, caption)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
