"""A rig without processes: the worker, its ledger and its diagnostics, for what is not about how messages travel."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Any

from files.recordings import Recorded

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.live.status import Failures, Listener
from geomid_ros.live.threads import Received
from geomid_ros.live.worker import Worker
from geomid_ros.ros.diagnostics import Diagnostics
from geomid_ros.session.session import document

from .rig import NOTHING, SOLVE_PERIOD, Rig, Twin
from .waiting import PATIENCE, final_estimate


class Direct(Rig):
    """The same worker, ledger and diagnostics without processes and ROS's threads, for what is not about these."""

    def __init__(self, **parameters: Any) -> None:
        self.node: Any = SimpleNamespace(running=True, output="")
        self.name = "geomid"
        self.twin, self.session = Twin(**parameters), Twin(**parameters).session
        self.sent = Counter()
        self.arrays = []
        self._cases = self.told_at = 0
        self._diagnostics = Diagnostics(self.name)
        self.worker = Worker(self.session, SOLVE_PERIOD, Listener(), Failures())

    def send(self, items: Iterable[Recorded], _: float = 0.0) -> None:
        """Let messages be taken."""
        for item in items:
            self.worker.enqueue([Received(*item.raw, time.perf_counter())])
            self.sent[item.topic] += 1

    def trigger(self, service: str) -> tuple[bool, str]:
        """Reset it: there is no other service."""
        assert service == "reset"
        self.worker.reset()
        return True, "all rows discarded"

    def wait_for(self, look: Callable[[], Any], what: str) -> Any:
        """What ``look`` finds, as diagnostics are made."""
        end = time.monotonic() + PATIENCE
        while not (found := look()):
            assert time.monotonic() < end, f"waited in vain for {what}"
            time.sleep(0.02)
            self.arrays.append(self._diagnostics.array(self.worker.status(active=True)))
        return found

    def published(self) -> Any:
        """The estimate as it would be written."""
        return self._up_to_date()

    def saved(self) -> Any:
        """The same as it is now; None where there are no rows."""
        estimate = final_estimate(self.worker)
        if isinstance(estimate, Estimate):
            return document(self.session, estimate)
        assert str(estimate) == NOTHING
        return None

    def close(self) -> None:
        """End it."""
        self.worker.close()
