"""What may be said of an analysis: how sure each name is, and whether anything is left without one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomid_ros.gap import naming
from geomid_ros.gap.analysis import Analysis
from geomid_ros.gap.curves import depends_on, is_curve
from geomid_ros.gap.fit import improvement
from geomid_ros.gap.library import RICHER, Candidate
from geomid_ros.gap.result import Confidence, Finding, Ranked, Rival, Unexplained, Verdict
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray

CONFIDENT_LOSS = 20.0
CONFIDENT_BESIDE_UNEXPLAINED = 200.0
"""Where something is left that has no name, small names may be its shadow."""
CONFIDENT_RIVAL = 12.0
CONFIDENT_SHARE = 0.5
LEAST_RISE = 1.05
"""Without a name that is sure, the remainder of some channel is so many times larger; payloads apart."""
REACHED = 1.15
"""A channel whose remainder is below this times the floor has reached it."""


def findings(model: MeasurementModel, analysis: Analysis) -> tuple[Finding, ...]:
    """The names, the one that matters most first."""
    found = [_finding(model, analysis, c) for c in analysis.whole.chosen if not is_curve(c)]
    return tuple(sorted(found, key=lambda finding: -finding.loss))


def _finding(model: MeasurementModel, analysis: Analysis, candidate: Candidate) -> Finding:
    whole, search = analysis.whole, analysis.search
    loss = search.without(whole, candidate).score - whole.score
    rivals = _rivals(model, analysis, candidate)
    share = _share(analysis, candidate)
    separability = improvement(search.design, search.without(whole, candidate), candidate)[1]
    joint = naming.place_name(model, candidate)
    confidence = _confidence(analysis, candidate, joint, loss, rivals, share)
    parameters = naming.parameters(model, whole, candidate)
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
        naming.settled_by(candidate.effect) if confidence != "confident" else "",
    )


def _rivals(model: MeasurementModel, analysis: Analysis, candidate: Candidate) -> list[Rival]:
    whole = analysis.whole
    found = []
    for rival in analysis.search.rivals(whole, candidate):
        other = next(c for c in rival.chosen if c not in whole.chosen)
        found.append(Rival(other.effect, naming.place_name(model, other), rival.score - whole.score))
    return sorted(found, key=lambda rival: rival.loss)


def _confidence(
    analysis: Analysis, candidate: Candidate, joint: str, loss: float, rivals: Sequence[Rival], share: float
) -> Confidence:
    others = [rival for rival in rivals if rival.effect != RICHER.get(candidate.effect) or rival.joint != joint]
    if any(rival.loss < CONFIDENT_RIVAL for rival in others):
        return "ambiguous"
    curves = [c for c in analysis.whole.chosen if is_curve(c)]
    concerned = any(candidate.joint in (-1, curve.joint) or depends_on(curve) == joint for curve in curves)
    instead = analysis.search.instead(analysis.whole, candidate)
    curve_as_good = instead is not None and instead.score - analysis.whole.score < CONFIDENT_RIVAL
    weak = loss < (CONFIDENT_BESIDE_UNEXPLAINED if curves else CONFIDENT_LOSS)
    small = candidate.payload < 0 and _rise(analysis, candidate) < LEAST_RISE
    if weak or small or share < CONFIDENT_SHARE or concerned or curve_as_good:
        return "tentative"
    return "confident"


def _share(analysis: Analysis, candidate: Candidate) -> float:
    """Of the gap that is there without the name, in the channel in which it changes most: how much it closes."""
    if candidate.payload >= 0:  # the inertias close it too, but at the cost of being far from what was known
        return 1.0
    counts = analysis.search.design.counts
    without = analysis.search.without(analysis.whole, candidate).squares / counts
    after = analysis.whole.squares / counts
    channel = int(np.argmax(without / after))
    floor = min(after[channel], analysis.innovations[channel])
    return float(np.clip((without[channel] - after[channel]) / max(without[channel] - floor, 1e-300), 0.0, 1.0))


def _rise(analysis: Analysis, candidate: Candidate) -> float:
    """Factor by which the remainder of the channel that is concerned most grows without the name."""
    without = analysis.search.without(analysis.whole, candidate)
    return float(np.sqrt(np.max(without.squares / analysis.whole.squares)))


def unexplained(model: MeasurementModel, analysis: Analysis, gap: FloatArray) -> tuple[Unexplained, ...]:
    """What free curves explain and no name does; ``gap (C,)`` after the names, in floors."""
    found = {}
    for candidate in analysis.whole.chosen:
        if is_curve(candidate):
            joint = model.channels[candidate.joint].name
            found[joint, depends_on(candidate)] = Unexplained(joint, depends_on(candidate), float(gap[candidate.joint]))
    return tuple(found.values())


def verdict(found: Sequence[Finding], left: Sequence[Unexplained], after: FloatArray, counts: FloatArray) -> Verdict:
    """Of the whole run, from the gap ``after (C,)`` on so many independent instants ``counts (C,)``."""
    if left:
        return "unexplained"
    # A standard deviation from n values is itself uncertain by 1 / sqrt(2 n), relative.
    reached = REACHED * (1.0 + 2.0 / np.sqrt(2.0 * np.maximum(counts, 1.0)))
    if not np.all(np.nan_to_num(after) < reached):
        return "incomplete"
    return "named" if found else "no gap"


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
