"""Keys of the diagnostics, read off the code that makes them for a status in which everything has happened."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from geomid_ros.estimation.estimate import Estimate, LinkEstimate, LinksInformation, Predictor
from geomid_ros.estimation.posterior import Posterior
from geomid_ros.gap.result import GapResult
from geomid_ros.live.saving import Checkpoints, CheckpointStatus
from geomid_ros.live.searches import FoundGap, SearchStatus
from geomid_ros.live.status import Status
from geomid_ros.monitoring.change_detection import ChannelGap
from geomid_ros.monitoring.payload_watch import CarriedPayload
from geomid_ros.ros.diagnostics import Diagnostics
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.signals.ledger import Account

_NODE = "geomid"
_ROBOT = Path(__file__).parents[2] / "bags/arm3.urdf"

# Capitals stand for what differs from robot to robot.
_MEANINGS = {
    "stream": {
        "active": "true if data are used (`~/start`, `~/stop`)",
        "lag": "delay of the rows behind the data, due to the filter [s]",
        "queue": "waiting messages",
        "receipt to row p50 [ms]": "median time from receipt of the last message of a row to the row",
        "receipt to row p99 [ms]": "99th percentile of the same",
        "receipt to row max [ms]": "maximum of the same, over the last 10,000 instants",
        "solves": "number of estimates so far",
        "rows": "rows used by the estimate, one for each measured channel and instant",
        "rows made": "rows of all channels at all instants: used and rejected",
        "rows rejected: REASON": "rows not used: `standing still`, `not measured`, `payload carried`, "
        "`wrench doubtful: TOPIC` or `wrench changed: TOPIC`; the last three may remove earlier rows",
        "TOPIC received": "processed messages: accepted + rejected + dropped",
        "TOPIC accepted": "messages used",
        "TOPIC rejected: REASON": "messages rejected for their content",
        "TOPIC dropped: REASON": "messages not used because of the node's state: stopped, or no robot yet",
        "TOPIC noted: REMARK": "messages with a peculiarity, used or not",
        "TOPIC lost": "messages published but not received",
        "failed: WHAT": "handled exceptions",
        "gap CHANNEL": "residual of the last seconds, in units of the noise floor",
        "converged": "true if the last solve converged",
        "solve seconds": "time of the last solve [s]",
        "gamma": "weight of the prior",
        "CHANNEL sigma": "standard deviation of the noise assumed in the estimate [N m, N]",
        "CHANNEL rms": "root mean square of the residuals [N m, N]",
    },
    "gap finding": {
        "verdict": "`no gap`, `named`, `incomplete` or `unexplained`",
        "finding 1": "an effect with its place and size, as a sentence; then `finding 2` ...",
        "unexplained JOINT": "remaining residual, and what it depends on",
        "CHANNEL before": "gap without the findings, in units of the noise floor",
        "CHANNEL after": "gap with the findings",
    },
    "payload": {
        "link": "link that carries it; the status is there while something is carried that was picked up",
        "mass": "its mass [kg]",
        "mass from": "lower end of the 95 % interval of the mass, the uncertain effort gain included [kg]",
        "mass to": "upper end",
        "com x": "centre of mass in the link's frame [m]; `com y`, `com z`",
    },
    "checkpoints": {
        "beginning": "checkpoint that the node resumed from, or why it did not",
        "written": "number of checkpoints so far",
        "rows": "rows in the last checkpoint",
        "seconds": "time to write the last one [s]",
    },
    "LINK": {
        "mass": "mass of the link and everything fixed to it [kg]",
        "mass std": "standard deviation of the mass [kg]",
        "com x": "centre of mass in the link's frame [m]; `com y`, `com z`",
        "com x std": "standard deviation of the centre of mass [m]; `com y std`, `com z std`",
        "from data": "share of the prior variance that the data removed, 0 to 1",
        "distance from prior": "geodesic distance; 0.1 is about 10 % in one direction",
        "min eigenvalue ratio": "smallest eigenvalue relative to the prior; 0 is the boundary of physical consistency",
        "merged": "links fixed to it, included in its numbers",
        "not identifiable": "quantities that are not identified: 95 % intervals beyond 20 %, or mostly the prior",
    },
}
_SAID_WITH_X = {f"com {axis}{what}" for axis in "yz" for what in ("", " std")}


def rows() -> Iterator[tuple[str, str, str]]:
    """Status, key and meaning. Raises KeyError for a key without meaning, or a meaning without key."""
    array = Diagnostics(_NODE).array(_everything(), SearchStatus("", result=FoundGap(_search_result())), _checkpoints())
    for status in array.status:
        name = status.name.removeprefix(f"{_NODE}: ")
        keys = [pair.key for pair in status.values if pair.key not in _SAID_WITH_X]
        unused = _MEANINGS[name].keys() - set(keys)
        if unused:
            raise KeyError(f"diagnostics of {name} have no {', '.join(sorted(unused))}")
        for key in keys:
            yield name, key, _MEANINGS[name][key]


def _everything() -> Status:
    once = Counter({"REASON": 1})
    return Status(
        active=True,
        topics=("TOPIC",),
        failures=Counter({"WHAT": 1}),
        rows_rejected=once,
        receipt_to_row=(1e-3,),
        accounts={"TOPIC": Account(1, once, once, Counter({"REMARK": 1}), 1)},
        gaps=(ChannelGap("CHANNEL", 1.0, None, 0),),
        estimate=_estimate(),
        payload=CarriedPayload("LINK", slice(10), np.ones(10), np.eye(10), 0, 0, 0),
    )


def _estimate() -> Estimate:
    one = np.ones(1)
    link = LinkEstimate(
        name="LINK",
        merged=(),
        parameters=np.ones(10),
        std=np.zeros(10),
        distance_from_prior=0.0,
        from_data=0.0,
        min_eigenvalue_ratio=1.0,
        cannot_tell=(),
        moments=(),
        std_doubted=np.zeros(13),
        std_prior=np.zeros(13),
        outlier=False,
    )
    return Estimate(
        converged=True,
        reason="",
        seconds=0.0,
        steps=1,
        gamma=0.0,
        rows_accepted=1,
        rows_set_aside=0,
        links=(link,),
        effects=(),
        parameters=np.ones(10),
        predictor=Predictor(np.ones(10), one),
        channels=("CHANNEL",),
        sigmas=one,
        prior_stds=one,
        rms_nominal=one,
        rms=one,
        information=LinksInformation(np.eye(10), np.zeros(10)),
        posterior=Posterior(
            links=("LINK",),
            merged=((),),
            effects=(),
            parameters=np.ones(10),
            covariance=np.eye(10),
            scales=np.zeros(0),
            prior=np.ones(10),
            prior_stds=np.ones(10),
        ),
        rows=np.eye(10),
        targets=np.zeros(10),
    )


def _search_result() -> GapResult:
    """As much of a result as diagnostics look at."""
    finding = SimpleNamespace(sentence="")
    left = SimpleNamespace(joint="JOINT", gap=1.0, depends_on="velocity")
    gap = SimpleNamespace(before=np.ones(1), after=np.ones(1))
    result: Any = SimpleNamespace(
        verdict="named", findings=(finding,), unexplained=(left,), channels=("CHANNEL",), gap=gap
    )
    return cast("GapResult", result)


def _checkpoints() -> CheckpointStatus:
    session = Session(_ROBOT.read_text(encoding="utf-8"), Configuration(), str(_ROBOT))
    with tempfile.TemporaryDirectory() as folder:
        checkpoints = Checkpoints(session, Path(folder) / "checkpoints", 60.0)
        try:
            return checkpoints.status
        finally:
            checkpoints.close()
