"""Tasks on a cluster of two workers in this process."""

from __future__ import annotations

import operator
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import geomid_ros
from geomid_ros.errors import InputError
from geomid_ros.fleet.fleet import Cluster, failure

distributed = pytest.importorskip("distributed")


@pytest.fixture
def local() -> Iterator[object]:
    """The cluster."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address="127.0.0.1:0"
    ) as cluster:
        yield cluster


def test_every_task_ends_once_and_a_failure_costs_itself(local: distributed.LocalCluster) -> None:
    with Cluster(local.scheduler_address) as cluster:
        found = dict(cluster.run(operator.truediv, [(place, (6, place)) for place in range(200)]))
    assert sorted(found) == list(range(200))
    assert isinstance(error := found.pop(0), ZeroDivisionError)
    assert failure(error) == "ZeroDivisionError: division by zero"
    assert all(value == 6 / place for place, value in found.items())


def test_a_script_that_its_workers_would_run_again_is_told(tmp_path: Path) -> None:
    alone = "import os\nos.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"  # a worker tells as much as many
    (tmp_path / "script.py").write_text(f"{alone}from geomid_ros.fleet.fleet import Cluster\nCluster(None)\n")
    path = {"PYTHONPATH": str(Path(geomid_ros.__file__).parents[1])}
    ended = subprocess.run(
        [sys.executable, tmp_path / "script.py"], env=os.environ | path, capture_output=True, text=True, check=False
    )
    *_, last = ended.stderr.splitlines()
    assert "InputError: the workers of this machine do not start" in last
    assert last.count("put the call under") == ended.stderr.count("Traceback") == 1


def test_ctrl_c_is_not_for_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    with Cluster(None) as cluster:
        masks = cluster._client.run(signal.pthread_sigmask, signal.SIG_BLOCK, ()).values()
    assert all(signal.SIGINT in mask for mask in masks)
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_tasks_that_a_scheduler_forgot_are_done_after_all(local: distributed.LocalCluster) -> None:
    """As when it is restarted: what was handed over is lost."""
    with Cluster(local.scheduler_address) as cluster:
        running = cluster.run(time.sleep, [(place, (0.02,)) for place in range(100)])
        done = [next(running)[0]]
        client = cluster._client
        client.cancel([distributed.Future(key, client) for key in list(client.futures)], force=True)
        done += [place for place, _ in running]
        assert cluster._client is not client
    assert sorted(done) == list(range(100))


def test_a_scheduler_that_does_not_come_back_is_told(local: distributed.LocalCluster) -> None:
    with Cluster(local.scheduler_address, patience=1.0) as cluster:
        running = cluster.run(time.sleep, [(place, (0.02,)) for place in range(100)])
        next(running)
        local.close()
        with pytest.raises(InputError, match="intermediate results are kept: run the same command again"):
            list(running)
