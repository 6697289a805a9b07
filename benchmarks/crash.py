"""``kill -9`` at random moments, hundreds of times: what the next node still knows, and how soon it says so.

The node runs as a process of its own, with its default parameters and a folder for checkpoints, while joint states come
at 100 Hz. A third of the kills come at any time from the start of the process on, a third in a node that estimates, a
third while a checkpoint is being written. Every life goes on with the folder as the one before left it.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import InertiaStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from benchmarks.measuring import processor_seconds
from benchmarks.report import Report
from geomid_ros.errors import InputError
from geomid_ros.files.archive import decoded
from geomid_ros.files.checkpoints import Checkpoint
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

_URDF = Path(__file__).parents[1] / "bags" / "arm7.urdf"
_RATE = 100.0  # Hz
_PERIOD = 20.0  # [s] after which the motion is the same again
_NOISE = 0.2  # N m
_LONGEST_LIFE = 4.0  # [s] from the start, or the first estimate, to the kill: two periods of checkpoints
_LONGEST_WAIT = 300.0  # [s] for an estimate, or for a checkpoint to be begun
_BURST = 0.006  # [s] in which a checkpoint is written
# The node, which first says when all that it consists of was imported.
_NODE = (
    "import time, rclpy, rclpy.executors, geomid_ros.ros.node; from geomid_ros.ros.main import main; "
    "print(f'imported at {time.time()} after {time.process_time()} s', flush=True); main()"
)
_KINDS = ("at any time", "while it estimates", "while it writes")


@dataclass(frozen=True)
class _Life:
    """One node: how it was killed (``kind``); seconds from the start of the process to the end of its imports, and from
    there to the first estimate, if it was of rows of before (else NaN), also as time on the processor; data ``lost``
    [s]; whether it was killed in the middle of writing; checkpoints that were ``damaged`` afterwards; and whether it
    had gone on from the newest."""

    kind: str
    imports: float
    restart: float
    processor: float
    lost: float
    torn: bool
    damaged: int
    went_on: bool


class _Robot:
    """Publishes joint states at ``_RATE``, and hears estimates, in a thread of this process."""

    def __init__(self, session: Session) -> None:
        self._context = Context()
        domain = 102 + os.getpid() % 120
        os.environ["ROS_DOMAIN_ID"] = str(domain)  # the node inherits it
        # Killed processes leave shared memory behind.
        os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = "UDPv4"
        os.environ["PYTHONFAULTHANDLER"] = "1"
        rclpy.init(context=self._context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("robot", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._names = list(session.robot.joint_names)
        self._motion = _motion(session)
        self._next = 0
        self.estimates: list[float] = []  # [s] when estimates were published
        self.diagnostics = ""  # the last
        self._publisher = self._node.create_publisher(JointState, "joint_states", 1000)
        latched = QoSProfile(depth=256, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._node.create_subscription(InertiaStamped, "geomid/inertias", self._hear, latched)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._hear_diagnostics, 10)
        self._node.create_timer(1.0 / _RATE, self._publish)
        self._ending = False
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending = True
        self._thread.join()
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def _spin(self) -> None:
        while not self._ending:
            self._executor.spin_once(timeout_sec=0.1)

    def _publish(self) -> None:
        position, velocity, effort = self._motion[:, self._next % self._motion.shape[1]]
        self._next += 1
        message = JointState(
            name=self._names, position=position.tolist(), velocity=velocity.tolist(), effort=effort.tolist()
        )
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def _hear(self, message: InertiaStamped) -> None:
        self.estimates.append(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)

    def _hear_diagnostics(self, message: DiagnosticArray) -> None:
        told = [f"{s.name}: {s.message} {[f'{p.key}={p.value}' for p in s.values]}" for s in message.status[:2]]
        self.diagnostics = f"{message.header.stamp.sec}: {'; '.join(told)}"


def _motion(session: Session) -> FloatArray:
    """Positions, velocities and efforts ``(3, instants, joints)`` of a motion that begins anew after ``_PERIOD``."""
    rng = np.random.default_rng(0)
    model, joints = session.model, len(session.robot.joints)
    speeds = 2.0 * np.pi / _PERIOD * rng.integers(1, 16, (5, joints))
    times = np.arange(round(_PERIOD * _RATE))[:, None, None] / _RATE
    angles = speeds * times + rng.uniform(0.0, 2.0 * np.pi, (5, joints))
    motion = np.sin(angles).sum(1), (speeds * np.cos(angles)).sum(1), -(speeds**2 * np.sin(angles)).sum(1)
    nothing = np.zeros((len(times), 0))
    stamps, efforts = np.arange(len(times)), np.zeros((len(times), joints))
    unknown = Samples(stamps, *motion, efforts, nothing, nothing, nothing, np.zeros((len(times), 0, 6)))
    truth = np.append(1.1 * model.nominal_inertias, np.full(len(model.coefficients), 0.3))
    efforts = model.rows(unknown).coefficients @ truth + _NOISE * rng.normal(size=efforts.shape)
    return np.array([motion[0], motion[1], efforts])


class _Keeper:
    """What is in the folder of checkpoints."""

    def __init__(self, folder: Path, session: Session) -> None:
        self.folder = folder
        self._session = session
        self.newest: Checkpoint | None = None

    def look(self) -> int:
        """Read all; how many are damaged. None may be older than what was there before."""
        damaged, before = 0, self.newest
        for path in self.folder.glob("checkpoint-*"):
            try:
                found = decoded(Checkpoint, path.read_bytes(), self._session.meaning)
            except InputError:
                damaged += 1
                continue
            if self.newest is None or found.number > self.newest.number:
                self.newest = found
        if before is not None and self.rows < before.memory.summary.rows:
            raise RuntimeError("rows that were safe are gone")
        return damaged

    @property
    def rows(self) -> int:
        """Those of the newest."""
        return self.newest.memory.summary.rows if self.newest is not None else 0

    @property
    def last(self) -> float:
        """Of the newest, the stamp of the last row [s]."""
        stamp = self.newest.memory.last_stamp if self.newest is not None else None
        return 1e-9 * stamp if stamp is not None else 0.0

    @property
    def unfinished(self) -> set[Path]:
        """Files that are being written, or were when a node was killed."""
        return set(self.folder.glob(".checkpoint-*"))


@contextmanager
def _running(parameters: Path, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A node."""
    command = [sys.executable, "-c", _NODE, "--ros-args", "--params-file", str(parameters)]
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=output)  # noqa: S603 it is a command of ours
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def _live(kind: str, robot: _Robot, keeper: _Keeper, parameters: Path, log: Path, rng: np.random.Generator) -> _Life:
    """Start a node, kill it, and look at what it left."""
    number = keeper.newest.number if keeper.newest is not None else 0
    before = keeper.unfinished
    robot.estimates.clear()
    begin, processor = time.time(), np.nan
    with _running(parameters, log) as process:
        if kind != _KINDS[0]:
            _wait(lambda: any(stamp > begin for stamp in robot.estimates), process, robot, log)
            processor = processor_seconds(process.pid)
        if kind == _KINDS[2]:
            _wait(lambda: bool(keeper.unfinished), process, robot, log)
            time.sleep(rng.uniform(0.0, _BURST))
        else:
            time.sleep(rng.uniform(0.0, _LONGEST_LIFE))
        process.send_signal(signal.SIGKILL)
        process.wait()
        killed = time.time()
    torn = bool(keeper.unfinished - before)
    output = log.read_text(encoding="utf-8", errors="replace")
    imported = _found(r"imported at ([0-9.]+)", output)
    ready = _found(r"\[([0-9.]+)\] \[geomid\]: identifying", output)
    damaged = keeper.look()
    first = min((stamp for stamp in robot.estimates if stamp > begin), default=np.nan)
    return _Life(
        kind,
        imported - begin,
        first - imported if number else np.nan,
        processor - _found(r"after ([0-9.]+) s", output) if number else np.nan,
        # All that came since the node could take messages, or since the last row that is safe.
        max(0.0, killed - max(keeper.last, ready)) if np.isfinite(ready) else 0.0,
        torn,
        damaged,
        not np.isfinite(ready) or number == 0 or f"resumed from checkpoint {number} " in output,
    )


def _found(pattern: str, text: str) -> float:
    match = re.search(pattern, text)
    return float(match[1]) if match else np.nan


def _wait(look: Callable[[], bool], process: subprocess.Popen[bytes], robot: _Robot, log: Path) -> None:
    end = time.monotonic() + _LONGEST_WAIT
    while not look():
        if process.poll() is not None or time.monotonic() > end:
            ended = process.poll()
            process.send_signal(signal.SIGABRT)  # lets it say what every thread is at
            process.wait()
            said = log.read_text(encoding="utf-8", errors="replace")
            raise RuntimeError(f"waited in vain; exit status {ended}; last diagnostics {robot.diagnostics}\n{said}")
        time.sleep(2e-4)


def run(report: Report, kills: int) -> None:
    """Kill so many nodes, and print what that cost."""
    with tempfile.TemporaryDirectory() as name:
        folder, parameters = Path(name) / "kept", Path(name) / "parameters.yaml"
        urdf = read_urdf(_URDF)
        values = {"robot_description": urdf, "checkpoint": {"folder": str(folder)}}
        parameters.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}), encoding="utf-8")
        session = Session(urdf, Configuration(), _URDF.name)
        keeper, rng = _Keeper(folder, session), np.random.default_rng()
        lives: list[_Life] = []
        with _Robot(session) as robot:
            for index in range(kills):
                kind = _KINDS[index % len(_KINDS)] if index else _KINDS[1]
                lives.append(_live(kind, robot, keeper, parameters, Path(name) / "log", rng))
                report.result("crash", [asdict(life) for life in lives])
                if index % 10 == 9:
                    report.progress(f"crash: {index + 1} of {kills} kills")
        _tell(report, lives, keeper)


def _tell(report: Report, lives: list[_Life], keeper: _Keeper) -> None:
    headings = ["killed", "lives", "in the midst of writing", "damaged checkpoints", "did not go on from the newest"]
    headings += ["data lost, median [s]", "p99 [s]", "most [s]", "to first estimate, median [s]", "p99 [s]", "most [s]"]
    headings += ["of the processor, median [s]"]
    groups = {kind: [life for life in lives if life.kind == kind] for kind in _KINDS} | {"all": lives}
    rows = [
        [
            kind,
            str(len(group)),
            str(sum(life.torn for life in group)),
            str(sum(life.damaged for life in group)),
            str(sum(not life.went_on for life in group)),
            *_quantiles([life.lost for life in group]),
            *_quantiles([life.restart for life in group]),
            _quantiles([life.processor for life in group])[0],
        ]
        for kind, group in groups.items()
        if group
    ]
    imports = np.array([life.imports for life in lives])
    caption = (
        "Data lost: from the last row in the newest checkpoint, or when the node was ready if that was later, to the "
        "kill: the filter's fixed lag is in it. To first estimate: from the end of the process's imports, which took "
        f"{np.nanmedian(imports):.2f} s (median; {np.nanmax(imports):.2f} s at most) from its start. In the end "
        f"{keeper.rows} rows were known, of {len(lives)} lives. Load average "
        f"{os.getloadavg()[0]:.1f} on {os.cpu_count()} cores."
    )
    report.table("kill -9", headings, rows, caption)


def _quantiles(seconds: list[float]) -> list[str]:
    known = np.array([second for second in seconds if np.isfinite(second)])
    if not len(known):
        return ["", "", ""]
    return [f"{value:.2f}" for value in (np.median(known), np.quantile(known, 0.99), np.max(known))]


def main() -> None:
    """``python -m benchmarks.crash``"""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.crash", description=__doc__)
    parser.add_argument("--kills", type=int, default=300, help="how many nodes are killed (%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/crash"), help="folder for results.json (%(default)s)")
    arguments = parser.parse_args()
    run(Report(arguments.out), arguments.kills)


if __name__ == "__main__":
    main()
