"""Links that weigh something else than the model says."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from geomid_ros.estimation.estimate import LinksInformation
from geomid_ros.gap.fitting.fit import JointFit, fit
from geomid_ros.gap.fitting.prior import Prior
from geomid_ros.gap.judgement.blocks import scattered
from geomid_ros.gap.judgement.closing import is_identified, is_open, open_curves, part_of_remainder
from geomid_ros.gap.judgement.confidence import CONFIDENT_BESIDE_UNEXPLAINED, CONFIDENT_LOSS
from geomid_ros.gap.judgement.held_out import HeldOut
from geomid_ros.gap.result import LinkChange
from geomid_ros.gap.search.analysis import Analysis
from geomid_ros.model.effects import Quantity
from geomid_ros.model.effects.places import AtJoint
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray

_SURE = 3.0  # standard deviations
_LEAST = 0.05  # of the mass
_SAME_MASS = 1e-3  # of the mass: so little may it change to be as it was
_HELD = 0.1  # of the usual spread: so little a link may change to be as it was


def changed_links(model: MeasurementModel, analysis: Analysis, unseen: HeldOut) -> tuple[LinkChange, ...]:
    """The links whose mass has changed for sure, without payloads, the one that matters most first; and the one that
    explains best what contradicts other recordings, if its first moment has.

    A change that another link can take over, as that of a link which hardly moves alone, is none.
    """
    return tuple(sorted(_changes(model, analysis, unseen), key=lambda change: -change.loss))


def _changes(model: MeasurementModel, analysis: Analysis, unseen: HeldOut) -> Iterator[LinkChange]:
    names, search = analysis.names, analysis.search
    covariance = scattered(search.design, names).covariance
    nominal, stds = search.prior.inertias.reshape(-1, 10), np.sqrt(np.diag(covariance))
    prior = with_given_spreads(search.prior, names.inflation)
    left = bool(open_curves(analysis, unseen) or np.any(is_open(unseen)))
    for link, was in enumerate(nominal):
        change, std = names.inertias[link] - was, stds[10 * link : 10 * link + 10]
        moment: dict[str, Quantity] = {}
        if abs(change[0]) < max(_SURE * std[0], _LEAST * was[0]):
            if link != search.prior.changed_link or np.all(np.abs(change[1:4]) < _SURE * std[1:4]):
                continue
            moment = _first_moment(change, std)
        spreads = names.spreads.copy()
        spreads[link] = _HELD * search.prior.spread
        held, free = (fit(search.design, prior, names.chosen, names, each).score for each in (spreads, names.spreads))
        loss = held - free
        if loss > CONFIDENT_LOSS:
            body = model.robot.bodies[model.identified[link]]
            told = slice(1, 4) if moment else slice(1)
            sure = _is_sure(analysis, link, change[told] / std[told], loss, left)
            # Where the model is a guess the link's centre and inertia may be wrong instead.
            guessed = left and not is_identified(analysis)
            doubt = _doubt(unseen, _with_mass_as_it_was(analysis, prior, link)) if guessed else 0.0
            mass = Quantity(float(change[0]), float(np.hypot(std[0], doubt * change[0])), "kg")
            yield LinkChange(
                link=body.name,
                joint=model.places.name(AtJoint(body.joint - 1)) if body.joint > 0 else "",
                mass=mass,
                was=float(was[0]),
                loss=loss,
                confidence="confident" if sure and (moment or abs(mass.value) > _SURE * mass.std) else "tentative",
                moment=moment,
            )


def _is_sure(analysis: Analysis, link: int, times: FloatArray, loss: float, left: bool) -> bool:
    """Whether a link has changed for sure: its change is so many ``times`` the standard deviations, without it the fit
    is worse by ``loss``, and something is ``left`` without a name or nothing."""
    prior = analysis.search.prior
    # That the link has changed says nothing of its mass: its centre may have. Of realistic robots masses were off by
    # five and six of their deviations, which therefore count by half.
    of_size = 0.5 * np.max(times**2)
    if of_size <= CONFIDENT_LOSS or (left and loss <= CONFIDENT_BESIDE_UNEXPLAINED):
        return False
    if analysis.contested and link == prior.changed_link:
        return False
    # As no payload outweighs the robot, no link does: a spring, say, can pass for one that does not move.
    return bool(analysis.names.inertias[link, 0] < np.sum(prior.inertias.reshape(-1, 10)[:, 0]))


def _first_moment(change: FloatArray, std: FloatArray) -> dict[str, Quantity]:
    """That of a change of parameters ``(10,)``, by axis."""
    sizes = zip("xyz", change[1:4].tolist(), std[1:4].tolist(), strict=True)
    return {f"m {axis}": Quantity(size, unsure, "kg m") for axis, size, unsure in sizes}


def _doubt(unseen: HeldOut, as_it_was: JointFit) -> float:
    """Which share of a change of mass may be a part of what has no name."""
    return part_of_remainder(unseen, range(len(unseen.counts)), unseen.times_floor(as_it_was) ** 2)


def _with_mass_as_it_was(analysis: Analysis, prior: Prior, link: int) -> JointFit:
    """The fit of the names in which a link's mass is that of the model, a guess, while its centre and inertia may
    change."""
    row = np.zeros(len(prior.inertias))
    row[10 * link] = 1.0 / (_SAME_MASS * prior.inertias[10 * link])
    names, held = analysis.names, replace(prior, known=LinksInformation(row[None], np.zeros(1)))
    return fit(analysis.search.design, held, names.chosen, names, names.spreads)


def with_given_spreads(prior: Prior, inflation: float) -> Prior:
    """A prior under which scores of fits with given spreads can be compared: nothing is said of the spreads, and other
    recordings are trusted as far as they were found to be right."""
    known = prior.known
    if known is not None:
        known = LinksInformation(known.rows / np.sqrt(inflation), known.residuals / np.sqrt(inflation))
    return replace(prior, certainty=0.0, known=known)
