"""Summary of the gap workflow in words, the same in the terminal and on the page. The sentence of each finding is
:attr:`geomid_ros.gap.result.Finding.sentence`."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from geomid_ros.estimation.estimate import SIGNIFICANT_STDS, STDS_OF_95
from geomid_ros.files.models.effects_file import effect_name
from geomid_ros.gap.result import Confidence, Finding, GapResult, LinkChange, Ranked, Rival, Unexplained
from geomid_ros.gap.verdict import GAP_ABOVE
from geomid_ros.model.channels import BASE
from geomid_ros.model.effects import KnownEffect, Quantity, effect_class
from geomid_ros.types import FloatArray

NONE = "n/a"
MOST_LISTED = 3
"""Largest number of listed parts in a sentence, of findings with a sentence each, and of compared rivals."""
MOST_CANDIDATES = 8
"""Largest number of candidates in a table, the best first."""
_VARIABLES = {
    "position": "its position",
    "velocity": "its velocity",
    "load": "the effort it transmits",
    "acceleration": "its acceleration",
    "time": "time",
    "reversals": "its last reversal",
    "unknown": "none of the tested variables",
}
_RECORD = {
    "position": "a slow motion of the joint at one constant speed, over its whole range and back",
    "velocity": "the joint over one range at several constant speeds, slow to fast, in both directions",
    "load": "the same motion with and without a known payload",
    "acceleration": "slow and fast accelerations of this joint alone",
    "time": "the same motion every few minutes, from cold to warm",
    "reversals": "the joint back and forth, at several positions, with small and large strokes",
    "unknown": "the same motion again, to check whether the residual repeats",
}
_ON_LEGS = "the trunk swaying on all feet, then each leg in the air for two seconds or more"
CONFIDENCE: dict[Confidence, tuple[str, str]] = {
    "confident": ("sure", "nothing else explains the data as well"),
    "tentative": ("tentative", "the best explanation, but the evidence is weak"),
    "ambiguous": ("ambiguous", "other effects explain the data as well"),
}
"""Word of each confidence, and what it means."""


def headline(effect: str) -> str:
    """Name of an effect at the beginning of a heading."""
    name = effect_name(effect)
    return name[:1].upper() + name[1:]


def place(joint: str, link: str = "") -> str:
    """Place where an effect acts, as the end of a sentence."""
    return f"on {link}" if link else f"at {joint}" if joint else "of the whole robot"


def title(entry: KnownEffect | Rival | Ranked) -> str:
    """Name of an effect with its place."""
    return f"{headline(entry.effect)} {place(entry.joint, getattr(entry, 'link', ''))}"


def ratio(value: float) -> str:
    """Format a gap in units of the noise floor."""
    if not math.isfinite(value):
        return NONE
    return f"{value:.2f}" if value < 9.995 else f"{value:.1f}" if value < 99.95 else f"{value:.0f}"


def percent(share: float) -> str:
    """Format a fraction, 0 to 1, as a percentage."""
    return f"{100.0 * share:.0f} %" if math.isfinite(share) else NONE


def _decimals(std: float, value: float) -> int:
    """Decimals for two digits of the standard deviation, or four of the value if there is none."""
    size, digits = (std, 2) if math.isfinite(std) and std > 0.0 else (abs(value), 4)
    return int(np.clip(digits - 1 - math.floor(math.log10(size)), 0, 9)) if math.isfinite(size) and size > 0.0 else 0


def measured(quantity: Quantity) -> str:
    """Format a value with unit and, if it was estimated, standard deviation."""
    if quantity.std == 0.0:
        return f"{quantity.value:g} {quantity.unit}".removesuffix(" -")
    decimals = _decimals(quantity.std, quantity.value)
    deviation = f" ± {quantity.std:.{decimals}f}" if math.isfinite(quantity.std) else ""
    return f"{quantity.value:.{decimals}f}{deviation} {quantity.unit}".removesuffix(" -")


def measured_angle(quantity: Quantity) -> str:
    """Format a value as :func:`measured` does; angles within one turn also in degrees."""
    small = quantity.unit == "rad" and abs(quantity.value) < 2.0 * math.pi
    return measured(quantity) + (f" ({math.degrees(quantity.value):.3g}°)" if small else "")


def compared(rival: Rival) -> str:
    """Describe a rival, and by how much its score is worse; or better, if unseen data did not confirm it."""
    return f"{title(rival)} ({'worse' if rival.loss >= 0.0 else 'better'} by {abs(rival.loss):.1f})"


def interval(quantity: Quantity, name: str, effect: str) -> str:
    """95 % interval of the true value of an effect's parameter, from the least possible value on; :data:`NONE` for a
    constant, or if the standard deviation is infinite."""
    if not 0.0 < quantity.std < math.inf:
        return NONE
    decimals, half = _decimals(quantity.std, quantity.value), STDS_OF_95 * quantity.std
    (above,) = (form.above for form in effect_class(effect).parameters if form.name == name)
    return f"{max(quantity.value - half, above):.{decimals}f} to {quantity.value + half:.{decimals}f}"


def worst(values: FloatArray) -> float:
    """Largest gap among the measured channels."""
    return float(np.max(values, where=np.isfinite(values), initial=0.0))


def dependence(entry: Unexplained) -> str:
    """Describe the variable that an unexplained remainder depends on."""
    return _VARIABLES.get(entry.depends_on, f"the motion of {entry.depends_on}")


def verdict_sentence(result: GapResult) -> str:
    """State the verdict in one sentence, and the channels that could not be tested in another."""
    aside = f" Not tested: {_listed(result.unjudged)}; hold out more, or a faster motion." if result.unjudged else ""
    return _verdict(result) + aside


def _verdict(result: GapResult) -> str:
    gap = result.gap
    named = _named(result)
    missing = _missing(not_explained(result))
    if result.verdict == "no gap":
        if worst(gap.before) <= GAP_ABOVE * worst(gap.after):
            return f"No gap found: {_left(result)}."
        joints = ", with friction, rotor inertias and offsets of joints," if result.ordinary else ""
        return f"No effect is missing. Corrected link inertias{joints} close the gap: {_fall(result)}."
    if result.verdict == "named":
        parts: list[Finding | LinkChange] = [*result.findings, *result.links]
        if not any(part.confidence == "confident" for part in parts):
            unchanged = "" if result.ordinary else "; the written model is unchanged"
            return f"Found: {named}. None of them is certain{unchanged}."
        return f"Found: {named}. With {'it' if len(parts) == 1 else 'them'}, {_fall(result)}."
    if result.verdict == "incomplete":
        rest = f" A residual remains {missing}." if missing else ""
        return f"Found: {named or 'no effect'}.{rest}"
    return f"No known effect explains the residual {missing or 'of several joints'}."


def _left(result: GapResult) -> str:
    """Describe the gap that remains while joints move, and over all held-out samples, if the verdict is no gap."""
    moving, overall = ratio(worst(result.moving)), ratio(worst(result.gap.after))
    when = f" while joints move ({overall} with rest and reversals)" if moving != overall else ""
    if worst(result.moving) <= GAP_ABOVE:
        return f"the model explains the measurement to within {moving} times the noise floor{when}"
    reason = "which the uncertainty of the model, or its known remainder, explains"
    return f"up to {moving} times the noise floor is left{when}, {reason}"


def _fall(result: GapResult) -> str:
    """Describe the reduction of the gap in the channel that improves most."""
    before, after = result.gap.before, result.gap.after
    channel = int(np.argmax(np.nan_to_num(before / after)))
    initial, remaining, moving = (ratio(float(gaps[channel])) for gaps in (before, after, result.moving))
    aside = f" ({moving} while joints move)" if moving not in (remaining, NONE) else ""
    return f"the gap of {result.channels[channel]} falls from {initial} to {remaining} times the noise floor{aside}"


def _missing(remainders: Sequence[tuple[str, float, str]]) -> str:
    """Describe where something is unexplained; for a single joint also what it depends on."""
    where = f"at {_listed([joint for joint, *_ in remainders])}" if remainders else ""
    return f"{where}, which depends on {remainders[0][2]}" if len(remainders) == 1 else where


def summary(result: GapResult) -> list[str]:
    """Summarise the result in at most four sentences after the verdict: sure and possible effects with their sizes,
    effects that have rivals as likely, and the unexplained remainder."""
    gains = _common_gain(result)
    named: list[Finding | LinkChange] = [*(f for f in result.findings if f not in gains), *result.links]
    named.sort(key=lambda part: -part.loss)
    lines = [(part.confidence, _described(part)) for part in named]
    if gains:
        sure = all(finding.confidence == "confident" for finding in gains)
        low, *_, high = sorted(finding.parameters["gain"].value for finding in gains)
        phrase = f"efforts of all joints {low:.3g} to {high:.3g} times as large"
        lines.insert(0, ("confident" if sure else "tentative", phrase))
    rest = [f"{joint} {ratio(times)} times the floor, depends on {on}" for joint, times, on in not_explained(result)]
    sentences = {
        "Sure": _few([phrase for confidence, phrase in lines if confidence == "confident"]),
        "Possible": _few([phrase for confidence, phrase in lines if confidence == "tentative"]),
        "Ambiguous": _few([phrase for confidence, phrase in lines if confidence == "ambiguous"]),
        "Unexplained": "; ".join(rest),
    }
    return [f"{about}: {sentence}." for about, sentence in sentences.items() if sentence]


def _common_gain(result: GapResult) -> list[Finding]:
    """Effort gains of all joints if they are equal within three standard deviations of their mean; else empty."""
    by_joint = {f.joint: f for f in result.findings if f.cls.scales_measurement}
    gains = [finding.parameters["gain"] for finding in by_joint.values()]
    joints = result.channels[: result.trace.position.shape[1]]  # effort channels come before wrench channels
    if len(gains) < 2 or set(joints) - set(by_joint):
        return []
    values, weights = np.array([gain.value for gain in gains]), 1.0 / np.square([gain.std for gain in gains])
    deviations = np.abs(values - np.average(values, weights=weights)) * np.sqrt(weights)
    return list(by_joint.values()) if np.all(deviations < SIGNIFICANT_STDS) else []


def _described(part: Finding | LinkChange) -> str:
    """Describe an effect with its size, or with its rivals if these are as likely; or a changed link."""
    if isinstance(part, LinkChange):
        return part.sentence
    if part.confidence != "ambiguous":
        return _sized(part)
    return " or ".join([title(part), *map(title, part.rivals[:MOST_LISTED])])


def _few(parts: Sequence[str]) -> str:
    more = len(parts) - MOST_LISTED
    return "; ".join(parts[:MOST_LISTED]) + (f"; {more} more below" if more > 0 else "")


def _sized(finding: Finding) -> str:
    """Describe an effect with its place, its first parameter and the former value; of several parameters of one kind
    the most significant one. For a payload of unidentified mass, give the first moment."""
    if finding.moment:
        return f"{title(finding)} {', '.join(f'{name} {measured(q)}' for name, q in finding.moment.items())}"
    count = finding.cls.count
    sizes = list(finding.parameters.items())[: max(count, 1)]
    name, quantity = max(sizes, key=lambda size: abs(size[1].value) / size[1].std if size[1].std > 0.0 else np.inf)
    former = f" instead of {finding.was[name]:.4g}" if name in finding.was else ""
    label = f"{name.replace('_', ' ')} " if count > 1 else ""
    return f"{title(finding)} {label}{measured(quantity)}{former}"


def not_explained(result: GapResult) -> list[tuple[str, float, str]]:
    """List joints with an unexplained remainder, its size in noise floors, and all variables that it depends on."""
    variables: dict[str, list[str]] = {}
    for entry in result.unexplained:
        variables.setdefault(entry.joint, []).append(dependence(entry))
    gaps = {entry.joint: entry.gap for entry in result.unexplained}
    return [(joint, gaps[joint], _listed(list(dict.fromkeys(on)))) for joint, on in variables.items()]


def _named(result: GapResult) -> str:
    """List each effect once with all its places, or of many effects the most certain ones; and the changed links."""
    findings, changed = result.findings, [f"a change of link '{change.link}'" for change in result.links]
    if len(findings) > MOST_LISTED:
        surest = sorted(findings, key=lambda finding: -finding.probability)[:MOST_LISTED]
        first = [f"{effect_name(f.effect)} {place(f.joint, f.link)}" for f in surest]
        return _listed([f"{len(findings)} effects, most certainly {_listed(first)}", *changed])
    places: dict[str, list[str]] = {}
    for finding in findings:
        places.setdefault(effect_name(finding.effect), []).append(place(finding.joint, finding.link))
    return _listed([*(f"{effect} {_listed(where)}" for effect, where in places.items()), *changed])


def _listed(parts: Sequence[str]) -> str:
    return ", ".join(parts[:-1]) + (" and " if len(parts) > 1 else "") + "".join(parts[-1:])


def next_recordings(result: GapResult) -> list[str]:
    """List the motions to record next, each with its purpose; empty if nothing is open."""
    purposes: dict[str, list[str]] = {}
    for finding in result.findings:
        if finding.settled_by:
            effect = f"{effect_name(finding.effect)} {place(finding.joint, finding.link)}"
            purposes.setdefault(finding.settled_by, []).append(effect)
    for entry in result.unexplained:
        motion = _RECORD.get(entry.depends_on, f"the joint alone, then {entry.depends_on} alone, then both")
        motion = _ON_LEGS if entry.joint.startswith(f"{BASE}/") else motion
        purposes.setdefault(motion, []).append(f"the residual at {entry.joint}")
    once = {motion: list(dict.fromkeys(purpose)) for motion, purpose in purposes.items()}
    return [
        f"{motion.replace('this joint', 'each joint') if len(purpose) > 1 else motion} (for {_listed(purpose)})"
        for motion, purpose in once.items()
    ]
