"""What is done with every bag and every robot of a fleet, and what each is kept under."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

from geomid_ros.fleet.recordings import FleetBag
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Topics
from geomid_ros.session.version import installed_version

_FORMAT = 1  # of what is kept


@dataclass(frozen=True, kw_only=True)
class FleetPlan:
    """What all bags have in common.

    Attributes:
        description: text of the URDF.
        source: where it is from.
        given: parameters of the configuration by full name.
        topics: that bags are read from.
        hold_out: share of each bag's time, at the end, to judge on; None for the usual one.
        version: of this package.
    """

    description: str
    source: str
    given: dict[str, Any]
    topics: Topics
    hold_out: float | None = None
    version: str = field(default_factory=installed_version)

    @property
    def configuration(self) -> Configuration:
        """Of the sessions."""
        return Configuration(self.given, "options")

    @property
    def document(self) -> dict[str, Any]:
        """As JSON."""
        return asdict(self)

    @staticmethod
    def of(document: dict[str, Any]) -> FleetPlan:
        """From a :attr:`document`."""
        return FleetPlan(**document | {"topics": Topics(**document["topics"])})

    @property
    def name(self) -> str:
        """What it is kept under."""
        return f"plan-{_checksum(self.document)}"

    def of_bag(self, bag: FleetBag) -> str:
        """What the summary of a bag is kept under."""
        return f"bag-{_checksum([self.document, bag.url, bag.fingerprint])}"

    def of_robot(self, robot: str, bags: Iterable[str]) -> str:
        """What the results of a robot are kept under, whose bags are kept under these names."""
        return f"robot-{_checksum([self.document, robot, sorted(bags)])}"


def _checksum(content: Any) -> str:
    text = json.dumps([_FORMAT, content], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]
