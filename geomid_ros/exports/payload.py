"""Inertias to export: sums and differences of bodies in one frame, and identified payloads."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from geomid_ros.checks.verdict import USABLE
from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import QUANTITIES, STDS_OF_95, UncertainInertia
from geomid_ros.estimation.posterior import Posterior
from geomid_ros.exports.formats import CONTROLLERS, Export
from geomid_ros.exports.model import ExportModel
from geomid_ros.files.models.estimate_file import verdict_entry
from geomid_ros.files.models.posterior import RTOL
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.inference.prior import GAIN
from geomid_ros.model.samples import Samples
from geomid_ros.session.payload import WeighedPayload, identify_payload
from geomid_ros.session.session import LIGHT, Session
from geomid_ros.types import FloatArray

_AS_INDEPENDENT = "± counts both estimates' errors as independent: too large if one started from the other"


class Summand(NamedTuple):
    """Body in a sum: the homogeneous ``placement (4, 4)`` of its frame in the frame of the sum; ``sign`` is -1 to
    subtract it, else 1."""

    inertial: UncertainInertia
    placement: FloatArray
    sign: float


def attached(model: ExportModel, frame: str) -> Export:
    """Sum all links at and after the link ``frame``, in its axes.

    Raises InputError if none of them has a mass, if one is merged into a link before ``frame``, or if the data do not
    identify them.
    """
    model.check_link(frame, "frame")
    return _sum_of(model, model.tree.subtree(frame), frame)


def sum_of_links(model: ExportModel, links: Sequence[str], frame: str) -> Export:
    """Sum the given links in the axes of the link ``frame``. Raises InputError as :func:`attached` does."""
    model.check_link(frame, "frame")
    for link in links:
        model.check_link(link, "link")
        if link not in model.bodies:
            holders = [name for name, body in model.bodies.items() if link in body.merged]
            reason = f"it is merged into '{holders[0]}'" if holders else "it has no mass"
            raise InputError(f"{model.source}: link '{link}' is not a separate body: {reason}")
    return _sum_of(model, list(dict.fromkeys(links)), frame)


def difference(model: ExportModel, reference: ExportModel, frame: str) -> Export:
    """Subtract ``reference`` from ``model`` in the axes of the link ``frame``, which both have.

    The subtraction covers everything that moves with the link that supports the frame: a tool may have been identified
    as one body with the wrist. Raises InputError as :func:`attached` does, and if the difference is no physical body.
    """
    minuend, subtrahend = _moving_with(model, frame), _moving_with(reference, frame)
    _check_identified(model, minuend)
    terms = [*_terms(model, minuend, frame), *_terms(reference, subtrahend, frame, -1.0)]
    title = f"{model.source} without {reference.source}"
    try:
        inertial = total(terms, f"what {model.source} has more than {reference.source} at '{frame}'")
    except InputError as error:
        raise InputError(
            f"{error}. The difference may be smaller than the errors of both estimates; identify the tool as a "
            f"separate body with {_weighing(reference, frame)}, or mount a wrench sensor before it"
        ) from error
    notes = (
        *_joints_at_zero(model, minuend, frame),
        *_exact(model, minuend, inertial),
        *_exact(reference, subtrahend, inertial),
        *([_AS_INDEPENDENT] if any(reference.bodies[link].has_std for link in subtrahend) else []),
        *_other_differences(model, reference, frame),
    )
    return Export(f"payload at '{frame}': {title}", frame, inertial, notes)


def each_link(model: ExportModel) -> list[Export]:
    """Return the links of a model, each in its axes: the identified ones, or all of a URDF. Raises InputError for a
    physically impossible link."""
    exports = []
    for name in model.estimated or model.bodies:
        body = model.bodies[name]
        if not pseudo_inertia.is_body(body.parameters):
            raise InputError(
                f"{model.source}: link '{name}': {_not_physical(body.parameters)}; correct its <inertial>, or compute "
                "it from the link's shapes ('geomid prior URDF --mass KG'); 'geomid identify' repairs it itself"
            )
        inertial = total([Summand(body, np.eye(4), 1.0)], f"{model.source}: link '{name}'")
        exports.append(Export(f"link '{name}'", name, inertial, _link_notes(model, body)))
    return exports


def _link_notes(model: ExportModel, body: UncertainInertia) -> tuple[str, ...]:
    notes = []
    if merged := [link for link in body.merged if link not in model.bodies]:
        notes.append(f"includes {', '.join(merged)}, whose own inertial is removed")
    if math.isfinite(body.from_data):
        notes.append(f"{100.0 * body.from_data:.0f} % from data")
    if body.cannot_tell:
        notes.append(f"hardly identified by the data, mostly as in the prior: {', '.join(body.cannot_tell)}")
    return tuple(notes)


def _sum_of(model: ExportModel, links: Sequence[str], frame: str) -> Export:
    massive = _bodies(model, links)
    if not massive:
        raise InputError(
            f"{model.source}: nothing at or after '{frame}' has a mass. What is attached there may be merged into a "
            "link before it: give a model without it (--without)"
        )
    _check_identified(model, massive)
    inertial = total(_terms(model, massive, frame), f"{model.source}: {', '.join(massive)} together")
    parts = ", ".join(f"{link} ({model.bodies[link].mass:.4g} kg)" for link in massive)
    unidentified = [
        f"hardly identified by the data of {link}, mostly as in the prior: {', '.join(quantities)}"
        for link in massive
        if (quantities := model.bodies[link].cannot_tell)
    ]
    notes = (*_joints_at_zero(model, massive, frame), *_exact(model, massive, inertial), *unidentified)
    return Export(f"payload at '{frame}': {parts}", frame, inertial, notes)


def _carrier(model: ExportModel, frame: str) -> str:
    """Return the moving link (or the root) that the link ``frame`` is fixed to."""
    return next((joint.child for joint in model.tree.joints_above(frame) if joint.type != "fixed"), model.tree.root)


def _moving_with(model: ExportModel, frame: str) -> list[str]:
    """Return the links with a mass that move with the link supporting ``frame``; check that no body is split."""
    model.check_link(frame, "frame")
    return _bodies(model, model.tree.subtree(_carrier(model, frame)))


def _terms(model: ExportModel, links: Sequence[str], frame: str, sign: float = 1.0) -> list[Summand]:
    return [Summand(model.bodies[link], model.placement(link, frame), sign) for link in links]


def _bodies(model: ExportModel, links: Sequence[str]) -> list[str]:
    """Return the links with a mass among these; refuse to split a body."""
    for name, body in model.bodies.items():
        inside = [link for link in body.merged if link in links]
        if inside and name not in links:
            raise InputError(
                f"{model.source}: '{name}' was identified as one body with {', '.join(inside)}; they are not "
                "separately identifiable. Give an estimate or a URDF of the robot without what is attached "
                f"(--without), or '{name}' itself (--links)"
            )
    return [link for link in links if link in model.bodies]


def _check_identified(model: ExportModel, links: Sequence[str]) -> None:
    masses = {link: model.bodies[link].mass for link in links}
    unidentified = {link: names for link in links if (names := _unidentified_weight(model.bodies[link]))}
    # Gravity is compensated by mass and centre of mass.
    if sum(masses[link] for link in unidentified) > LIGHT * sum(masses.values()):
        quantities = "; ".join(f"{', '.join(names)} of '{link}'" for link, names in unidentified.items())
        raise InputError(
            f"{model.source}: the data hardly identify {quantities}; these are mostly as in the prior. Record a "
            "motion that turns the flange into all directions, or weigh what it carries (identify --known). The "
            "numbers as they are: export identified.urdf"
        )


def _unidentified_weight(body: UncertainInertia) -> list[str]:
    """Return the quantities that gravity acts on and that the data do not identify."""
    return [name for name in body.cannot_tell or () if name == "mass" or name.startswith("com")]


def _joints_at_zero(model: ExportModel, links: Sequence[str], frame: str) -> list[str]:
    """Note the moving joints between a frame and links, because their positions change where the links are."""
    above_frame = set(model.tree.joints_above(frame))
    between = [joint for link in links for joint in model.tree.joints_above(link) if joint not in above_frame]
    moving = dict.fromkeys(joint.name for joint in between if joint.type != "fixed")
    return [f"with these joints at zero: {', '.join(moving)}"] if moving else []


def _exact(model: ExportModel, links: Sequence[str], inertial: UncertainInertia) -> list[str]:
    """Note the links that count as exact in the sum ``inertial``."""
    names = [link for link in links if not model.bodies[link].has_std]
    return [f"taken as exact: {', '.join(names)} of {model.source}"] if names and inertial.has_std else []


def _other_differences(model: ExportModel, reference: ExportModel, frame: str) -> list[str]:
    """Note links elsewhere that differ: they may contain part of the payload."""
    carried = model.tree.subtree(_carrier(model, frame))
    both = model.bodies.keys() & reference.bodies.keys()
    common = [link for link in model.tree.links if link in both and link not in carried]
    differing = [link for link in common if not _same(model.bodies[link], reference.bodies[link])]
    if not differing:
        return []
    advice = f"identify it with {_weighing(reference, frame)}"
    return [f"{', '.join(differing)} differ, too, and may contain a part of the payload: {advice}"]


def _weighing(reference: ExportModel, frame: str) -> str:
    """Return the command that identifies a payload as a separate body."""
    empty = reference.source if reference.estimated else "EMPTY_BAG"
    return f"'geomid payload {empty} LOADED_BAG --frame {frame}'"


def _same(one: UncertainInertia, other: UncertainInertia) -> bool:
    return bool(np.allclose(one.quantities, other.quantities, rtol=RTOL, atol=RTOL * one.mass))


def total(terms: Sequence[Summand], what: str) -> UncertainInertia:
    """Sum bodies. Raises InputError that begins with ``what`` if the sum is no physical body.

    Standard deviations are propagated one by one, by differences of plus and minus one standard deviation. Files do not
    have the correlations of a body's quantities, so they are treated as independent. Unknown ones add nothing, unless
    all are unknown.
    """
    given = np.array([term.inertial.quantities for term in terms]).reshape(-1, 10)
    parameters = _sum(terms, given)
    if not pseudo_inertia.is_body(parameters):
        raise InputError(f"{what}: {_not_physical(parameters)}")
    deviations = np.array([term.inertial.std for term in terms])
    variance = np.full(10, 0.0 if np.any(np.isfinite(deviations)) else np.nan)
    for index in np.argwhere(np.isfinite(deviations)):
        step = np.zeros(given.shape)
        step[*index] = deviations[*index]
        above, below = (pseudo_inertia.quantities_of(_sum(terms, given + sign * step)) for sign in (1.0, -1.0))
        variance += (0.5 * (above - below)) ** 2
    return UncertainInertia(parameters=parameters, std=np.sqrt(variance))


def _sum(terms: Sequence[Summand], quantities: FloatArray) -> FloatArray:
    """Parameters ``(10,)`` of the sum of bodies with ``quantities (bodies, 10)``."""
    pseudo = np.zeros((4, 4))
    for term, body in zip(terms, pseudo_inertia.from_parameters(pseudo_inertia.parameters_of(quantities)), strict=True):
        pseudo += term.sign * term.placement @ body @ term.placement.T
    return pseudo_inertia.to_parameters(pseudo)


def _not_physical(parameters: FloatArray) -> str:
    if parameters[0] <= 0.0:
        return f"its mass is {parameters[0]:.4g} kg; it must be positive"
    moments = np.linalg.eigvalsh(pseudo_inertia.central_inertia(parameters))
    numbers = ", ".join(f"{moment:.3g}" for moment in moments)
    return (
        f"its mass is {parameters[0]:.4g} kg, but its principal moments of inertia, {numbers} kg m^2, are not "
        "physically consistent: each must be less than the sum of the two others"
    )


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
        """Mass with its interval and its link, after the first moment if the motions identify only that; only the end
        of the interval if nothing is identified."""
        low, high = self.interval
        if self.weighed.nothing_identified:
            return f"no load is identified at '{self.frame}': less than {high:.2g} kg (95 %)"
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
            "summary": self.sentence,
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
    placed = Summand(weighed, session.robot.fixed_placement(link, frame or link), 1.0)
    return Payload(frame=frame or link, weighed=weighed, inertial=total([placed], f"the payload at '{frame or link}'"))
