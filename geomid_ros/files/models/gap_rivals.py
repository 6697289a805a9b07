"""What a ``gap.json`` leaves open: findings that have other names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geomid_ros.errors import InputError
from geomid_ros.files.models.gap_reading import read_gap
from geomid_ros.files.models.sidecar import effect_of
from geomid_ros.gap.result import GapResult
from geomid_ros.model.effects import KnownEffect, effect_class


@dataclass(frozen=True)
class OpenFinding:
    """A finding, and its ``rivals``: effects with the names of their places."""

    finding: KnownEffect
    rivals: tuple[tuple[str, str], ...]


def is_open(result: GapResult) -> bool:
    """Whether a finding is not sure and has rivals, so that a motion may decide."""
    return any(finding.rivals and finding.settled_by for finding in result.findings)


def read_open_findings(path: Path) -> tuple[list[OpenFinding], dict[str, float]]:
    """The findings with rivals in a ``gap.json``, and the noise floor of its channels [N m, N].

    Raises InputError naming the file and what is wrong in it, or that nothing is open.
    """
    document = read_gap(path)
    found = [_open(entry, f"{path}: findings[{index}]") for index, entry in enumerate(document["findings"])]
    left = [finding for finding in found if finding.rivals]
    if not left:
        raise InputError(f"{path}: no finding has a rival, so that there is nothing to settle")
    floor = document.get("floor")
    known = floor if isinstance(floor, Mapping) else {}
    return left, {str(name): float(value) for name, value in known.items() if isinstance(value, float | int)}


def _open(entry: Any, where: str) -> OpenFinding:
    finding = effect_of(entry, where)
    rivals = entry.get("rivals", [])
    if not isinstance(rivals, list) or not all(isinstance(rival, dict) for rival in rivals):
        raise InputError(f"{where}: 'rivals' is no list of names")
    named = [(str(rival.get("effect")), str(rival.get("joint") or "")) for rival in rivals]
    for name, _ in named:
        effect_class(name)
    return OpenFinding(finding, tuple(named))
