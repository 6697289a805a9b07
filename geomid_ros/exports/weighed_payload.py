"""Identified payload at the flange: for people, files and controllers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from geomid_ros.checks.verdict import USABLE
from geomid_ros.errors import InputError
from geomid_ros.estimation.posterior import Posterior
from geomid_ros.estimation.uncertain_inertia import QUANTITIES, STDS_OF_95, UncertainInertia
from geomid_ros.exports.formats import CONTROLLERS
from geomid_ros.exports.payload import Export, Summand, total
from geomid_ros.files.models.estimate_file import verdict_entry
from geomid_ros.inference.prior import GAIN
from geomid_ros.model.samples import Samples
from geomid_ros.session.payload import WeighedPayload, identify_payload
from geomid_ros.session.session import Session


@dataclass(frozen=True, kw_only=True, eq=False)
class Payload:
    """Identified payload in the axes and about the origin of the link ``frame``.

    Attributes:
        weighed: the payload in the axes of the moving link that supports it, with its uncertainty.
        inertial: the same in the axes of ``frame``.
    """

    frame: str
    weighed: WeighedPayload
    inertial: UncertainInertia

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        return self.inertial.mass

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the mass [kg], including the uncertainty of the effort gain."""
        return self.weighed.mass_interval

    @property
    def sentence(self) -> str:
        """Mass with its interval and its link, after the first moment if the motions identify only that."""
        low, high = self.interval
        gain = f", an uncertain gain of {100.0 * self.weighed.gain:.3g} % included" if self.weighed.gain else ""
        mass = f"{self.mass:.3f} kg, from {low:.3f} to {high:.3f} kg (95 %{gain}), at '{self.frame}'"
        if not self.weighed.only_moment_identified:
            return mass
        moments = zip("xyz", self.weighed.moment, self.weighed.moment_std, strict=True)
        listed = ", ".join(f"m {axis} {value:.4g} ± {STDS_OF_95 * std:.2g}" for axis, value, std in moments)
        return f"{listed} kg m (95 %{gain}) in '{self.weighed.link}'; these motions do not identify the mass: {mass}"

    @property
    def document(self) -> dict[str, Any]:
        """All numbers, for JSON."""
        weighed = self.weighed
        quantities, std = self.inertial.quantities.tolist(), self.inertial.std.tolist()
        return {
            "frame": self.frame,
            "interval": list(self.interval),
            "gain": weighed.gain,
            "quantities": dict(zip(QUANTITIES, quantities, strict=True)),
            "std": dict(zip(QUANTITIES, std, strict=True)),
            "moment": {
                "link": weighed.link,
                "value": weighed.moment.tolist(),
                "std": weighed.moment_std.tolist(),
                "identified": list(weighed.identified_moments),
            },
            "cannot_tell": list(weighed.cannot_tell),
            "rms": weighed.rms,
            "warnings": list(weighed.warnings),
            "notes": list(weighed.notes),
            "verdict": verdict_entry(weighed.verdict, weighed.findings),
        }

    def commands(self, controller: str) -> str:
        """Return the text that sets the payload at a controller: ``ur`` or ``franka``. Raises InputError if the payload
        is not identified, doubtful, or refused by the controller."""
        if "mass" in self.weighed.cannot_tell or self.weighed.verdict.word != USABLE:
            reasons = "; ".join(self.weighed.verdict.reasons) or "its mass is not identified"
            raise InputError(f"no commands for {controller}: {reasons}; record more motion of all joints")
        return CONTROLLERS[controller].commands(Export(f"payload at '{self.frame}'", self.frame, self.inertial))


def identify_payload_at(
    session: Session, empty: Sequence[Samples] | Posterior, loaded: Sequence[Samples], frame: str, gain: float = GAIN
) -> Payload:
    """Identify the payload at a link of the URDF.

    Args:
        session: of :func:`~geomid_ros.session.payload.payload_session`.
        empty: samples without the payload, or the posterior of an earlier estimate.
        loaded: samples with the payload.
        frame: the flange; empty for the last moving link.
        gain: see :func:`~geomid_ros.session.payload.identify_payload`.

    Raises:
        InputError: the frame is unknown or fixed to no moving link, or nothing was measured.
    """
    link = session.robot.carrier(frame) if frame else session.model.body_names[-1]
    if not frame:
        session.review.settled.append(
            f"no --frame (payload.frame) is given: the payload is identified at '{link}', the last moving link"
        )
    weighed = identify_payload(session, empty, loaded, link, gain)
    placed = Summand(weighed, session.robot.fixed_placement(link, frame or link))
    return Payload(frame=frame or link, weighed=weighed, inertial=total([placed], f"the payload at '{frame or link}'"))
