"""What a test of the node needs: a domain, processes, an observer; and the small arm."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from files.recordings import BAGS, Recorded, recorded
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState

from .domains import free_domain
from .observer import Observer
from .processes import Process, parameter_file

WRIST: dict[str, Any] = {"wrenches": ["wrist"], "wrench": {"wrist": {"topic": "/wrench", "frame": "wrist_ft"}}}
# To choose among effects takes most of a solve's time; where nobody looks at them there are none to choose from.
NO_CHOICE: dict[str, Any] = {"candidates": [""]}
KINDS = {"/joint_states": JointState, "/wrench": WrenchStamped}


def description(robot: str) -> str:
    """A shipped robot's URDF."""
    return (BAGS / f"{robot}.urdf").read_text(encoding="utf-8")


def messages(robot: str = "arm3") -> list[Recorded]:
    """What a shipped bag has on the data topics."""
    return list(_messages(robot))


@cache
def _messages(robot: str) -> tuple[Recorded, ...]:
    return tuple(item for item in recorded(BAGS / robot) if item.topic in KINDS)


class Stage:
    """A ROS domain with the processes that a test starts in it."""

    def __init__(self, domain: int, folder: Path) -> None:
        self.domain = domain
        self.folder = folder
        self.processes: list[Process] = []
        self.observer = Observer(domain, self._waited)

    def _waited(self) -> float:
        """How long all threads of all processes have waited for a processor [s]."""
        return sum(sum(process.waits().values()) for process in self.processes)

    def start(self, *arguments: str | Path, fresh: bool = False) -> Process:
        """Start a module of this package; ``fresh``: see :class:`Process`."""
        process = Process(self.domain, self.folder / f"process{len(self.processes)}", arguments, fresh)
        self.processes.append(process)
        return process

    def node(
        self,
        parameters: dict[str, Any] | None = None,
        *ros_arguments: str,
        name: str = "geomid",
        ready: bool = True,
        module: str = "geomid_ros.ros.main",
        fresh: bool = False,
    ) -> Process:
        """Start a node with these parameters, and wait until it serves unless told otherwise."""
        folder = self.folder / f"parameters{len(self.processes)}"
        folder.mkdir()
        path = parameter_file(folder, parameters or {})
        process = self.start(module, "--ros-args", "--params-file", path, *ros_arguments, fresh=fresh)
        if ready:
            self.serving(process, name)
        return process

    def serving(self, process: Process, name: str = "geomid") -> None:
        """Wait until a node offers its services."""
        wanted = f"/{name}/save"

        def offered() -> bool:
            assert process.running, process.output
            return any(service == wanted for service, _ in self.observer.node.get_service_names_and_types())

        self.observer.wait_for(offered, f"service {wanted}")

    def play(self, bag: Path, rate: float = 1.0, *arguments: str | Path, fresh: bool = False) -> Process:
        """Start to play a bag."""
        return self.start("geomid_ros", "play", bag, "--rate", str(rate), "--wait", "300", *arguments, fresh=fresh)

    def spin_while(self, process: Process) -> None:
        """Let messages come until a process has ended well."""
        self.observer.wait_for(lambda: not process.running, "the end of a process")
        assert process.status() == 0, process.output

    def fed(self, counts: dict[str, int], node: str = "geomid") -> Any:
        """The first diagnostics that count so many received messages by topic."""
        wanted = {f"{topic} received": str(count) for topic, count in counts.items()}
        return self.observer.diagnostics(lambda values, _: wanted.items() <= values.items(), str(wanted), node)

    def close(self) -> None:
        """End everything; what ran must not have printed a traceback."""
        with ExitStack() as stack:
            stack.callback(self.observer.__exit__, None, None, None)
            for process in self.processes:
                stack.callback(_end, process)


def _end(process: Process) -> None:
    process.end()
    assert "Traceback" not in process.output, process.output


@contextmanager
def staged(folder: Path) -> Iterator[Stage]:
    """A stage in a free domain, cleared in the end."""
    with free_domain() as domain:
        stage = Stage(domain, folder)
        try:
            yield stage
        finally:
            stage.close()
