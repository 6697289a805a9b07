"""How unsure a size is for what else may be true."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from geomid_ros.estimation.estimate import SURE
from geomid_ros.gap.candidates import AnyCandidate, Candidate
from geomid_ros.gap.fitting.fit import JointFit
from geomid_ros.gap.judgement import naming
from geomid_ros.gap.judgement.blocks import scattered
from geomid_ros.gap.search.analysis import Analysis
from geomid_ros.gap.search.beam_search import LEAST_GAIN
from geomid_ros.model.effects import Quantity, Values, joints_of
from geomid_ros.model.measurement import MeasurementModel


def as_unsure(
    model: MeasurementModel, analysis: Analysis, candidate: Candidate, parameters: dict[str, Quantity], load: float
) -> dict[str, Quantity]:
    """Parameters that are as unsure as what else may be true of the same thing leaves them."""
    if candidate.payload is not None:
        # One to one with the efforts' gains: if these had not changed, it would be lighter or heavier by as much.
        gain = _largest_change_of_gain(analysis.names)
        return {name: _unsure_by(q, gain * q.value) if q.unit.startswith("kg") else q for name, q in parameters.items()}
    return _over(parameters, _of_richer(model, analysis, candidate, load))


def as_unsure_beside_others(
    model: MeasurementModel, analysis: Analysis, candidate: Candidate, parameters: dict[str, Quantity], load: float
) -> dict[str, Quantity]:
    """Parameters that are as unsure as what else may be true of other names at its joint leaves them, too. These leave
    another size of it: that is no doubt that there is something."""
    if candidate.payload is not None:
        return parameters
    fits = (scattered(analysis.search.design, found) for found in _as_likely(analysis, candidate))
    return _over(parameters, (naming.parameters(model, found, candidate, usual_load=load) for found in fits))


def as_unsure_beside_remainder(
    candidate: Candidate, parameters: dict[str, Quantity], was: Values, doubt: float
) -> dict[str, Quantity]:
    """Parameters that are as unsure as what has no name leaves them: the ``doubt`` is a share of what they change,
    the largest of each unit, from what they were or from nothing."""
    sizes = candidate.effect.sizes(parameters)
    changes = {name: abs(size.value - was.get(name, candidate.effect.nothing)) for name, size in sizes.items()}

    def wider(name: str) -> Quantity:
        largest = max(change for other, change in changes.items() if sizes[other].unit == sizes[name].unit)
        return _unsure_by(sizes[name], doubt * largest)

    return parameters | {name: wider(name) for name in sizes}


def may_be_as_before(candidate: Candidate, parameters: dict[str, Quantity], was: Values) -> bool:
    """Whether the 95 % intervals of all sizes hold what these were, or nothing: no sure name says so."""
    sizes, nothing = candidate.effect.sizes(parameters), candidate.effect.nothing
    return all(abs(size.value - was.get(name, nothing)) <= SURE * size.std for name, size in sizes.items())


def _over(parameters: dict[str, Quantity], others: Iterable[dict[str, Quantity]]) -> dict[str, Quantity]:
    """Parameters whose deviations reach those of other fits."""
    wider = dict(parameters)
    for other in others:
        for name in wider.keys() & other.keys():
            off = wider[name].value - other[name].value
            wider[name] = replace(wider[name], std=max(wider[name].std, float(np.hypot(off, other[name].std))))
    return wider


def _unsure_by(quantity: Quantity, std: float) -> Quantity:
    """With an independent error more."""
    return replace(quantity, std=float(np.hypot(quantity.std, std)))


def _largest_change_of_gain(names: JointFit) -> float:
    """That was found, relative; 0 without."""
    scaling = [c for c in names.chosen if isinstance(c, Candidate) and c.effect.scales_measurement]
    gains = [c.effect.transformed(np.array([names.value(c.terms[0])]))[0][0] for c in scaling]
    return max((abs(float(gain) - 1.0) for gain in gains), default=0.0)


def _of_richer(
    model: MeasurementModel, analysis: Analysis, candidate: Candidate, load: float
) -> Iterator[dict[str, Quantity]]:
    """The parameters in fits with a name that contains this one in its place. That it was not needed does not make it
    false: of Coulomb friction the level depends on how much more there is near standstill."""
    search, names = analysis.search, analysis.names
    rest = search.without(names, candidate)
    richer = [c for c in search.candidates if c.effect.contains == candidate.name and c.place == candidate.place]
    is_known = set(candidate.terms) <= set(search.prior.terms)
    for trial in search.ranked(rest, richer):  # of whichever sign: an interval has two sides
        if isinstance(own := trial.candidate, Candidate):
            found = scattered(search.design, search.fit([*rest.chosen, own], names))
            other = naming.parameters(model, found, own, usual_load=load)
            if is_known and not set(candidate.terms) <= set(own.terms):  # it comes on top of what the model has
                had = naming.parameters(model, found, candidate, usual_load=load)
                other = {name: other[name].plus(had[name]) for name in had.keys() & other.keys()}
            yield other


def _as_likely(analysis: Analysis, candidate: Candidate) -> Iterator[JointFit]:
    """Fits that are about as likely, with a rival in the place of another name at the same joint, or with a name more.
    Quadratic friction often fits as well as viscous friction, and leaves another level of Coulomb friction."""
    search, names, joints = analysis.search, analysis.names, set(joints_of(candidate.place))

    def is_near(other: AnyCandidate) -> bool:
        return isinstance(other, Candidate) and not joints.isdisjoint(joints_of(other.place))

    others = [c for c in names.chosen if c is not candidate and is_near(c)]
    instead = [found for other in others for found in search.rivals(names, other)]
    promising = [t.candidate for t in search.ranked(names) if t.gain > 0.0 and t.candidate.payload is None]
    beside = [search.fit([*names.chosen, more], names) for more in promising if is_near(more)]
    for found in (*instead, *beside):
        if search.possible(found) and found.score < names.score + LEAST_GAIN:
            yield found
