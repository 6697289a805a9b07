"""What the workflow said of a realistic robot, compared with the truth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.blind.realistic.sizing import LEAST
from geomid_ros.simulation.options import LINK_MASS

Place = tuple[str, str]
"""An effect's name and its joint; for the whole robot the joint is empty."""

_STANDING = (
    "coulomb_friction",
    "viscous_friction",
    "stribeck_friction",
    "presliding",
    "rotor_inertia",
    "effort_offset",
)
_DELAY = ("effort_delay", "")
_MOST_LATE = 2e-3  # s, an error of a delay that is no wrong name
_LEAST_GAIN = 0.01  # a gain as far from one is true of a joint
_LEAST_LINK = 0.05  # and a link's mass as far from the URDF's
_HEAVIER, _LIGHTER = "link_heavier", "link_lighter"
_SIDES = {_HEAVIER: 1.0, _LIGHTER: -1.0}


@dataclass(frozen=True)
class Size:
    """A parameter of a confident name: how far it is off, as a share of the truth and in standard deviations."""

    effect: str
    joint: str
    off: float
    sigmas: float


@dataclass(frozen=True, kw_only=True)
class RealisticJudgement:
    """A situation of a case in short.

    ``counted``: the change shows in this situation. ``first``: it is the first name, and confident; ``right``: it is
    confident; ``listed``: it is named at all, as a rival too. ``wrong``: confident names of what is not there.
    ``false_delay``: a delay, however sure, that is 2 ms or more off. ``sizes``: of the confident names that are right.
    ``probabilities``: of all names, and whether they are true.
    """

    seed: int
    situation: str
    robot: str
    hidden: Place
    shown: float
    counted: bool
    verdict: str
    named: tuple[tuple[str, str, str], ...]
    first: bool
    right: bool
    listed: bool
    wrong: tuple[Place, ...]
    false_delay: bool
    sizes: tuple[Size, ...]
    after: float
    resimulated: float
    seconds: float
    probabilities: tuple[tuple[float, bool], ...]


def judge(document: Mapping[str, Any], situation: str) -> RealisticJudgement:
    """Compare what was found in a situation with the truth."""
    recorded, gap = document["recorded"], document[situation]["gap"]
    truth = recorded["truth"]
    change = truth["effects"][0]
    findings = sorted([*gap["findings"], *map(_of_link, gap["links"])], key=lambda finding: -finding["loss"])
    names = _names(change)
    sure = [finding for finding in findings if finding["confidence"] == "confident"]
    rivals = {_place(rival) for finding in findings for rival in finding["rivals"]}
    delays = [finding["parameters"]["delay"]["value"] for finding in findings if _place(finding) == _DELAY]
    shown = recorded["shown"]["both" if situation == "model" else "alone"]
    return RealisticJudgement(
        seed=document["seed"],
        situation=situation,
        robot=str(recorded["case"]["was"]["robot"]).removesuffix(".urdf"),
        hidden=(change["effect"], change["joint"]),
        shown=shown,
        counted=shown >= LEAST,
        verdict=gap["verdict"],
        named=tuple((*_place(finding), finding["confidence"]) for finding in findings),
        first=bool(sure) and findings[0] is sure[0] and _place(sure[0]) in names,
        right=any(_place(finding) in names for finding in sure),
        listed=any(place in names for place in [*map(_place, findings), *rivals]),
        wrong=tuple(_place(finding) for finding in sure if not _is_true(_place(finding), names, truth, situation)),
        false_delay=any(abs(delay - _true_delay(truth)) > _MOST_LATE for delay in delays),
        sizes=tuple(size for finding in sure for size in _sizes(finding, truth)),
        after=_worst(gap["gap"]["after"].values()),
        resimulated=_worst((gap["resimulated"] or {}).get("after", {}).values()),
        seconds=document[situation]["seconds"],
        probabilities=tuple(
            (finding["probability"], _is_true(_place(finding), names, truth, situation)) for finding in findings
        ),
    )


def _of_link(change: Mapping[str, Any]) -> dict[str, Any]:
    """A link that weighs something else, as a finding."""
    effect = _HEAVIER if change["mass"]["value"] > 0.0 else _LIGHTER
    return {**change, "effect": effect, "parameters": {"mass": change["mass"]}, "rivals": []}


def _names(change: Mapping[str, Any]) -> tuple[Place, ...]:
    """The names that say the change: more dry friction may be told with what it was, which has Stribeck's shape; what
    a link carries makes it heavier, and what makes it heavier is a payload."""
    effect, joint = change["effect"], change["joint"]
    if effect == "coulomb_friction":
        return ((effect, joint), ("stribeck_friction", joint))
    if effect == LINK_MASS:
        effect = "payload" if change["parameters"]["factor"] > 1.0 else _LIGHTER
    return ((effect, joint), (_HEAVIER, joint)) if effect == "payload" else ((effect, joint),)


def _is_true(place: Place, names: Sequence[Place], truth: Mapping[str, Any], situation: str) -> bool:
    """Whether the robot has this; a delay is judged by its size, elsewhere."""
    effect, joint = place
    if place in names or effect in _STANDING or place == _DELAY:
        return True
    if effect == "effort_gain":
        return abs(_standing(truth, effect, joint, "gain", 1.0) - 1.0) >= _LEAST_GAIN
    return effect in _SIDES and situation == "urdf" and _is_off(truth, joint, _SIDES[effect])


def _is_off(truth: Mapping[str, Any], joint: str, side: float) -> bool:
    """Whether a link that the joint moves differs much from the URDF, to this ``side``."""
    return any(link["joint"] == joint and side * link["mass_error"] >= _LEAST_LINK for link in truth["links"])


def _true_delay(truth: Mapping[str, Any]) -> float:
    return sum(float(entry["parameters"].get("delay", 0.0)) for entry in (*truth["effects"], *truth["standing"]))


def _sizes(finding: Mapping[str, Any], truth: Mapping[str, Any]) -> Iterable[Size]:
    """Of the main parameter, if what is true of it is known; the nearer of the whole and of what was added to it."""
    effect, joint = place = _place(finding)
    values = finding["parameters"]
    if effect == "gravity_tilt":
        tilts = [entry["parameters"] for entry in truth["effects"] if entry["effect"] == effect]
        axes = ("tilt_x", "tilt_y")
        if tilts:
            off = math.dist([values[axis]["value"] for axis in axes], [tilts[0][axis] for axis in axes])
            deviation = math.hypot(*(values[axis]["std"] or math.nan for axis in axes))
            yield Size(*place, off / math.hypot(*(tilts[0][axis] for axis in axes)), off / deviation)
        return
    trues = _true_sizes(effect, joint, truth)
    main = {"payload": "mass"}.get(effect, next(iter(values)))
    if trues and values[main]["std"]:
        errors = [(abs(values[main]["value"] - true), abs(true)) for true in trues if true]
        off, true = min(errors, default=(math.nan, 1.0))
        yield Size(*place, off / true, off / float(values[main]["std"]))


def _true_sizes(effect: str, joint: str, truth: Mapping[str, Any]) -> list[float]:
    """The whole and, if something was hidden there, the part that was added; empty where the robot has no such."""
    hidden = {(entry["effect"], entry["joint"]): entry["parameters"] for entry in truth["effects"]}
    added = next(iter(hidden.get((effect, joint), {}).values()), 0.0)
    if effect == "effort_delay":
        return [_true_delay(truth), added]
    if effect in ("payload", "load_friction"):
        return [added] if added else []
    gain = _standing(truth, "effort_gain", joint, "gain", 1.0)
    if effect == "effort_gain":
        return [gain * (added or 1.0), *([added] if added else [])]
    gain *= hidden.get(("effort_gain", joint), {}).get("gain", 1.0)
    if effect == "spring":
        return [gain * added] if added else []
    if effect == "stribeck_friction":
        added = hidden.get(("coulomb_friction", joint), {}).get("level", 0.0)
    had = _had(effect, joint, truth)
    if had is None:
        return []
    if effect == "effort_offset":
        return [had + added]
    return [gain * (had + added), *([gain * added] if added else [])]


def _had(effect: str, joint: str, truth: Mapping[str, Any]) -> float | None:
    """What the robot had without what is hidden: of viscous friction the mean over the recording."""
    at = truth["joints"].index(joint)
    if effect in ("coulomb_friction", "stribeck_friction"):
        return float(truth["friction"]["level"][at])
    if effect == "viscous_friction":
        times = np.linspace(0.0, truth["options"]["duration"], 100)
        cold = 1.0 + truth["warm_up"]["excess"][at] * np.exp(-times / truth["warm_up"]["time"]).mean()
        return float(truth["friction"]["viscous"][at] * cold)
    if effect in ("rotor_inertia", "effort_offset"):
        return _standing(truth, effect, joint, effect.split("_")[1], 0.0)
    return None


def _standing(truth: Mapping[str, Any], effect: str, joint: str, parameter: str, default: float) -> float:
    entries = (entry for entry in truth["standing"] if (entry["effect"], entry["joint"]) == (effect, joint))
    return next((float(entry["parameters"][parameter]) for entry in entries), default)


def _place(entry: Mapping[str, Any]) -> Place:
    return str(entry["effect"]), str(entry["joint"]).lstrip("/")


def _worst(values: Iterable[float | None]) -> float:
    return max((value for value in values if value is not None), default=math.nan)
