"""``python -m benchmarks.fleet``: what ``geomid fleet`` costs, and what it survives.

The sum of bags against one identifier; two local workers against two independent processes; workers killed and the
scheduler restarted in mid-run; memory of the client; and what a population is worth to a new robot.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, cast

import numpy as np

from benchmarks.report import Report
from geomid_ros.estimation.estimator import EstimatorSettings
from geomid_ros.estimation.population import RobotLikelihood, population_and_members
from geomid_ros.estimation.summary import RowSummary, SummaryState
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.fleet.fleet import Cluster
from geomid_ros.fleet.recordings import find_bags
from geomid_ros.fleet.work import FleetPlan, Store, sum_of_summaries, summarise, summarise_bag
from geomid_ros.model.channels import Channel
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, Topics
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.recording import simulate
from geomid_ros.types import FloatArray

sys.path.append(str(Path(__file__).parents[1] / "test"))  # whose simulated types are used here
_URDF = Path(__file__).parents[1] / "bags" / "arm7.urdf"
_SECONDS = 6.0  # of a short bag
_SHORT = 40
_WARM = 2  # bags before the clock starts
_MANY, _FEW = 1000, 10
_ROBOTS, _NEW = 20, 20
_KILLS = 5
_PORT = 18787
_GEOMID = (sys.executable, "-m", "geomid_ros")
_DASK = (sys.executable, "-m", "dask")
_MOST = 600.0  # [s] for a run
# A process of its own that summarises bags one after the other: says when it is warm, and waits to begin.
_ALONE = """
import sys
from geomid_ros.fleet.recordings import find_bags
from geomid_ros.fleet.work import Store, summarise_bag
store, plan, folder, first, warm = Store(sys.argv[1]), sys.argv[2], sys.argv[3], int(sys.argv[4]), int(sys.argv[5])
bags = find_bags(folder)
for bag in bags[-warm:]:
    summarise_bag(store, plan, bag)
print("warm", flush=True)
sys.stdin.readline()
for bag in bags[first:-warm:2]:
    summarise_bag(store, plan, bag)
"""


def sums(report: Report, folder: Path) -> None:
    """Bags summed from separate identifiers, in several orders, against one identifier."""
    bags = [bag.url for bag in find_bags(str(folder / "short"))][:6]
    text, configuration = read_urdf(_URDF), Configuration({}, "benchmark")

    def of(urls: list[str]) -> SummaryState:
        chosen = Bags(fitted=[Path(url) for url in urls])
        return summarise(text, str(_URDF), configuration, chosen)[1].fitted.summary

    session, _ = summarise(text, str(_URDF), configuration, Bags(fitted=[Path(bags[0])]))
    separate = [summarise(text, str(_URDF), configuration, Bags(fitted=[Path(url)]))[1] for url in bags]
    one = _products(of(bags), session.model.channels)
    orders = [separate, separate[::-1], [separate[index] for index in (3, 0, 5, 1, 4, 2)]]
    differences = [
        _difference(_products(sum_of_summaries(each).fitted.summary, session.model.channels), one) for each in orders
    ]
    among = max(
        _difference(
            _products(sum_of_summaries(each).fitted.summary, session.model.channels),
            _products(sum_of_summaries(separate).fitted.summary, session.model.channels),
        )
        for each in orders
    )
    report.say(f"six bags summed in three orders against one identifier: {max(differences):.1e} (at most 1e-10)")
    report.say(f"among the orders: {among:.1e}")
    report.result("sum of bags", max(differences))


def _products(state: SummaryState, channels: Sequence[Channel]) -> FloatArray:
    """The products of all columns, targets included, by group."""
    summary = RowSummary(channels)
    summary.restore(state)
    factors = [np.concatenate([part.factor for part in parts]) for parts in summary.parts()]
    return np.concatenate([(factor.T @ factor).ravel() for factor in factors])


def _difference(a: FloatArray, b: FloatArray) -> float:
    return float(np.max(np.abs(a - b)) / np.max(np.abs(b)))


def throughput(report: Report, folder: Path) -> None:
    """Two local workers of Dask against two processes that know nothing of each other, on the same bags."""
    plan, bags = _plan(), find_bags(str(folder / "short"))
    timed = bags[:-_WARM]
    with TemporaryDirectory() as kept:
        store = _store(kept, plan)
        with Cluster(None) as cluster:
            list(cluster.run(summarise_bag, [(bag, (store, plan.name, bag)) for bag in bags[-_WARM:]]))
            begin = time.perf_counter()
            list(cluster.run(summarise_bag, [(bag, (store, plan.name, bag)) for bag in timed]))
            together = time.perf_counter() - begin
    with TemporaryDirectory() as kept:
        _store(kept, plan)
        arguments = (kept, plan.name, str(folder / "short"))
        alone = [
            subprocess.Popen(  # noqa: S603 a command of ours
                [sys.executable, "-c", _ALONE, *arguments, str(first), str(_WARM)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            for first in range(2)
        ]
        for process in alone:
            cast("IO[str]", process.stdout).readline()
        begin = time.perf_counter()
        for process in alone:
            process.communicate("go\n")
        apart = time.perf_counter() - begin
    report.say(
        f"{len(timed)} bags of {_SECONDS:g} s: two workers {together:.1f} s, two processes {apart:.1f} s; "
        f"throughput {apart / together:.2f} of theirs (at least 0.9)"
    )
    report.result("throughput", apart / together)


def tasks(report: Report, _: Path) -> None:
    """What the scheduler takes for a task that does nothing."""
    with Cluster(None) as cluster:
        list(cluster.run(_nothing, [(index, ()) for index in range(100)]))
        begin = time.perf_counter()
        list(cluster.run(_nothing, [(index, ()) for index in range(5000)]))
        each = (time.perf_counter() - begin) / 5000
    report.say(f"a task of Dask costs {1e3 * each:.2f} ms")
    report.result("milliseconds per task", 1e3 * each)


def _nothing() -> None:
    return None


def _plan() -> FleetPlan:
    return FleetPlan(description=read_urdf(_URDF), source=str(_URDF), given={}, topics=Topics("joint_states", "odom"))


def _store(folder: str, plan: FleetPlan) -> Store:
    store = Store(folder)
    store.put(plan.name, json.dumps(plan.document).encode())
    return store


def kills(report: Report, folder: Path) -> None:
    """Workers that are killed and a scheduler that is restarted, against a run that is left alone."""
    calm, torn = folder / "calm", folder / "torn"
    for out in (calm, torn):
        shutil.rmtree(out, ignore_errors=True)
    _fleet(folder, calm).wait(_MOST)
    address = f"tcp://127.0.0.1:{_PORT}"
    with TemporaryDirectory() as scratch, _supervised(_scheduler()) as scheduler:
        workers = (*_DASK, "worker", address, "--nworkers", "2", "--nthreads", "1", "--no-dashboard")
        with _supervised((*workers, "--local-directory", scratch)):
            run = _fleet(folder, torn, "--scheduler", address)
            for kill in range(_KILLS):
                _wait_for(run, lambda count=4 * (kill + 1): _kept(torn) >= count)  # type: ignore[misc]
                _kill_a_worker(address)
            _wait_for(run, lambda: _kept(torn) >= 4 * (_KILLS + 1))
            os.kill(scheduler(), signal.SIGKILL)
            ended = run.wait(_MOST)
    names = sorted(path.name for path in calm.iterdir() if (path / "estimate.json").is_file())
    worst = max(
        abs(a["mass"] - b["mass"]) / a["mass"]
        for name in names
        for a, b in zip(_links(calm / name), _links(torn / name), strict=True)
    )
    report.say(
        f"a worker killed {_KILLS} times, the scheduler once: the run ended with {ended}, masses of {len(names)} "
        f"robots differ by {worst:.1e}"
    )
    report.result("after kills", worst)


def _fleet(folder: Path, out: Path, *more: str) -> subprocess.Popen[bytes]:
    command = [*_GEOMID, "fleet", str(folder / "short"), "--urdf", str(_URDF), "--out", str(out), *more]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL)  # noqa: S603 a command of ours


def _links(folder: Path) -> list[dict[str, float]]:
    found: list[dict[str, float]] = json.loads((folder / "estimate.json").read_text())["links"]
    return found


def _scheduler() -> tuple[str, ...]:
    return (*_DASK, "scheduler", "--host", "127.0.0.1", "--port", str(_PORT), "--no-dashboard")


@contextmanager
def _supervised(command: tuple[str, ...]) -> Iterator[Callable[[], int]]:
    """A command that is started again whenever it ends, as services are; yields a function for its process."""
    loop = (
        "import subprocess, sys, time\n"
        "while True:\n"
        "    p = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)\n"
        "    print(p.pid, flush=True)\n"
        "    p.wait()\n"
        "    time.sleep(1)\n"
    )
    supervisor = subprocess.Popen(  # noqa: S603 a command of ours
        [sys.executable, "-c", loop, *command], stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    first = int(cast("IO[str]", supervisor.stdout).readline())
    time.sleep(3)
    try:
        yield lambda: first
    finally:
        os.killpg(supervisor.pid, signal.SIGTERM)
        supervisor.wait()


def _kept(out: Path) -> int:
    return len(list((out / "kept").glob("bag-*.safetensors")))


def _wait_for(run: subprocess.Popen[bytes], reached: Callable[[], bool]) -> None:
    deadline = time.monotonic() + _MOST
    while not reached() and run.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)


def _kill_a_worker(address: str) -> None:
    from distributed import Client  # noqa: PLC0415 as in the package

    with Client(address) as client:
        client.wait_for_workers(1)
        pids = list(client.run(os.getpid).values())
    os.kill(pids[0], signal.SIGKILL)


def memory(report: Report, folder: Path) -> None:
    """The most memory that the client takes for few and for many bags."""
    peaks = {}
    for count in (_FEW, _MANY):
        bags = folder / f"copies{count}"
        if not bags.is_dir():
            for index in range(count):
                shutil.copytree(folder / "tiny" / "bag", bags / f"robot{index % 2}" / f"bag{index}")
        out = folder / f"out{count}"
        shutil.rmtree(out, ignore_errors=True)
        script = (
            "import atexit, resource, sys; from geomid_ros.commands import root; "
            "used = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss; "
            "atexit.register(lambda: print(used(), file=sys.stderr)); "
            "root(sys.argv[1:])"
        )
        begin = time.perf_counter()
        arguments = ("fleet", str(bags), "--urdf", str(_URDF), "--out", str(out))
        ended = subprocess.run(  # noqa: S603 a command of ours
            [sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True, timeout=3600
        )
        peaks[count] = int(ended.stderr.split()[-1]) / 1024
        size = sum(path.stat().st_size for path in (out / "kept").glob("bag-*.safetensors")) / count
        report.say(
            f"{count} bags: the client takes {peaks[count]:.0f} MB at most, {time.perf_counter() - begin:.0f} s; "
            f"{size / 1e6:.2f} MB are kept of a bag"
        )
    report.say(f"memory of the client: {peaks[_MANY] / peaks[_FEW]:.2f} times (at most 1.5)")
    report.result("memory", peaks[_MANY] / peaks[_FEW])


def prior(report: Report, _: Path) -> None:
    """What a population of twenty robots is worth to a new one, and what others among them do to it."""
    from estimation.fleets import NOISE, solved, typical, with_tool  # noqa: PLC0415 in test/

    kind, other = typical("arm7", 3), typical("arm7", 4)
    robots = kind.fleet(_ROBOTS)
    population, members = population_and_members(robots)
    told = sum(not member.member for member in members)
    report.say(
        f"{_ROBOTS} robots of one type: {told} taken for others; errors in units of noise, median of {_NEW} robots:"
    )
    for seconds in (1.0, 5.0):
        errors = []
        for seed in range(100, 100 + _NEW):
            case = kind.recorded(kind.robot(seed), seed, seconds)
            fresh = case.fresh(seed)
            both = (EstimatorSettings(), EstimatorSettings(population=population))
            found = [fresh.error(solved(case, settings).parameters) for settings in both]
            errors.append([np.sqrt(np.mean(error**2)) / NOISE for error in found])
        by_urdf, by_population = np.median(errors, axis=0)
        ratio = float(np.median([after / before for before, after in errors]))
        report.say(
            f"  {seconds:g} s of data: {by_urdf:.2f} beside the URDF, {by_population:.2f} beside the population, ratio "
            f"{by_population / by_urdf:.2f}, median ratio of a robot {ratio:.2f}"
        )
        report.result(f"ratio with {seconds:g} s", by_population / by_urdf)
    calm, _ = population_and_members(robots[:-1])
    tool = RobotLikelihood.of(solved(kind.recorded(with_tool(kind.robot(19), 1.0), 19, 10.0)))
    stranger = RobotLikelihood.of(solved(other.recorded(other.robot(19), 19, 10.0)))
    for what, robot in (("a tool of 1 kg left on", tool), ("a robot of another type", stranger)):
        found, members = population_and_members([*robots[:-1], robot])
        mean = calm.manifold.log(calm.point, found.point) / np.sqrt(np.diag(calm.covariance))
        spread = np.sqrt(np.diag(found.covariance) / np.diag(calm.covariance)) - 1.0
        moved = float(max(np.max(np.abs(mean)), np.max(np.abs(spread))))
        report.say(
            f"{what}: told {not members[-1].member} ({', '.join(members[-1].unlike)}), moves the prior by {moved:.1%}"
        )
        report.result(what, moved)


def _simulated(report: Report, folder: Path) -> None:
    """The bags: four robots with ten short ones each, and a tiny one."""
    options = SimulationOptions(robot="arm7", duration=_SECONDS, inertia_error=0.05)
    for index in range(_SHORT + _WARM):
        bag = folder / "short" / f"robot{index % 4}" / f"bag{index:02d}"
        if not bag.exists():
            report.progress(f"simulating {bag.name}")
            simulate(bag, replace(options, seed=index % 4, motion_seed=index))
    tiny = folder / "tiny" / "bag"
    if not tiny.exists():
        simulate(tiny, replace(options, duration=3.0))


_PARTS = {"sums": sums, "tasks": tasks, "throughput": throughput, "kills": kills, "memory": memory, "prior": prior}


def main() -> None:
    """Run all parts, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", default=list(_PARTS), help=", ".join(_PARTS))
    parser.add_argument("--out", type=Path, default=Path("out/fleet"))
    arguments = parser.parse_args()
    report = Report(arguments.out)
    _simulated(report, arguments.out)
    for part in arguments.parts:
        _PARTS[part](report, arguments.out)


if __name__ == "__main__":
    main()
