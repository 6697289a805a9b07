"""Usability of a result: converged, from a recording that is what it is declared to be, better than the URDF."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomid_ros.checks.candidates import MASS_FACTOR
from geomid_ros.checks.causes import RecordingFault
from geomid_ros.checks.unexplained import WORSE
from geomid_ros.estimation.estimate import STDS_OF_95, Estimate, Predictor
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.inference.design import BLOCKS
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

USABLE, NOT_CONVERGED, DOUBTFUL = "usable", "not converged", "doubtful"
STATUS = {USABLE: 0, NOT_CONVERGED: 3, DOUBTFUL: 4}
"""Exit status of each verdict; 2 is that of a refusal."""

HEAVIER = 2.0
"""Largest plausible factor between the mass of a whole robot and that in its URDF."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Usability of a result.

    Attributes:
        word: one of :data:`STATUS`.
        reasons: why it cannot be used, in sentences, the most important first.
        warnings: notes on a usable result.
        explains_all: True if whatever else is strange about the result follows from the reasons, and is left out.
    """

    word: str
    reasons: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    explains_all: bool = False

    @property
    def status(self) -> int:
        """Exit status."""
        return STATUS[self.word]

    @property
    def remarks(self) -> list[str]:
        """The reasons, each with the verdict before it."""
        return [f"{self.word.upper()}: {reason}" for reason in self.reasons]


def verdict(
    estimate: Estimate,
    findings: Sequence[RecordingFault],
    model: MeasurementModel,
    degraded_channels: Sequence[str] = (),
    unmeasured: Sequence[str] = (),
    effort_faults: Sequence[str] = (),
    doubts: Sequence[str] = (),
) -> Verdict:
    """Evaluate a result.

    Args:
        estimate: the result.
        findings: what seems to be wrong with the recording.
        model: that was fitted.
        degraded_channels: the channels that it predicts worse than the URDF does, see :func:`worse_channels`.
        unmeasured: the joints whose efforts are missing.
        effort_faults: peculiarities of the messages, in sentences.
        doubts: further reasons not to use it, in sentences.
    """
    warnings = [
        f"'{channel}' is predicted worse than by the URDF: the motion is not informative enough there, or an effect "
        "is missing in the model"
        for channel in degraded_channels
    ]
    warnings += effort_faults
    if unmeasured:
        warnings.append(f"most of the time no effort is measured at {', '.join(map(repr, unmeasured))}: it is left out")
    stopped = "" if estimate.converged else estimate.reason
    judged = recording_verdict(findings, stopped, warnings)
    beyond = (*implausible_mass(estimate, model), *doubts)
    return replace(judged, word=DOUBTFUL, reasons=(*judged.reasons, *beyond)) if beyond else judged


def recording_verdict(
    findings: Sequence[RecordingFault], stop_reason: str = "", warnings: Sequence[str] = ()
) -> Verdict:
    """Evaluate the result of a recording.

    Args:
        findings: what seems to be wrong with it.
        stop_reason: why the solver stopped before it converged; empty if it converged.
        warnings: further notes.
    """
    reasons = [finding.sentence for finding in findings]
    if stop_reason:
        reasons.append(f"the solver did not converge: {stop_reason}")
    word = DOUBTFUL if findings else NOT_CONVERGED if stop_reason else USABLE
    return Verdict(word=word, reasons=tuple(reasons), warnings=tuple(warnings))


def implausible_mass(estimate: Estimate, model: MeasurementModel) -> Iterator[str]:
    """Yield a sentence if the links' total mass is implausible; not if something was weighed, or a sensor supports
    them."""
    mass, nominal = sum(link.mass for link in estimate.links), float(np.sum(model.nominal_inertias[::10]))
    weighed = bool(estimate.known) or (model.robot.floating_base and model.legs is None)
    if not weighed and not nominal / HEAVIER <= mass <= nominal * HEAVIER:
        yield (
            f"the total link mass is {mass:.3g} kg instead of the URDF's {nominal:.3g} kg: masses are not identifiable "
            "from this motion, or they absorb an unmodelled effect, or the recording is of another robot; "
            "weigh the robot or a part of it (--known)"
        )


def poorly_predicted(estimate: Estimate, held_out: FloatArray) -> list[str]:
    """Sentence on channels where held-out data are predicted far worse than fitted ones, if any.

    Args:
        estimate: the result.
        held_out: its residual RMS on held-out data ``(channels,)``, NaN where nothing is measured.
    """
    ratios = held_out / np.maximum(estimate.rms, np.finfo(float).tiny)
    worse = [f"'{estimate.channels[c]}' ({ratios[c]:.0f} times)" for c in np.flatnonzero(ratios > MASS_FACTOR)]
    sentence = (
        f"held-out data are predicted far worse than training data: {', '.join(worse)}; the robot moves differently "
        "there, or something changed. If nothing changed, fit all data (--hold-out 0, or one more bag), and validate "
        "on another recording (--validate)"
    )
    return [sentence] if worse else []


def worse_on_rows(estimate: Estimate) -> list[str]:
    """Channels that an estimate explains worse than the URDF does, on the rows to which it was fitted."""
    pairs = zip(estimate.channels, estimate.rms, estimate.rms_nominal, strict=True)
    return [channel for channel, rms, nominal in pairs if rms > WORSE * nominal]


def worse_channels(model: MeasurementModel, batches: Sequence[Samples], identified: Predictor) -> list[str]:
    """Channels that an estimate predicts worse than the URDF does, beyond the scatter of blocks of time.

    Args:
        model: of the robot.
        batches: samples to evaluate on, at least one.
        identified: the estimate.
    """
    both = identified.beside(model.described_parameters)
    measured, predicted = model.predict(Samples.concatenate(list(batches)), *both)
    errors = ((predicted - measured[:, :, None]) ** 2).transpose(1, 2, 0)
    return [channel.name for channel, each in zip(model.channels, errors, strict=True) if is_worse(*_block_means(each))]


def _block_means(errors: FloatArray) -> FloatArray:
    """Means ``(k, blocks)`` of k errors ``(k, N)`` in blocks of the instants at which they are known: a leg's joints
    are measured only while it is in the air."""
    blocks = np.array_split(errors[:, np.isfinite(errors).all(axis=0)], BLOCKS, axis=1)
    return np.array([np.mean(block, axis=1) for block in blocks if block.size]).reshape(-1, len(errors)).T


def worse_in_folds(model: MeasurementModel, rows: RowSummary, identified: Predictor) -> list[str]:
    """Channels that an estimate predicts worse than the URDF on rows, beyond the scatter of the rows' folds."""
    scaled = rows.with_drive_gains(identified.drive_gains, len(model.nominal_inertias))
    errors = scaled.rms_by_fold(identified.parameters), rows.rms_by_fold(model.described_parameters)
    triples = zip(model.channels, *(rms.T**2 for rms in errors), strict=True)
    return [channel.name for channel, after, before in triples if is_worse(after, before)]


def is_worse(after: FloatArray, before: FloatArray) -> bool:
    """True if mean squared errors in blocks ``(blocks,)`` are larger than those ``before``, beyond their scatter."""
    finite = np.isfinite(after) & np.isfinite(before)
    rise = after[finite] - before[finite]
    if len(rise) < BLOCKS // 2 or not np.mean(after[finite]) > WORSE**2 * np.mean(before[finite]):
        return False
    return bool(np.mean(rise) > STDS_OF_95 * np.std(rise, ddof=1) / np.sqrt(len(rise)))
