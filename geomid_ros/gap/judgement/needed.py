"""Which names held-out data confirm: the others do not become part of the model.

The data that names are judged on have chosen among them by then: what is left of these data is a little less than it
would be of others.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geomid_ros.gap.candidates import AnyCandidate, Candidate
from geomid_ros.gap.evidence.record import Records
from geomid_ros.gap.fitting.fit import JointFit
from geomid_ros.gap.judgement.closing import without
from geomid_ros.gap.judgement.held_out import HeldOut
from geomid_ros.gap.search.analysis import Analysis, with_curves
from geomid_ros.model.measurement import MeasurementModel

_STRONG = 200.0
"""A name whose loss is larger stays unless unseen data are better without it."""
_SEEN = 0.02
"""A smaller name must lower the logarithm of a channel's mean square by so much."""


def confirmed(model: MeasurementModel, held: Records, analysis: Analysis) -> Analysis:
    """An analysis without the names that bring nothing on unseen data, the least of them first; the rest is fitted
    anew. A name that changes all columns can pass for what has no name, and then what it touches is wrong, too. One
    without which a link would be let go, which would take its place, stays; but for a payload, which the link would
    only be told to carry."""
    search, names = analysis.search, analysis.names
    unseen = HeldOut(model, held, analysis)
    refused: set[AnyCandidate] = set()
    while doubtful := [c for c in names.chosen if isinstance(c, Candidate) and c not in refused]:
        absent = {c: without(analysis, names, c) for c in doubtful}
        losses = {c: found.score - names.score for c, found in absent.items()}
        least = min(doubtful, key=losses.__getitem__)
        smaller = search.without(names, least)
        change = _worse(unseen, names, absent[least])
        replaced = least.payload is None and search.let_go(smaller) - search.let_go(names)
        if search.possible(smaller) and not replaced and change < (0.0 if losses[least] > _STRONG else _SEEN):
            names = smaller
        else:
            refused.add(least)
    names = search.without_absurd(search.simplified(names))
    if names is analysis.names:
        return analysis
    return replace(analysis, names=names, whole=with_curves(search, names))


def _worse(unseen: HeldOut, found: JointFit, smaller: JointFit) -> float:
    """By how much the logarithms of the channels' mean squares are larger for a smaller fit, in all."""
    before, after = unseen.times_floor(found), unseen.times_floor(smaller)
    judged = np.isfinite(before) & np.isfinite(after)
    return float(2.0 * np.sum(np.log(after[judged] / before[judged])))
