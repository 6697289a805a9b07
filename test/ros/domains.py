"""ROS domains that nobody else uses."""

from __future__ import annotations

import fcntl
import os
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# Above, domains' ports reach those that the system gives to clients.
DOMAINS = range(1, 100)


@contextmanager
def free_domain() -> Iterator[int]:
    """A domain without participants, locked against other tests on this machine."""
    begin = os.getpid() % len(DOMAINS)
    for domain in (*DOMAINS[begin:], *DOMAINS[:begin]):
        with (Path(tempfile.gettempdir()) / f"geomid-test-domain-{domain}").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            if _has_participants(domain):
                continue
            yield domain
            return
    raise RuntimeError("every ROS domain is in use")


def _has_participants(domain: int) -> bool:
    """Whether the port of the domain's first participant (DDSI-RTPS, 9.6.1.4) is taken."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", 7400 + 250 * domain + 10))
        except OSError:
            return True
    return False
