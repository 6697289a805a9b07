"""What may be said of an analysis: how sure each name is, and whether anything is left without one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from geomid_ros.gap import candidates as library
from geomid_ros.gap.candidates import RICHER, Candidate
from geomid_ros.gap.evidence.curves import depends_on, is_curve
from geomid_ros.gap.judgement import naming
from geomid_ros.gap.judgement.crossvalidation import generalises
from geomid_ros.gap.judgement.held_out import HeldOut
from geomid_ros.gap.judgement.locate import strongest
from geomid_ros.gap.result import Confidence, Finding, Quantity, Ranked, Rival, Unexplained, Verdict
from geomid_ros.gap.search.analysis import Analysis
from geomid_ros.gap.search.score_test import improvement
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import BoolArray, FloatArray

CONFIDENT_LOSS = 20.0
CONFIDENT_BESIDE_UNEXPLAINED = 200.0
"""Where something is left that has no name, small names may be its shadow."""
CONFIDENT_IN_THE_SHADE = 100.0
"""Of a name whose share of the gap is small because another one's is so large."""
CONFIDENT_RIVAL = 12.0
CONFIDENT_SHARE = 0.03
BESIDE_A_GEAR = 0.25
"""Of the loss of an elastic gear or a backlash: smaller names may be what the first order leaves of it."""
_GEARS = ("joint_elasticity", "backlash")
DOMINANT_LOSS = 200.0
DOMINANT_SHARE = 0.3
"""A name of the whole robot is sure in spite of what it leaves only if it matters so much more."""
CERTAIN = 100.0
"""Prior inertias of such a certainty were identified, not guessed."""
LEAST_RISE = 1.05
"""Without a name that is sure, the remainder of some channel is so many times larger; payloads apart."""
LEAST_PREDICTED = 0.5
"""Share of the gap of unseen data that a sure name closes where something is left."""
ALIKE_ONE_WAY: Mapping[str, str] = {
    "effort_offset": "coulomb_friction",
    "coulomb_friction": "effort_offset",
    "stribeck_friction": "effort_offset",
}
"""Names that differ only at a joint that moves to and fro."""
LEAST_OTHER_WAY = 0.05
_SURE_OF_MASS = 3.0  # standard deviations
REACHED = 1.15
"""A channel whose remainder is below this times the floor has reached it."""


def findings(model: MeasurementModel, analysis: Analysis, unseen: HeldOut) -> tuple[Finding, ...]:
    """The names, the one that matters most first, judged on what was fitted and on ``unseen`` data."""
    found = [_finding(model, analysis, c, unseen) for c in analysis.whole.chosen if not is_curve(c)]
    return tuple(sorted(found, key=lambda finding: -finding.loss))


def _finding(model: MeasurementModel, analysis: Analysis, candidate: Candidate, unseen: HeldOut) -> Finding:
    whole, search = analysis.whole, analysis.search
    loss = search.without(whole, candidate).score - whole.score
    rivals = _rivals(model, analysis, candidate)
    share = _share(analysis, candidate)
    separability = improvement(search.design, search.without(whole, candidate), candidate)[1]
    joint = naming.place_name(model, candidate)
    close = [(rival.effect, rival.joint) for rival in rivals if rival.loss < CONFIDENT_RIVAL]
    load = float(np.std(analysis.stage.situation.load[:, candidate.joint])) if candidate.scanned else 0.0
    parameters = naming.parameters(model, whole, candidate, _scanned_std(analysis, candidate), load)
    confidence = _confidence(analysis, candidate, joint, loss, rivals, share, unseen)
    if confidence == "confident" and candidate.payload >= 0 and _may_weigh_nothing(parameters["mass"]):
        confidence = "tentative"
    link = naming.link_name(model, candidate)
    return Finding(
        candidate.effect,
        joint,
        link,
        parameters,
        confidence,
        tuple(rival for rival in rivals if rival.loss < loss),
        float(np.clip(separability, 0.0, 1.0)),
        loss,
        share,
        naming.sentence(candidate.effect, joint, link, parameters, confidence),
        naming.settled_by(candidate.effect, joint, close) if confidence != "confident" else "",
    )


def _may_weigh_nothing(mass: Quantity) -> bool:
    return not mass.value > _SURE_OF_MASS * mass.std


def _scanned_std(analysis: Analysis, candidate: Candidate) -> float:
    """Standard deviation of the logarithm of a scanned constant, from the curvature of the score over its neighbours; 1
    where that says nothing, 0 for a name without one."""
    if not candidate.scanned:
        return 0.0
    search, whole = analysis.search, analysis.whole
    around = search.neighbours(candidate)
    if len(around) < 2:
        return 1.0
    scanned = [around[0], candidate, around[1]]
    rest = [c for c in whole.chosen if c is not candidate]
    logs = np.log([c.scanned for c in scanned])
    scores = [search.fit([*rest, c], whole).score for c in scanned]
    curvature = 2.0 * float(np.polyfit(logs - logs[1], scores, 2)[0])  # the score is minus twice a log likelihood
    step = 0.5 * float(logs[2] - logs[0])
    return min(1.0, float(np.sqrt(2.0 / curvature + step**2 / 12.0))) if curvature > 0.0 else 1.0


def _rivals(model: MeasurementModel, analysis: Analysis, candidate: Candidate) -> list[Rival]:
    whole = analysis.whole
    found = []
    for rival in analysis.search.rivals(whole, candidate):
        other = next(c for c in rival.chosen if c not in whole.chosen)
        found.append(Rival(other.effect, naming.place_name(model, other), rival.score - whole.score))
    if alike := ALIKE_ONE_WAY.get(candidate.effect):
        joint = naming.place_name(model, candidate)
        if _moves_one_way(analysis, candidate.joint):
            found = [rival for rival in found if (rival.effect, rival.joint) != (alike, joint)]
            found.append(Rival(alike, joint, 0.0))
    return sorted(found, key=lambda rival: rival.loss)


def _moves_one_way(analysis: Analysis, joint: int) -> bool:
    """Whether a joint hardly ever moves to the other side at the instants that are used."""
    stage = analysis.stage
    signs = stage.records.samples.effects[stage.valid[:, joint], joint, library.SIGN]
    return float(min(np.mean(signs > 0.0), np.mean(signs < 0.0))) < LEAST_OTHER_WAY


def _confidence(
    analysis: Analysis,
    candidate: Candidate,
    joint: str,
    loss: float,
    rivals: Sequence[Rival],
    share: float,
    unseen: HeldOut,
) -> Confidence:
    richer = RICHER.get(candidate.effect), joint  # fits as well by nature, but better only where it is needed
    left = candidate.joint >= 0 and bool(_is_open(unseen)[candidate.joint])
    others = [rival for rival in rivals if (rival.effect, rival.joint) != richer or rival.loss < 0.0 or left]
    if any(rival.loss < CONFIDENT_RIVAL for rival in others) or _only_prior(analysis, candidate):
        return "ambiguous"
    curves = _curves(analysis, unseen)
    instead = analysis.search.instead(analysis.whole, candidate)
    margin = min([loss, *(rival.loss for rival in others)])
    if instead is not None:
        margin = min(margin, instead.score - analysis.whole.score)
    beside = any(candidate.joint == curve.joint or depends_on(curve) == joint for curve in curves)
    sure = not (curves or np.any(_is_open(unseen))) and _is_judged(analysis, candidate, unseen)
    if candidate.joint < 0 and not sure:
        beside = margin < DOMINANT_LOSS or share < DOMINANT_SHARE
    weak = loss < (CONFIDENT_LOSS if sure else CONFIDENT_BESIDE_UNEXPLAINED) or margin < CONFIDENT_RIVAL
    weak |= loss < BESIDE_A_GEAR * _largest_gear_loss(analysis, candidate)
    small = candidate.payload < 0 and _rise(analysis, candidate) < LEAST_RISE
    if weak or small or beside or (share < CONFIDENT_SHARE and not (sure and loss > CONFIDENT_IN_THE_SHADE)):
        return "tentative"
    # Where the floor is reached the score can be trusted; else it takes errors of the model for noise.
    general = sure or (
        generalises(analysis.search.design, analysis.whole, candidate) and _predicts(analysis, candidate, unseen)
    )
    return "confident" if general else "tentative"


def _is_judged(analysis: Analysis, candidate: Candidate, unseen: HeldOut) -> bool:
    """Whether there are unseen data of a channel that a name reaches."""
    return bool(np.any(unseen.counts[analysis.search.design.reached(candidate)] > 0.0))


def _largest_gear_loss(analysis: Analysis, candidate: Candidate) -> float:
    """Of the other names, those of gears that give, which are known to first order only; 0 if there are none."""
    gears = [c for c in analysis.whole.chosen if c.effect in _GEARS and c is not candidate]
    losses = [analysis.search.without(analysis.whole, gear).score - analysis.whole.score for gear in gears]
    return max(losses, default=0.0)


def _predicts(analysis: Analysis, candidate: Candidate, unseen: HeldOut) -> bool:
    """Whether a name closes enough of the gap of unseen data, over the channels that it reaches."""
    reached = analysis.search.design.reached(candidate)
    without = unseen.times_floor(analysis.search.without(analysis.names, candidate))[reached]
    after, expected = unseen.gap.after[reached], unseen.gap.expected[reached]
    closed, gap = np.nansum(without**2 - after**2), np.nansum(np.maximum(without**2 - expected**2, 0.0))
    return bool(closed > LEAST_PREDICTED * gap)


def _only_prior(analysis: Analysis, candidate: Candidate) -> bool:
    """Whether a payload is preferred to wrong inertias only by how likely the latter were thought, where that is a
    guess: without it the inertias reach the same remainder."""
    guessed = not _is_identified(analysis)
    return candidate.payload >= 0 and guessed and _rise(analysis, candidate) < LEAST_RISE


def _is_identified(analysis: Analysis) -> bool:
    """Whether the inertias were identified before, not guessed."""
    return analysis.search.prior.certainty >= CERTAIN


def _squares_without(analysis: Analysis, candidate: Candidate) -> FloatArray:
    """Sums of squares ``(C,)`` without a name. Without a payload on an identified robot the inertias are those that are
    known: fitted ones would take its place."""
    whole = analysis.whole
    if candidate.payload < 0 or not _is_identified(analysis):
        return analysis.search.without(whole, candidate).squares
    known = whole.point.parameters.copy()
    known[whole.manifold.inertial] = 0.0
    known[: len(analysis.search.prior.inertias)] = analysis.search.prior.inertias
    vector = np.append(known, -1.0)
    squares: FloatArray = np.einsum("cij,i,j->c", whole.products, vector, vector)
    return squares


def _share(analysis: Analysis, candidate: Candidate) -> float:
    """Of the gap that the inertias leave, above the floor, over the channels that it reaches: how much it closes beside
    the other names."""
    reached = analysis.search.design.reached(candidate)
    without = _squares_without(analysis, candidate)
    before = analysis.bare.squares
    closed = np.sum(((without - analysis.whole.squares) / analysis.whole.squares)[reached])
    gap = np.sum((np.maximum(before, without) / analysis.whole.squares - 1.0)[reached])
    return float(np.clip(closed / max(float(gap), 1e-300), 0.0, 1.0))


def _rise(analysis: Analysis, candidate: Candidate) -> float:
    """Factor by which the remainder of the channel that is concerned most grows without the name."""
    without = analysis.search.without(analysis.whole, candidate)
    return float(np.sqrt(np.max(without.squares / analysis.whole.squares)))


def unexplained(model: MeasurementModel, analysis: Analysis, unseen: HeldOut) -> tuple[Unexplained, ...]:
    """What free curves explain and no name does, and the channels whose gap on unseen data stays open."""
    found = {}
    for curve in _curves(analysis, unseen):
        joint, variable = model.channels[curve.joint].name, depends_on(curve)
        found[joint, variable] = Unexplained(joint, variable, float(unseen.gap.after[curve.joint]))
    said = {joint for joint, _ in found}
    for place in np.flatnonzero(_is_open(unseen)):
        joint = model.channels[place].name
        if joint not in said:
            variable = strongest(unseen.located[place])
            found[joint, variable] = Unexplained(joint, variable, float(unseen.gap.after[place]))
    return tuple(found.values())


def verdict(analysis: Analysis, unseen: HeldOut) -> Verdict:
    """Of the whole run."""
    if _curves(analysis, unseen):
        return "unexplained"
    if np.any(_is_open(unseen)):
        return "incomplete"
    return "named" if analysis.names.chosen else "no gap"


def _curves(analysis: Analysis, unseen: HeldOut) -> list[Candidate]:
    """The free curves for which unseen data leave room."""
    room = _is_above(unseen, 1.0)
    return [c for c in analysis.whole.chosen if is_curve(c) and room[c.joint]]


def _is_open(unseen: HeldOut) -> BoolArray:
    """The channels ``(C,)`` whose gap on unseen data is larger than noise and the uncertainty of all that was fitted
    explain."""
    return _is_above(unseen, REACHED)


def _is_above(unseen: HeldOut, times: float) -> BoolArray:
    # A standard deviation from n values is itself uncertain by 1 / sqrt(2 n), relative.
    reached = times * (1.0 + 2.0 / np.sqrt(2.0 * np.maximum(unseen.counts, 1.0))) * unseen.gap.expected
    above: BoolArray = np.nan_to_num(unseen.gap.after) >= np.nan_to_num(reached, nan=np.inf)
    return above


def ranking(model: MeasurementModel, analysis: Analysis) -> tuple[Ranked, ...]:
    """Chosen names by what they are worth, then the others by what the score test says of them."""
    whole, search = analysis.whole, analysis.search
    names = [c for c in whole.chosen if not is_curve(c)]
    chosen = [
        Ranked(
            c.effect,
            naming.place_name(model, c),
            search.without(whole, c).score - whole.score,
            improvement(search.design, search.without(whole, c), c)[1],
            True,
        )
        for c in names
    ]
    others = [
        Ranked(t.candidate.effect, naming.place_name(model, t.candidate), t.gain, t.separability, False)
        for t in search.ranked(whole)
        if np.isfinite(t.gain)
    ]
    return tuple(sorted(chosen, key=lambda r: -r.gain) + others[:20])
