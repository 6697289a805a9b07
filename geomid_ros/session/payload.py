"""What a robot carries, from a recording without it and one with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate, interval_of_positive
from geomid_ros.estimation.estimator import estimate
from geomid_ros.estimation.identifier import Identifier
from geomid_ros.estimation.starting_point import USUAL_SPREAD_OF_LINKS
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.samples import Samples
from geomid_ros.plausibility.hypotheses import Finding
from geomid_ros.plausibility.verdict import Verdict, recording_verdict
from geomid_ros.session.configuration import GAIN, Configuration
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

_SPREAD = 3.0  # a geodesic distance: a payload may weigh a tenth or ten times of what is usual
_MASS = 0.2  # of the mean link's
_SIZE = 0.1  # [m] radius of gyration about a plane through its centre


@dataclass(frozen=True, kw_only=True, eq=False)
class WeighedPayload:
    """A payload in the axes of the ``link`` that carries it, about this link's origin.

    Attributes:
        link: the moving link.
        quantities: mass, centre of mass and inertia ``(10,)``, see
            :func:`~geomid_ros.geometry.pseudo_inertia.quantities_of`.
        std: their standard deviations ``(10,)``, with the efforts' gain in those of mass and inertia.
        gain: the standard deviation of the gain that was taken.
        cannot_tell: the quantities that the motions do not tell.
        rms: what remains on both recordings by channel [N m, N].
        warnings: what makes the result doubtful.
        notes: what is worth knowing beside.
        findings: what seems to be wrong with the recordings as a whole.
        verdict: whether the result can be used.
    """

    link: str
    quantities: FloatArray
    std: FloatArray
    gain: float
    cannot_tell: tuple[str, ...]
    rms: dict[str, float]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    findings: tuple[Finding, ...]
    verdict: Verdict

    @property
    def mass(self) -> float:
        """[kg]."""
        return float(self.quantities[0])

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the mass [kg], along the geodesic: of its logarithm."""
        return interval_of_positive(self.mass, float(self.std[0]))


def payload_session(urdf: str, configuration: Configuration, source: str) -> Session:
    """A session without what imitates a payload: springs, and friction in proportion to the load, are not looked for.

    Raises:
        InputError: the description and the configuration do not fit together.
    """
    return Session(urdf, configuration.with_values({"candidates": []}), source)


def weigh(
    session: Session, empty: Sequence[Samples], loaded: Sequence[Samples], link: str, gain: float = GAIN
) -> WeighedPayload:
    """Fit both recordings together: the same links and effects, and one body more in the second one.

    Args:
        session: the robot.
        empty: samples without the payload.
        loaded: samples with it.
        link: the moving link that carries it.
        gain: standard deviation of the efforts' common gain, relative: gain and mass are one to one.

    Raises:
        InputError: the link is not identified, or nothing was measured.
    """
    model = session.model
    if link not in model.body_names:
        raise InputError(f"link '{link}' cannot carry a payload: the links that are identified are {model.body_names}")
    carrying = model.with_carried(link)
    first = 10 * len(model.identified)
    settings = session.configuration.estimator([channel.name for channel in model.channels])
    identifier = Identifier(carrying, settings, session.configuration.buffer)
    for samples in empty:
        identifier.add(samples, slice(first, first + 10))
    for samples in loaded:
        identifier.add(samples)
    prior = np.full(carrying.dimension, np.nan)
    prior[first : first + 10] = _usual(model.nominal_inertias.reshape(-1, 10), model.body_names.index(link))
    spreads = np.append(np.full(len(model.identified), USUAL_SPREAD_OF_LINKS), _SPREAD)
    found = estimate(carrying, identifier.snapshot(), settings, prior, spreads=spreads)
    return _payload(link, found, gain, session)


def _payload(link: str, found: Estimate, gain: float, session: Session) -> WeighedPayload:
    body = found.links[-1]
    quantities = pseudo_inertia.quantities_of(body.parameters)
    std = np.concatenate([[body.std_mass], body.std_com, pseudo_inertia.inertia_entries(body.std_inertia)])
    scaled = np.array([1.0, *np.zeros(3), *np.ones(6)], dtype=bool)
    std = np.where(scaled, np.hypot(std, gain * quantities), std)
    return WeighedPayload(
        link=link,
        quantities=quantities,
        std=std,
        gain=gain,
        cannot_tell=body.cannot_tell,
        rms=dict(zip(found.channels, found.rms.tolist(), strict=True)),
        warnings=tuple(session.warnings()),
        notes=tuple(session.notes),
        findings=session.findings,
        verdict=recording_verdict(session.findings, "" if found.converged else found.reason),
    )


def _usual(links: FloatArray, carrier: int) -> FloatArray:
    """Parameters ``(10,)`` of the ball that a payload usually is, at the centre of the link that carries it."""
    mass = _MASS * float(np.mean(links[:, 0]))
    second = 2.0 * mass * _SIZE**2 * np.eye(3)
    return pseudo_inertia.assemble(np.array(mass), links[carrier, 1:4] / links[carrier, 0], second)
