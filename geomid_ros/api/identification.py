"""What was identified: its numbers, how well they predict, and the verdict on them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from geomid_ros.checks.verdict import DOUBTFUL, Verdict
from geomid_ros.estimation.estimate import EffectEstimate, Estimate, LinkEstimate
from geomid_ros.estimation.suggested_motions import suggested_motions
from geomid_ros.exports.handover import HandedOver, JudgedFile
from geomid_ros.files.models.effects_file import unsaid
from geomid_ros.files.models.estimate_file import model_effects
from geomid_ros.files.models.readers import ELEMENTS, URDF
from geomid_ros.model.channels import Channel
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, read_fitted
from geomid_ros.session.session import Session, document
from geomid_ros.types import FloatArray

if TYPE_CHECKING:
    from geomid_ros.resimulation.closed_loop import Tracking


@dataclass(frozen=True, kw_only=True, eq=False)
class IdentificationSummary:
    """Result of an identification.

    Attributes:
        session: the robot, its model and its configuration.
        bags: the recordings.
        estimate: result of the solver.
        held_out: the held-out samples, in batches; empty if nothing was held out.
        judged: the samples that the result is tested on: ``held_out``, or the fitted samples if that is empty.
        reader: who will read the description that is written.
        command: topic of the joints' set-points, to simulate them.
    """

    session: Session
    bags: Bags
    estimate: Estimate
    held_out: Sequence[Samples]
    judged: Sequence[Samples]
    reader: str = URDF
    command: str | None = None

    @property
    def links(self) -> tuple[LinkEstimate, ...]:
        """The links with mass, centre of mass, inertia and their standard deviations."""
        return self.estimate.links

    @property
    def effects(self) -> tuple[EffectEstimate, ...]:
        """The effects' coefficients with their standard deviations."""
        return self.estimate.effects

    @property
    def rms(self) -> dict[str, float]:
        """RMS of the estimate's residual, by channel [N m, N], on held-out data, or the fitted data if there are none.
        NaN for a channel that was not measured."""
        return self._by_channel(self.estimate.rms if self.held_out_rms is None else self.held_out_rms)

    @property
    def warnings(self) -> list[str]:
        """Warnings on the result, as sentences, in addition to the :attr:`verdict`."""
        return self.session.review.warnings(self.estimate, self.verdict)

    @cached_property
    def verdict(self) -> Verdict:
        """Verdict on the result: ``usable``, ``doubtful`` or ``not converged``, with the reasons."""
        judged = self.session.review.verdict(self.estimate, self.judged, self.held_out_rms)
        judged = replace(judged, warnings=(*judged.warnings, *self.handover.limited))
        worse = self.handover.worse
        return replace(judged, word=DOUBTFUL, reasons=(*judged.reasons, *worse)) if worse else judged

    @cached_property
    def written(self) -> HandedOver:
        """The description that is written for :attr:`reader`."""
        return HandedOver(self.session, self.estimate, self.reader)

    @cached_property
    def handover(self) -> JudgedFile:
        """How well that description predicts what is judged on, loaded again by the program that reads it.

        Raises:
            InputError: the program does not take it.
        """
        return self.written.judged(self.judged, self.rms)

    @cached_property
    def train(self) -> Sequence[Samples]:
        """The fitted samples, in batches; if others are held out, they are read from the bags again, as they are not
        kept."""
        if not self.held_out:
            return self.judged
        return read_fitted(Session(*self.same_again), self.bags)

    @cached_property
    def rms_nominal(self) -> dict[str, float]:
        """RMS of the URDF's residual, by channel [N m, N], with its inertias and no effects."""
        if not self.held_out:
            return self._by_channel(self.estimate.rms_nominal)
        return self._by_channel(self._rms_on_held_out[:, 0])

    @cached_property
    def held_out_rms(self) -> FloatArray | None:
        """RMS of the residuals on held-out data ``(channels,)``; None if nothing was held out."""
        return self._rms_on_held_out[:, 1] if self.held_out else None

    @cached_property
    def _rms_on_held_out(self) -> FloatArray:
        """Of the URDF and of the estimate ``(channels, 2)``."""
        parameters = np.column_stack([self.session.model.nominal_parameters, self.estimate.parameters])
        return self.session.rms(self.held_out, parameters)

    @cached_property
    def tracking(self) -> Tracking | None:
        """How far the robot of that description is from the measured one under the recorded commands, simulated in
        MuJoCo on what is held out; None without a :attr:`command`.

        Raises:
            InputError: MuJoCo is not installed, nothing is held out, or the topic cannot be read.
        """
        if self.command is None:
            return None
        from geomid_ros.session.written_simulation import tracking_of  # noqa: PLC0415 seldom asked for

        return tracking_of(Session(*self.same_again), self.written.model, self.bags, self.command)

    @property
    def same_again(self) -> tuple[str, Configuration, str]:
        """What another session of the same robot is made of."""
        return self.session.urdf, self.session.configuration, self.session.robot.source

    def _by_channel(self, values: FloatArray) -> dict[str, float]:
        return dict(zip(self.estimate.channels, values.tolist(), strict=True))

    @property
    def document(self) -> dict[str, Any]:
        """All numbers, as ``estimate.json`` has them, but for where they are from."""
        found = document(self.session, self.estimate, self.held_out_rms, self.verdict)
        found["handover"][self.reader] |= self.handover.entry
        if self.tracking is not None:
            found["handover"][self.reader]["tracking"] = dict(self.tracking.rms)
        model = self.session.model
        masses = model.nominal_inertias.reshape(-1, 10)[:, 0].tolist()
        return found | {
            "urdf_masses": dict(zip(model.body_names, masses, strict=True)),
            "channels": [self._channel(channel) for channel in model.channels if math.isfinite(self.rms[channel.name])],
            "telling": self._telling,
        }

    def _channel(self, channel: Channel) -> dict[str, Any]:
        """RMS of a channel's residual by the URDF, by the estimate, and by the written file."""
        return {
            "channel": channel.name,
            "unit": channel.unit,
            "judged_on": self.judged_on,
            "urdf": self.rms_nominal[channel.name],
            "identified": self.rms[channel.name],
            "file": self.handover.alone[channel.name],
            "file_with_offsets": self.handover.corrected[channel.name],
        }

    @cached_property
    def _telling(self) -> dict[str, dict[str, list[str]]]:
        """By link and motion, the quantities that it would identify."""
        return suggested_motions(self.session.model, self.estimate)

    @property
    def judged_on(self) -> str:
        """What :attr:`judged` is."""
        return "held-out data" if self.held_out else "fitted data"

    @property
    def not_written(self) -> str:
        """What the description for :attr:`reader` cannot hold, in a sentence; empty for nothing."""
        names = unsaid(model_effects(self.estimate, self.session.loaded.effects), ELEMENTS[self.reader])
        sentence = f"Not representable in {self.written.name}: {'; '.join(names)}"
        return f"{sentence}. The file is fitted without them; estimate.json has them." if names else ""

    def __repr__(self) -> str:
        """Reasons for doubt, and a line for each link."""
        state = "converged" if self.estimate.converged else f"NOT converged ({self.estimate.reason})"
        lines = [
            f"  {link.name}: {link.mass:.3f} ± {link.std_mass:.3f} kg, {100 * link.from_data:.0f} % from data"
            for link in self.links
        ]
        heading = f"Identification of {self.session.robot.name}: {self.estimate.rows_accepted} rows, {state}"
        return "\n".join([*self.verdict.remarks, heading, *lines])
