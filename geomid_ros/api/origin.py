"""Where a report is from: the program, what was run, and what was read."""

from __future__ import annotations

import hashlib
from datetime import UTC, datetime

from geomid_ros.report.identification_page import Origin
from geomid_ros.session.recordings import Bags
from geomid_ros.session.session import Session
from geomid_ros.session.version import installed_version


def origin(session: Session, bags: Bags, command: str) -> Origin:
    """Where a report on a session is from.

    Args:
        session: the robot and its configuration.
        bags: the recordings.
        command: what was run.
    """
    urdf = hashlib.sha256(session.urdf.encode(errors="replace")).hexdigest()
    recordings = [(str(path), _what(share)) for path, share in bags.shares]
    return Origin(
        version=installed_version(),
        command=command,
        date=datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC"),
        files=[(f"{session.robot.source} (SHA-256 {urdf})", "robot"), *recordings],
        configuration=session.configuration.given,
    )


def _what(share: float) -> str:
    if share >= 1.0:
        return "recording, held out"
    return "recording, fitted" + (f" except the last {100.0 * share:.0f} %" if share > 0.0 else "")
