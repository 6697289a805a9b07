"""What a session's results are as files: ``estimate.json``, the robot description, the posterior."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from geomid_ros.checks.verdict import Verdict
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.files.disk import write_json, write_text
from geomid_ros.files.models.estimate_file import account_entry, estimate_document, verdict_entry
from geomid_ros.files.models.posterior import POSTERIOR, write_posterior
from geomid_ros.files.models.readers import URDF
from geomid_ros.files.models.urdf import with_effects, with_inertials
from geomid_ros.files.models.written_model import WrittenModel, handover_entry, written_model
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray


def installed_version() -> str:
    """The version that is installed here."""
    try:
        return version("geomid_ros")
    except PackageNotFoundError:
        return "not installed"


def document(
    session: Session, estimate: Estimate, held_out: FloatArray | None = None, verdict: Verdict | None = None
) -> dict[str, Any]:
    """The document of ``estimate.json``.

    Args:
        session: that found it.
        estimate: what was found.
        held_out: RMS residual of each channel on held-out data ``(channels,)``, if there are any.
        verdict: whether it can be used; that of the session's review unless given.
    """
    review, effects = session.review, session.loaded.effects
    rejected = dict(session.identifier.rows_rejected)
    judged = verdict or review.verdict(estimate)
    merged = {link.name: link.merged for link in estimate.links}
    return estimate_document(estimate, rejected, held_out, effects) | {
        "robot": session.robot.name,
        "verdict": verdict_entry(judged, review.findings),
        "warnings": review.warnings(estimate, judged),
        "notes": session.notes,
        "messages": {topic: account_entry(account) for topic, account in session.pipeline.ledger.topics.items()},
        "gravity": session.configuration.gravity.tolist(),
        "handover": {
            reader: handover_entry(written_model(session.model, estimate, reader, effects), merged)
            for reader in estimate.within
        },
    }


def identified_urdf(session: Session, estimate: Estimate) -> str:
    """The robot description with the inertias and friction that were fitted for a URDF; every other character of it
    is kept."""
    written = written_model(session.model, estimate, URDF, session.loaded.effects)
    return with_effects(with_inertias_of(session, estimate, written), written.effects)


def with_inertias_of(session: Session, estimate: Estimate, written: WrittenModel) -> str:
    """The robot description with the inertias of a written model of an estimate, and its friction as it was."""
    merged = [name for link in estimate.links for name in link.merged]
    return with_inertials(session.urdf, written.inertias, merged)


def save(
    session: Session,
    folder: Path,
    estimate: Estimate,
    held_out: FloatArray | None = None,
    verdict: Verdict | None = None,
) -> list[Path]:
    """Write ``estimate.json``, see :func:`document`, ``identified.urdf`` and ``posterior.npz`` into a folder.

    Returns their paths.
    """
    of_estimate, description = folder / "estimate.json", folder / "identified.urdf"
    write_text(description, identified_urdf(session, estimate))
    posterior = write_posterior(folder / POSTERIOR, estimate.posterior)
    write_json(of_estimate, document(session, estimate, held_out, verdict))
    return [of_estimate, description, *posterior]
