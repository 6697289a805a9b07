"""Diagnostics: one status per link, one for the stream, one scalar per key (REP 107)."""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from geomid_ros.estimation.estimate import Estimate, LinkEstimate
from geomid_ros.estimation.estimator import QUANTITIES
from geomid_ros.ros.worker import Status


def diagnostic_array(node: str, status: Status) -> DiagnosticArray:
    """The state of the stream and of every link."""
    array = DiagnosticArray(status=[_stream(node, status)])
    if status.estimate is not None:
        array.status += [_link(node, link) for link in status.estimate.links]
    return array


def _status(name: str, level: bytes, message: str, values: Mapping[str, object]) -> DiagnosticStatus:
    pairs = [KeyValue(key=key, value=_text(value)) for key, value in values.items()]
    return DiagnosticStatus(name=name, hardware_id="geomid", level=level, message=message, values=pairs)


def _text(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _link(node: str, link: LinkEstimate) -> DiagnosticStatus:
    values: dict[str, object] = {
        "mass": link.mass,
        "mass std": link.std_mass,
        **{f"com {axis}": float(value) for axis, value in zip("xyz", link.com, strict=True)},
        **{f"com {axis} std": float(value) for axis, value in zip("xyz", link.std_com, strict=True)},
        "from data": link.from_data,
        "distance from prior": link.distance_from_prior,
        "min eigenvalue ratio": link.min_eigenvalue_ratio,
        "merged": ", ".join(link.merged),
        "cannot be told": ", ".join(link.cannot_tell),
    }
    if len(link.cannot_tell) == len(QUANTITIES):
        return _status(f"{node}: {link.name}", DiagnosticStatus.WARN, "no quantity can be told by itself", values)
    return _status(f"{node}: {link.name}", DiagnosticStatus.OK, f"mass {link.mass:.3f} kg", values)


def _stream(node: str, status: Status) -> DiagnosticStatus:
    values: dict[str, object] = {
        "active": status.active,
        "rows": status.rows,
        "lag": status.lag,
        "queue": status.queue,
    }
    for topic, ledger in status.ledgers.items():
        values |= {f"{topic} received": ledger.received, f"{topic} accepted": ledger.accepted}
        values |= {f"{topic} rejected: {reason}": count for reason, count in ledger.rejected.items()}
    values |= {f"dropped: {reason}": count for reason, count in status.dropped.items()}
    values |= {f"rows rejected: {reason}": count for reason, count in status.rows_rejected.items()}
    level, message = _judgement(status)
    if status.estimate is not None:
        values |= _solve(status.estimate)
    return _status(f"{node}: stream", level, message, values)


def _solve(estimate: Estimate) -> dict[str, object]:
    values: dict[str, object] = {
        "converged": estimate.converged,
        "solve seconds": estimate.seconds,
        "gamma": estimate.gamma,
    }
    for name, sigma, rms in zip(estimate.channels, estimate.sigmas, estimate.rms, strict=True):
        values |= {f"{name} sigma": float(sigma), f"{name} rms": float(rms)}
    return values


def _judgement(status: Status) -> tuple[bytes, str]:
    if status.problem:
        return DiagnosticStatus.ERROR, status.problem
    if not status.active:
        return DiagnosticStatus.OK, "stopped"
    if not status.ledgers:
        return DiagnosticStatus.WARN, "no messages yet"
    refused = {
        f"{topic}: {reason}": count for topic, ledger in status.ledgers.items() for reason, count in ledger.rejected.items()
    }
    refused |= {f"dropped: {reason}": count for reason, count in status.dropped.items()}
    if refused:
        worst = max(refused, key=lambda reason: refused[reason])
        return DiagnosticStatus.WARN, f"{worst} ({refused[worst]} messages)"
    if status.estimate is None:
        return DiagnosticStatus.OK, "collecting rows"
    if not status.estimate.converged:
        return DiagnosticStatus.WARN, status.estimate.reason
    return DiagnosticStatus.OK, f"{status.rows} rows"
