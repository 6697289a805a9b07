"""The gap workflow on what a live session remembers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from geomid_ros.checks.causes import Finding
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.files.models.estimate_file import causes_entry
from geomid_ros.files.models.gap_file import gap_document
from geomid_ros.gap.result import GapResult
from geomid_ros.options import Progress
from geomid_ros.report.gap_words import verdict_sentence
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import Accepted

COMPARED = "compared with the estimate before the gap"


@dataclass(frozen=True)
class FoundGap:
    """The ``result`` of a search, the ``causes`` that make it doubtful, ``warnings`` and ``notes`` beside, and what the
    robot was ``compared`` with, if not with its description."""

    result: GapResult
    causes: Sequence[Finding] = ()
    warnings: Sequence[str] = ()
    notes: Sequence[str] = ()
    compared: str = ""

    @property
    def sentence(self) -> str:
        """The verdict."""
        sentence = verdict_sentence(self.result)
        return f"{sentence} ({self.compared})" if self.compared else sentence

    @property
    def document(self) -> dict[str, Any]:
        """The document of ``gap.json``."""
        remarks = {"causes": causes_entry(self.causes), "warnings": [*self.warnings], "notes": [*self.notes]}
        document = gap_document(self.result, {}) | remarks
        return document | ({"compared_with": self.compared} if self.compared else {})


def look_for_gap(
    session: Session,
    before: Estimate | None,
    earlier: Sequence[Accepted],
    messages: Sequence[Accepted],
    progress: Progress,
) -> FoundGap:
    """Look for a gap in messages that the pipeline of a live session has accepted.

    Args:
        session: of the node.
        before: what it had identified before a gap opened, to which the robot is compared; None to compare it with the
            robot description and the configured model.
        earlier: messages that it is from: what it lacked there is no change.
        messages: what to look at.
        progress: called with what is being done.

    Raises:
        InputError: too little was measured.
    """
    # A third of a node's start, which few ever need.
    from geomid_ros.session.gap import (  # noqa: PLC0415
        find_in_messages,
        gap_session,
        identified_session,
        lacking_in_messages,
        standing_of,
    )

    if before is None:
        own = gap_session(session.urdf, session.configuration, "robot_description")
        result = find_in_messages(own, messages, standing_of(own), progress)
        return FoundGap(result, own.review.findings, own.review.warnings(), [*session.notes, *own.review.settled])
    own = identified_session(session, before)
    result = find_in_messages(own, messages, lacking_in_messages(own, earlier, progress), progress)
    compared = f"{COMPARED}, of {before.rows_accepted} rows"
    return FoundGap(result, own.review.findings, own.review.warnings(), session.notes, compared)
