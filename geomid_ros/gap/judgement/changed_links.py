"""Links that weigh something else than the model says."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from geomid_ros.gap.analysis import Analysis
from geomid_ros.gap.candidates import ODDS, NamesPrior
from geomid_ros.gap.result import LIKELY, LinkChange
from geomid_ros.inference.fit import fit, scattered
from geomid_ros.inference.probability import relative_doubt
from geomid_ros.model.effects import Quantity
from geomid_ros.model.effects.situation import OnLink
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray

_LEAST = 0.05  # of the mass
_HELD = 0.1  # of the usual spread: so little a link may change to be as it was


def changed_links(model: MeasurementModel, analysis: Analysis) -> tuple[LinkChange, ...]:
    """The links whose mass has changed, without payloads, the one that matters most first; and the one that explains
    best what contradicts other recordings, if its first moment has.

    A change that another link can take over, as that of a link which hardly moves alone, is none.
    """
    return tuple(sorted(_changes(model, analysis), key=lambda change: -change.loss))


def _changes(model: MeasurementModel, analysis: Analysis) -> Iterator[LinkChange]:
    names, search = analysis.names, analysis.search
    covariance = scattered(search.design, names).covariance
    nominal, stds = search.prior.inertias.reshape(-1, 10), np.sqrt(np.diag(covariance))
    prior = with_given_spreads(search.prior, names.inflation)
    free = fit(search.design, prior, names.chosen, names, names.spreads).score
    for link, was in enumerate(nominal):
        change = names.inertias[link] - was
        doubt = relative_doubt(search.design, names, link, change)
        std = np.hypot(stds[10 * link : 10 * link + 10], doubt * change)
        told, moment, centre = (change / std)[:1], {}, {}
        if abs(change[0]) < _LEAST * was[0] or link == search.prior.changed_link:
            if link != search.prior.changed_link:
                continue
            if abs(told[0]) < np.max(np.abs(change / std)[1:4]):
                told, moment = (change / std)[1:4], _first_moment(change, std)
        if search.prior.identified and not moment:
            own = slice(10 * link, 10 * link + 4)
            centre = _centre(change, covariance[own, own])
        if names.inertias[link, 0] > np.sum(nominal[:, 0]):  # as no payload outweighs the robot, no link does
            continue
        spreads = names.spreads.copy()
        spreads[link] = _HELD * search.prior.spread
        loss = fit(search.design, prior, names.chosen, names, spreads).score - free
        # The link may have changed, and not its mass.
        against = np.exp(-0.5 * min(loss, float(np.max(told**2)), 1e3)) / ODDS
        against += analysis.contested if link == search.prior.changed_link else 0.0
        probability = float(1.0 / (1.0 + against))
        if probability >= LIKELY:
            body = model.robot.bodies[model.identified[link]]
            yield LinkChange(
                link=body.name,
                joint=model.places.name(OnLink(link, model.places.mover(body.name))),
                mass=Quantity(float(change[0]), float(std[0]), "kg"),
                was=float(was[0]),
                loss=loss,
                probability=probability,
                moment=moment,
                centre=centre,
            )


def _first_moment(change: FloatArray, std: FloatArray) -> dict[str, Quantity]:
    """That of a change of parameters ``(10,)``, by axis."""
    sizes = zip("xyz", change[1:4].tolist(), std[1:4].tolist(), strict=True)
    return {f"m {axis}": Quantity(size, unsure, "kg m") for axis, size, unsure in sizes}


def _centre(change: FloatArray, covariance: FloatArray) -> dict[str, Quantity]:
    """That of the mass by which a link's parameters have a ``change (10,)``; of mass and first moment the
    ``covariance (4, 4)``."""
    centre = change[1:4] / change[0]
    derivative = np.column_stack([-centre, np.eye(3)]) / change[0]
    stds = np.sqrt(np.diag(derivative @ covariance @ derivative.T))
    return {axis: Quantity(float(value), float(std), "m") for axis, value, std in zip("xyz", centre, stds, strict=True)}


def with_given_spreads(prior: NamesPrior, inflation: float) -> NamesPrior:
    """A prior under which scores of fits with given spreads can be compared: nothing is said of the spreads, and other
    recordings are trusted as far as they were found to be right."""
    return replace(prior, certainty=0.0, known=prior.known and prior.known.trusted(inflation))
