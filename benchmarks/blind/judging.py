"""What the workflow said of a case, compared with the truth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

VISIBLE = 1.15
"""A gap counts from this many times the floor on, after the inertias were fitted: the workflow's own figure."""

Place = tuple[str, str]
"""An effect's name and its joint; for the whole robot the joint is empty."""

# What is true of an effect besides its name: the rotor in front of a gear that gives, the mean of uneven friction.
_ALSO_TRUE = {
    "joint_elasticity": ("rotor_inertia",),
    "backlash": ("rotor_inertia",),
    "position_friction": ("coulomb_friction",),
}


@dataclass(frozen=True)
class Judgement:
    """A case in short. ``truth`` are the hidden effects, ``named`` the findings as (effect, joint, confidence).

    ``visible``: the worst channel's gap beside fitted inertias reaches VISIBLE. ``after``: what is left of the worst
    channel on held-out data; ``channels``: of each. ``right``: hidden effects named confidently; ``listed``: hidden
    effects named at all, as rivals too; ``wrong``: confident names of what is not there. ``flagged``: an outside effect
    is reported as unexplained on its joint. ``errors``: of the parameters of what was named rightly, by ``effect``, in
    the unit of :func:`parameter_errors`. ``probabilities``: of all names, and whether they are true.
    """

    kind: str
    seed: int
    robot: str
    wrench: bool
    simulator: str
    coloured: bool
    motion: str
    truth: tuple[Place, ...]
    named: tuple[tuple[str, str, str], ...]
    visible: bool
    right: tuple[Place, ...]
    listed: tuple[Place, ...]
    wrong: tuple[Place, ...]
    flagged: bool
    verdict: str
    before: float
    inertias_only: float
    after: float
    channels: tuple[float, ...]
    resimulated: float
    errors: Mapping[str, float]
    seconds: float
    processor_seconds: float
    probabilities: tuple[tuple[float, bool], ...]


def judge(document: Mapping[str, Any]) -> Judgement:
    """Judge a finished case's document."""
    case, truth, gap = document["case"], document["truth"], document["gap"]
    hidden = {(entry["effect"], _joint(entry)): entry for entry in truth["effects"]}
    findings = gap["findings"]
    named = {(finding["effect"], _joint(finding)): finding for finding in findings}
    rivals = {(rival["effect"], _joint(rival)) for finding in findings for rival in finding["rivals"]}
    confident = {place for place, finding in named.items() if finding["confidence"] == "confident"}
    gaps = {kind: _worst(gap["gap"][kind].values()) for kind in ("before", "inertias_only", "after")}
    resimulated = (gap["resimulated"] or {}).get("after", {})
    return Judgement(
        kind=case["kind"],
        seed=case["seed"],
        robot=str(case["held_out"]["robot"]).removesuffix(".urdf"),
        wrench=case["held_out"]["wrench_frame"] is not None,
        simulator=case["simulator"],
        coloured=case["held_out"]["noise_time"] > 0.0,
        motion=case["training"][0]["motion"],
        truth=tuple(hidden),
        named=tuple((*place, finding["confidence"]) for place, finding in named.items()),
        visible=gaps["inertias_only"] >= VISIBLE,
        right=tuple(place for place in hidden if place in confident),
        listed=tuple(place for place in hidden if place in named or place in rivals),
        wrong=tuple(sorted(confident - hidden.keys() - _also_true(hidden))),
        flagged=_flagged(truth["effects"], {entry["joint"] for entry in gap["unexplained"]}),
        verdict=gap["verdict"],
        **gaps,
        channels=tuple(value for value in gap["gap"]["after"].values() if value is not None),
        resimulated=_worst(resimulated.values()),
        errors=dict(
            error
            for place, entry in hidden.items()
            if place in named
            for error in parameter_errors(place[0], entry["parameters"], _values(named[place]))
        ),
        seconds=document["seconds"],
        processor_seconds=document["processor_seconds"],
        probabilities=tuple(
            (finding["probability"], place in hidden.keys() | _also_true(hidden)) for place, finding in named.items()
        ),
    )


def parameter_errors(effect: str, true: Mapping[str, float], found: Mapping[str, float]) -> Iterable[tuple[str, float]]:
    """How far the found parameters are off: degrees for a tilt, milliseconds for a delay, else per cent."""
    if effect == "gravity_tilt":
        yield effect, math.degrees(math.dist(*([values["tilt_x"], values["tilt_y"]] for values in (true, found))))
    elif effect == "effort_delay":
        yield effect, 1e3 * abs(found["delay"] - true["delay"])
    elif effect == "effort_gain":
        yield effect, 100.0 * abs(found["gain"] / true["gain"] - 1.0)
    elif effect == "wrench_offset":
        for part in ("f", "t"):
            axes = [part + axis for axis in "xyz"]
            off = math.dist([true[axis] for axis in axes], [found[axis] for axis in axes])
            yield f"{effect} {part}", 100.0 * off / math.hypot(*(true[axis] for axis in axes))
    else:
        main = next(iter(true))
        yield effect, 100.0 * abs(found[main] / true[main] - 1.0)


def _also_true(hidden: Iterable[Place]) -> set[Place]:
    return {(other, joint) for effect, joint in hidden for other in _ALSO_TRUE.get(effect, ())}


def _flagged(effects: Iterable[Mapping[str, Any]], unexplained: set[str]) -> bool:
    """A cable pulls at two joints; the other effects from outside act at one."""
    return any(
        {entry["joint"], entry["other"] if entry["effect"] == "cable_force" else entry["joint"]} & unexplained
        for entry in effects
    )


def _joint(entry: Mapping[str, Any]) -> str:
    return str(entry["joint"]).lstrip("/")


def _values(finding: Mapping[str, Any]) -> dict[str, float]:
    return {name: quantity["value"] for name, quantity in finding["parameters"].items()}


def _worst(values: Iterable[float | None]) -> float:
    return max((value for value in values if value is not None), default=math.nan)
