"""The gap workflow on what a live session remembers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from geomid_ros.files.models.gap_results import gap_document
from geomid_ros.files.models.judgements import causes_entry
from geomid_ros.gap.result import GapResult
from geomid_ros.plausibility.hypotheses import Finding
from geomid_ros.report.gap_words import verdict_sentence
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.gap import find_in_messages, gap_session
from geomid_ros.session.recordings import Progress
from geomid_ros.signals.messages import Accepted


@dataclass(frozen=True)
class FoundGap:
    """The ``result`` of a search, the ``causes`` that make it doubtful, and ``warnings`` beside."""

    result: GapResult
    causes: Sequence[Finding] = ()
    warnings: Sequence[str] = ()

    @property
    def sentence(self) -> str:
        """The verdict."""
        return verdict_sentence(self.result)

    @property
    def document(self) -> dict[str, Any]:
        """The document of ``gap.json``."""
        return gap_document(self.result, {}) | {"causes": causes_entry(self.causes), "warnings": [*self.warnings]}


def look_for_gap(urdf: str, configuration: Configuration, messages: Sequence[Accepted], progress: Progress) -> FoundGap:
    """Look for a gap in messages that the pipeline of another session has accepted.

    Raises:
        InputError: too little was measured.
    """
    session = gap_session(urdf, configuration, "robot_description")
    result = find_in_messages(session, messages, progress)
    return FoundGap(result, session.findings, session.warnings())
