"""What may be said of an analysis: its findings, and whether anything is left without a name."""

from __future__ import annotations

import numpy as np

from geomid_ros.estimation.estimate import is_told
from geomid_ros.gap.candidates import Candidate
from geomid_ros.gap.fitting.fit import JointFit
from geomid_ros.gap.judgement import naming
from geomid_ros.gap.judgement.blocks import scattered
from geomid_ros.gap.judgement.closing import CONFIDENT_RIVAL, Closing, is_open, open_curves
from geomid_ros.gap.judgement.confidence import Evidence, moves_one_way
from geomid_ros.gap.judgement.held_out import HeldOut
from geomid_ros.gap.judgement.locate import strongest
from geomid_ros.gap.judgement.unsure import (
    as_unsure,
    as_unsure_beside_others,
    as_unsure_beside_remainder,
    may_be_as_before,
)
from geomid_ros.gap.result import Finding, Ranked, Rival, Unexplained, Verdict
from geomid_ros.gap.search.analysis import Analysis
from geomid_ros.gap.search.beam_search import LEAST_GAIN, Search
from geomid_ros.gap.search.score_test import score_test
from geomid_ros.model.effects import EFFECTS, Quantity, joint_of
from geomid_ros.model.measurement import MeasurementModel


def findings(model: MeasurementModel, analysis: Analysis, unseen: HeldOut) -> list[tuple[Candidate, Finding]]:
    """The names, the one that matters most first, judged on what was fitted and on ``unseen`` data."""
    # Of the fit without curves: beside those that span a part of it, a size means something else.
    sized = scattered(analysis.search.design, analysis.names)
    names = [c for c in analysis.whole.chosen if isinstance(c, Candidate)]
    found = [(candidate, _finding(model, analysis, candidate, unseen, sized)) for candidate in names]
    return sorted(found, key=lambda named: -named[1].loss)


def _finding(
    model: MeasurementModel, analysis: Analysis, candidate: Candidate, unseen: HeldOut, sized: JointFit
) -> Finding:
    search = analysis.search.unchanged(candidate)
    whole = Closing(analysis, unseen, candidate).beside
    without = search.without(whole, candidate)
    loss = without.score - whole.score
    rivals = _rivals(model, analysis, candidate, whole)
    joint, link = model.places.name(candidate.place), naming.link_name(model, candidate)
    close = [(EFFECTS[rival.effect](), rival.joint) for rival in rivals if rival.loss < CONFIDENT_RIVAL]
    load = analysis.problem.situation.usual_load(candidate.place) if candidate.effect.scanned else 0.0
    parameters = naming.parameters(model, sized, candidate, _scanned_std(analysis, candidate), load)
    parameters = as_unsure(model, analysis, candidate, parameters, load)
    was = naming.known_before(model, analysis.search.prior, candidate, load)
    moment = as_unsure(model, analysis, candidate, naming.first_moment(sized, candidate), load)
    if not any(map(_is_told, moment.values())) or _is_told(parameters["mass"]):
        moment = {}
    evidence = Evidence(model=model, analysis=analysis, unseen=unseen, candidate=candidate, rivals=rivals, loss=loss)
    confidence = evidence.confidence(parameters)
    parameters = as_unsure_beside_others(model, analysis, candidate, parameters, load)
    parameters = as_unsure_beside_remainder(candidate, parameters, was, evidence.closing.doubt)
    if confidence == "confident" and may_be_as_before(candidate, parameters, was):
        confidence = "tentative"
    return Finding(
        effect=candidate.name,
        joint=joint,
        link=link,
        parameters=parameters,
        confidence=confidence,
        rivals=tuple(rival for rival in rivals if rival.loss < loss),
        separability=float(np.clip(score_test(search.design, without, candidate).separability, 0.0, 1.0)),
        loss=loss,
        share=evidence.share,
        was=was,
        sentence=naming.sentence(candidate.effect, joint, link, parameters, was, confidence, moment=moment),
        settled_by=naming.settled_by(candidate.effect, joint, close) if confidence != "confident" else "",
        moment=moment,
    )


def _is_told(quantity: Quantity) -> bool:
    return is_told(quantity.value, quantity.std)


def _scanned_std(analysis: Analysis, candidate: Candidate) -> float:
    """Standard deviation of the logarithm of a scanned constant, from the curvature of the score over its neighbours; 1
    where that says nothing, 0 for a name without one."""
    if not candidate.effect.scanned:
        return 0.0
    search, whole = analysis.search, analysis.whole
    around = search.neighbours(candidate)
    if len(around) < 2:
        return 1.0
    scanned = [around[0], candidate, around[1]]
    rest = [c for c in whole.chosen if c is not candidate]
    logs = np.log([c.effect.scanned for c in scanned])
    scores = [search.fit([*rest, c], whole).score for c in scanned]
    curvature = 2.0 * float(np.polyfit(logs - logs[1], scores, 2)[0])  # the score is minus twice a log likelihood
    step = 0.5 * float(logs[2] - logs[0])
    return min(1.0, float(np.sqrt(2.0 / curvature + step**2 / 12.0))) if curvature > 0.0 else 1.0


def _rivals(model: MeasurementModel, analysis: Analysis, candidate: Candidate, whole: JointFit) -> list[Rival]:
    found, search = [], analysis.search.unchanged(candidate)
    for rival in search.rivals(whole, candidate):
        (other,) = (c for c in rival.chosen if isinstance(c, Candidate) and c not in whole.chosen)
        beside = _score_beside(search, whole, other)
        found.append(Rival(other.name, model.places.name(other.place), rival.score - beside))
    alike = candidate.effect.alike_one_way
    if alike and moves_one_way(analysis, joint_of(candidate.place)):
        joint = model.places.name(candidate.place)
        found = [rival for rival in found if (rival.effect, rival.joint) != (alike, joint)]
        found.append(Rival(alike, joint, 0.0))
    return sorted(found, key=lambda rival: rival.loss)


def _score_beside(search: Search, whole: JointFit, other: Candidate) -> float:
    """The score beside which another name is a rival: where that would be taken beside all names, as one that unseen
    data have refused, it is the score with all of them. What it explains besides is no doubt of a name."""
    if any(other.excludes(chosen) for chosen in whole.chosen):
        return whole.score
    both = search.fit([*whole.chosen, other], whole)
    taken = search.possible(both) and whole.score - both.score > LEAST_GAIN
    return both.score if taken else whole.score


def unexplained(model: MeasurementModel, analysis: Analysis, unseen: HeldOut) -> tuple[Unexplained, ...]:
    """What free curves explain and no name does, and the channels whose gap on unseen data stays open."""
    found = {}
    for curve in open_curves(analysis, unseen):
        joint, variable = model.channels[curve.joint].name, curve.variable
        found[joint, variable] = Unexplained(joint, variable, float(unseen.gap.after[curve.joint]))
    said = {joint for joint, _ in found}
    for place in np.flatnonzero(is_open(unseen)):
        joint = model.channels[place].name
        if joint not in said:
            variable = strongest(unseen.located[place])
            found[joint, variable] = Unexplained(joint, variable, float(unseen.gap.after[place]))
    return tuple(found.values())


def verdict(analysis: Analysis, unseen: HeldOut) -> Verdict:
    """Of the whole run."""
    if open_curves(analysis, unseen):
        return "unexplained"
    if np.any(is_open(unseen)):
        return "incomplete"
    return "named" if analysis.names.chosen else "no gap"


def ranking(model: MeasurementModel, analysis: Analysis) -> tuple[Ranked, ...]:
    """Chosen names by what they are worth, then the others by what the score test says of them."""
    whole = analysis.whole
    chosen = []
    for c in (c for c in whole.chosen if isinstance(c, Candidate)):
        search = analysis.search.unchanged(c)
        rest = search.without(whole, c)
        separability = score_test(search.design, rest, c).separability
        chosen.append(Ranked(c.name, model.places.name(c.place), rest.score - whole.score, separability, True))
    others = [
        Ranked(t.candidate.name, model.places.name(t.candidate.place), t.gain, t.separability, False)
        for t in analysis.search.ranked(whole)
        if isinstance(t.candidate, Candidate) and np.isfinite(t.gain)
    ]
    return tuple(sorted(chosen, key=lambda r: -r.gain) + others[:20])
