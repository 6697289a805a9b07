"""Payload identification, from a recording with the payload, and a recording or an earlier estimate without it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import compress

import numpy as np

from geomid_ros.checks.causes import Cause, RecordingFault
from geomid_ros.checks.verdict import DOUBTFUL, Verdict, is_worse, recording_verdict
from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import (
    QUANTITIES,
    STDS_OF_95,
    Estimate,
    UncertainInertia,
    identified,
    quantities_and_moments,
)
from geomid_ros.estimation.estimator import WarmStart, estimate
from geomid_ros.estimation.identifier import Identifier
from geomid_ros.estimation.posterior import Posterior, beyond_prior
from geomid_ros.estimation.starting_point import DEFAULT_PRIOR_STD
from geomid_ros.estimation.summary import RowSummary
from geomid_ros.estimation.tolerances import ROUNDING_OF_PRODUCTS
from geomid_ros.estimation.uncertainty import information_inverse_root
from geomid_ros.files.models.posterior import places_in
from geomid_ros.geometry.spd import SIZE
from geomid_ros.inference.prior import GAIN, PAYLOAD_PRIOR_STD, default_payload
from geomid_ros.model.channels import Channel
from geomid_ros.model.samples import Samples
from geomid_ros.model.weighed_masses import WeighedRows
from geomid_ros.monitoring.change_detection import ALARM, ChangeDetector
from geomid_ros.monitoring.payload_watch import PayloadWatch
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class WeighedPayload(UncertainInertia):
    """A payload in the axes of the ``link`` that carries it, about this link's origin.

    Attributes:
        link: the moving link.
        std: standard deviations ``(10,)``, including the uncertain gain of the efforts.
        moment, moment_std: mass times centre of mass ``(3,)`` [kg m], and standard deviations: identified by gravity
            even if the mass is not.
        gain: relative standard deviation of the effort gain that was assumed.
        std_of_data: standard deviation of the mass [kg] by the data alone, without the payload's prior.
        identified_moments: axes along which the first moment is identified.
        rms: RMS residual on both recordings by channel [N m, N].
        warnings: reasons to suspect the result.
        notes: further remarks.
        findings: suspected faults of the recordings as a whole.
        verdict: verdict on the result.
    """

    link: str
    cannot_tell: tuple[str, ...]
    moment: FloatArray
    moment_std: FloatArray
    gain: float
    std_of_data: float
    identified_moments: tuple[str, ...]
    rms: dict[str, float]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    findings: tuple[RecordingFault, ...]
    verdict: Verdict

    @property
    def only_moment_identified(self) -> bool:
        """True if the motions identify mass times centre of mass, but not the mass."""
        return bool(self.identified_moments) and "mass" in self.cannot_tell

    @property
    def nothing_identified(self) -> bool:
        """True if the data alone allow a payload of no mass, and identify no first moment."""
        zero_is_possible = self.mass <= STDS_OF_95 * self.std_of_data
        return zero_is_possible and "mass" in self.cannot_tell and not self.identified_moments

    @property
    def mass_interval(self) -> tuple[float, float]:
        """95 % interval of the mass [kg]. If nothing is identified it begins at zero and ends where the data end it: a
        Gaussian of the logarithm at a tiny mass is only the prior's."""
        largest = self.mass + STDS_OF_95 * self.std_of_data
        return (0.0, largest) if self.nothing_identified else super().mass_interval


def payload_session(urdf: str, configuration: Configuration, source: str) -> Session:
    """Create a session without candidate effects, as springs and load-dependent friction imitate a payload.

    Raises:
        InputError: the description and the configuration do not fit together.
    """
    return Session(urdf, configuration.with_values({"candidates": []}), source)


def change_detector(session: Session, pace: int = 1) -> ChangeDetector:
    """Create a detector that sees one instance of each effect only, of candidates that of the middle of their grid. All
    instances together would fit the change, and take long to learn. ``pace``: see :class:`PayloadWatch`."""
    model = session.model
    columns = [*range(len(model.nominal_inertias)), *model.usual_shapes.values()]
    channels = [replace(c, columns=np.intersect1d(c.columns, columns)) for c in model.channels]
    forgetting_time = session.configuration.buffer.forgetting_time
    return ChangeDetector(channels, forgetting_time, payload_watch(session, channels, pace))


def payload_watch(session: Session, channels: Sequence[Channel], pace: int = 1) -> PayloadWatch | None:
    """Create a watch for a payload at the flange, in rows of these ``channels``; None if the base moves, or if the link
    is not identified."""
    model, configuration = session.model, session.configuration
    frame = configuration["payload.frame"]
    link = session.robot.carrier(frame) if frame else model.body_names[-1]
    if session.robot.floating_base or link not in model.body_names:
        return None
    index = model.body_names.index(link)
    typical = default_payload(model.nominal_inertias.reshape(-1, SIZE), index)
    columns = slice(SIZE * index, SIZE * (index + 1))
    return PayloadWatch(
        channels,
        link,
        columns,
        len(model.nominal_inertias),
        prior_mean=typical,
        prior_std=PAYLOAD_PRIOR_STD,
        gain=configuration["payload.gain"],
        threshold=ALARM,
        pace=pace,
    )


def identify_payload(
    session: Session, empty: Sequence[Samples] | Posterior, loaded: Sequence[Samples], link: str, gain: float = GAIN
) -> WeighedPayload:
    """Fit the links and effects of the robot, and one additional body in the recording with the payload.

    Args:
        session: the robot.
        empty: samples without the payload, or the posterior of an earlier estimate of the robot without it.
        loaded: samples with the payload.
        link: the moving link that carries it.
        gain: relative standard deviation of the gain of the efforts, of each joint or of all together.

    Raises:
        InputError: the link is not identified, or nothing was measured.
    """
    model = session.model
    if link not in model.body_names:
        raise InputError(f"link '{link}' cannot carry a payload: the links that are identified are {model.body_names}")
    carrying = model.with_payload(link)
    first = 10 * len(model.identified)
    payload = slice(first, first + 10)
    settings = session.configuration.estimator([channel.name for channel in model.channels])

    def summarised(not_of_empty: slice, not_of_loaded: slice) -> RowSummary:
        identifier = Identifier(carrying, settings, session.configuration.buffer)
        for samples in () if isinstance(empty, Posterior) else empty:
            identifier.add(samples, not_of_empty)
        for samples in loaded:
            identifier.add(samples, not_of_loaded)
        return identifier.snapshot()

    prior, known = np.full(carrying.dimension, np.nan), None
    prior[payload] = default_payload(model.nominal_inertias.reshape(-1, 10), model.body_names.index(link))
    if isinstance(empty, Posterior):
        order, (rows, targets) = places_in(empty, carrying), empty.evidence
        prior = np.where(order >= 0, empty.prior[order], prior)
        known = WeighedRows(np.where(order >= 0, rows[:, order], 0.0), targets)
    prior_stds = np.append(np.full(len(model.identified), DEFAULT_PRIOR_STD), PAYLOAD_PRIOR_STD)
    summary = summarised(payload, slice(0))
    solve = partial(estimate, carrying, settings=settings, prior=prior, prior_stds=prior_stds, known=known)
    fit = solve(summary)
    change = np.zeros(carrying.dimension)  # of the efforts due to the payload, by one standard deviation of their gain
    change[payload] = gain * fit.parameters[payload]
    warm = WarmStart(fit.parameters, spreads=fit.prior_stds)
    # One channel after the other. The gain of the robot's other efforts is in its links already.
    rescaled = (summary.with_added_prediction(channel, change) for channel in range(len(model.channels)) if gain > 0.0)
    result = _payload(link, fit, gain, [solve(rows, warm=warm) for rows in rescaled], session)
    if "mass" not in result.cannot_tell or isinstance(empty, Posterior):
        return result
    swapped = summarised(slice(0), payload)
    errors = (summary.rms_by_fold(fit.parameters), swapped.rms_by_fold(solve(swapped).parameters))
    rms = np.maximum(fit.rms, np.finfo(float).tiny)
    if not is_worse(*(np.nansum((each / rms) ** 2, axis=1) for each in errors)):
        return result
    sentence = (
        f"'{link}' carries less in the second recording than in the first: are the recordings without (EMPTY) "
        "and with the payload (LOADED) swapped?"
    )
    fault = RecordingFault(cause=Cause(kind="swapped", sentence=sentence, places=(link,)))
    verdict = replace(result.verdict, word=DOUBTFUL, reasons=(sentence, *result.verdict.reasons))
    return replace(result, findings=(fault, *result.findings), verdict=verdict)


def _payload(link: str, fit: Estimate, gain: float, shifted: Sequence[Estimate], session: Session) -> WeighedPayload:
    """Make the result. ``shifted``: the estimates with the uncertain gain of each channel."""
    body, posterior = fit.links[-1], fit.posterior
    mass, *moments = posterior.manifold.link(len(fit.links) - 1).start + np.arange(4)
    moment_std = np.sqrt(np.diag(posterior.parameter_covariance)[moments])
    values = quantities_and_moments(body.parameters)
    bodies = [quantities_and_moments(other.links[-1].parameters) for other in shifted]
    shifts = np.array(bodies).reshape(-1, len(values)) - values
    # Gains of the channels are independent or common, whichever is worse.
    systematic = np.maximum(np.sqrt(np.sum(shifts**2, axis=0)), np.abs(np.sum(shifts, axis=0)))
    if link == session.robot.tree.root:  # elsewhere its moments distinguish a payload from the whole robot's mass
        robot = sum(other.mass for other in fit.links[:-1])
        heavier = body.parameters + np.append(np.sqrt(2.0) * session.relative_mass_std * robot, np.zeros(9))
        systematic = np.hypot(systematic, quantities_and_moments(heavier) - values)
    deviations = np.hypot(np.append(body.std, moment_std), systematic)
    is_identified = identified(body.parameters, np.hypot(body.std_doubted, systematic), body.std_prior)
    return WeighedPayload(
        link=link,
        parameters=body.parameters,
        std=deviations[:10],
        moment=values[10:],
        moment_std=deviations[10:],
        gain=gain,
        std_of_data=_std_of_data(posterior, mass),
        cannot_tell=tuple(compress(QUANTITIES, ~is_identified[:10])),
        identified_moments=tuple(compress("xyz", is_identified[10:])),
        rms=dict(zip(fit.channels, fit.rms.tolist(), strict=True)),
        warnings=tuple(session.review.warnings()),
        notes=tuple(session.notes),
        findings=session.review.findings,
        verdict=recording_verdict(session.review.findings, "" if fit.converged else fit.reason),
    )


def _std_of_data(posterior: Posterior, mass: int) -> float:
    """Standard deviation of the mass of a link in the column ``mass`` without the prior of this link."""
    link, beyond = slice(mass, mass + SIZE), beyond_prior(posterior.covariance, posterior.prior_stds)
    weights = np.ones(len(beyond))
    weights[link] = ROUNDING_OF_PRODUCTS
    direction = posterior.prior_stds[link] * posterior.jacobian[mass, link]
    return float(np.linalg.norm(direction @ information_inverse_root(beyond.T @ beyond, weights)[link]))
