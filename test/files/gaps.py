"""Results of the gap workflow made by hand, for tests of what is shown and written of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from geomid_ros.files.models.gap_file import GapFile, gap_document, page_entries
from geomid_ros.gap.result import (
    Finding,
    GapErrors,
    GapResult,
    LinkChange,
    Ranked,
    ResidualDependence,
    Rival,
    Trace,
    Unexplained,
    Verdict,
)
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import Quantity
from geomid_ros.report.gap_page import GapPage
from geomid_ros.resimulation.resimulate import Resimulated, SimulatedEfforts
from geomid_ros.types import FloatArray

FLOOR = 0.05  # [N m]
LEVEL = 0.4  # of the Coulomb friction at the joint in the middle [N m]
Case = Literal["no gap", "inertias", "named", "ambiguous", "incomplete", "unexplained"]
AXES = ("fx", "fy", "fz", "tx", "ty", "tz")


def gap_page(case: Case, joints: Sequence[str], *, wrench: bool = False, simulated: bool = False) -> GapPage:
    """The page of a case in which the joint in the middle lacks an effect."""
    result = gap_result(case, joints, wrench=wrench)
    nominal = _bodies(len(joints), 0.0)
    rigid = result.trace.after - _effect(case, result.trace, len(joints) // 2, len(result.channels))
    again = (_simulated_again(joints, result.trace),) if simulated else ()
    document = gap_document(result, {each.kind: each.errors for each in again}) | page_entries(result, nominal)
    beside = {
        "robot": "an arm",
        "recordings": ["monday", "tuesday"],
        "not_simulated": "" if simulated else "MuJoCo has the day off",
        "judged_seconds": 0.0,
        **{key: [] for key in ("known", "causes", "warnings", "notes")},
    }
    file, units = GapFile.of(document | beside, "gap.json"), ["rad"] * len(joints)
    return GapPage(file=file, joints=joints, units=units, result=result, rigid=rigid, simulated=again)


def gap_result(case: Case, joints: Sequence[str], *, wrench: bool = False) -> GapResult:
    """A result whose gaps are those of its trace."""
    middle = len(joints) // 2
    channels = (*joints, *(f"wrist/ft/{axis}" for axis in AXES)) if wrench else tuple(joints)
    units = tuple("N" if "/f" in name[-3:] else "N m" for name in channels)
    trace = _trace(case, len(joints), len(channels))
    bodies = tuple(f"link {name}" for name in joints)
    return GapResult(
        verdict=_verdict(case),
        findings=_findings(case, joints[middle]),
        links=_links(case, joints[middle]),
        unexplained=_unexplained(case, joints),
        channels=channels,
        units=units,
        floor=np.full(len(channels), FLOOR),
        cutoff=8.0,
        gap=GapErrors(
            *(_rms(trace.measured - part) / FLOOR for part in (trace.before, trace.inertias_only, trace.after)),
            np.full(len(channels), 1.02),
        ),
        moving=_rms(trace.measured - trace.after) / FLOOR,
        located=tuple(ResidualDependence(name, 0.8, 0.1, 0.2, 0.0, 0.3) for name in channels),
        ranking=_ranking(case, joints[middle]),
        trace=trace,
        bodies=bodies,
        inertias=_bodies(len(joints), 0.0 if case == "no gap" else 0.1),
        coefficients=np.zeros(0),
        beside=(),
        ordinary=(),
        folded={},
        newly_folded={},
        seconds=2.5,
    )


def _verdict(case: Case) -> Verdict:
    verdicts: dict[Case, Verdict] = {"inertias": "no gap", "ambiguous": "named"}
    return verdicts.get(case, case)  # type: ignore[arg-type]


def _rms(residuals: FloatArray) -> FloatArray:
    rms: FloatArray = np.sqrt(np.nanmean(residuals**2, axis=0))
    return rms


def _trace(case: Case, joints: int, channels: int) -> Trace:
    random = np.random.default_rng(1)
    times = np.arange(720) * 0.0125
    phases, rates = random.uniform(0.0, 6.0, joints), random.uniform(1.0, 4.0, joints)
    angle = times[:, None] * rates + phases
    position, velocity = np.sin(angle), rates * np.cos(angle)
    clean = 3.0 * np.sin(np.resize(angle.T, (channels, len(times))).T)
    trace = Trace(
        stamps=1_700_000_000_000_000_000 + (times * 1e9).astype(np.int64),
        position=position,
        velocity=velocity,
        load=np.abs(clean),
        measured=clean + random.normal(scale=FLOOR, size=clean.shape),
        before=clean,
        inertias_only=clean,
        after=clean,
    )
    effect = _effect(case, trace, joints // 2, channels)
    missing = effect if case in ("named", "ambiguous", "incomplete") else 0.0 * effect
    rest = 0.2 * position[:, :1] ** 2 if case in ("incomplete", "unexplained") else 0.0
    inertial = 0.0 if case == "no gap" else 0.15 * clean
    after = clean + missing
    measured = trace.measured + missing + rest * (np.arange(channels) == joints // 2)
    return replace(trace, measured=measured, after=after, inertias_only=clean + 0.1 * missing, before=clean - inertial)


def _effect(case: Case, trace: Trace, joint: int, channels: int) -> FloatArray:
    effect = np.zeros((len(trace.stamps), channels))
    if case in ("named", "ambiguous", "incomplete"):
        effect[:, joint] = LEVEL * np.sign(trace.velocity[:, joint])
    return effect


def _findings(case: Case, joint: str) -> tuple[Finding, ...]:
    if case not in ("named", "ambiguous", "incomplete"):
        return ()
    ambiguous = case == "ambiguous"
    rivals = (Rival("load_friction", joint, 1.25), Rival("viscous_friction", joint, 3.75)) if ambiguous else ()
    parameters = {"level": Quantity(0.40123, 0.0049, "N m")}
    settled = f"move {joint} at three constant speeds" if ambiguous else ""
    probability = 0.4 if ambiguous else 0.998
    return (
        Finding(
            effect="coulomb_friction",
            joint=joint,
            link="",
            parameters=parameters,
            probability=probability,
            rivals=rivals,
            separability=0.97,
            loss=812.0,
            share=0.93,
            was={},
            settled_by=settled,
        ),
    )


def _links(case: Case, joint: str) -> tuple[LinkChange, ...]:
    if case != "incomplete":
        return ()
    return (LinkChange("hand", joint, Quantity(-0.74, 0.05, "kg"), 1.2, 310.0, 0.99),)


def _unexplained(case: Case, joints: Sequence[str]) -> tuple[Unexplained, ...]:
    depends_on = {"incomplete": "position", "unexplained": joints[0]}.get(case)
    return (Unexplained(joints[len(joints) // 2], depends_on, 4.2),) if depends_on else ()


def _ranking(case: Case, joint: str) -> tuple[Ranked, ...]:
    chosen = case in ("named", "ambiguous", "incomplete")
    return (
        Ranked("coulomb_friction", joint, 812.0, 0.97, chosen),
        Ranked("gravity_tilt", "", 12.5, 0.5, False),
    )


def _bodies(count: int, error: float) -> FloatArray:
    """Bodies ``(count, 10)``; every second is heavier by the share ``error``."""
    masses = np.linspace(4.0, 1.0, count) * (1.0 + error * (np.arange(count) % 2))
    centres = np.tile([0.01, -0.02, 0.1], (count, 1))
    inertias = masses[:, None, None] * np.diag([0.02, 0.02, 0.004])
    return pseudo_inertia.assemble(masses, centres, inertias)


def _simulated_again(joints: Sequence[str], trace: Trace) -> Resimulated:
    before, after = dict.fromkeys(joints, 10.9), dict.fromkeys(joints, 1.02)
    drift = 0.2 * np.linspace(0.0, 1.0, len(trace.stamps))[:, None]
    times, own = (trace.stamps - trace.stamps[0]) * 1e-9, trace.position
    efforts = SimulatedEfforts(times, own, own + drift, own + 1e-3)
    return Resimulated(kind="closed_loop", before=before, after=after, efforts=[efforts])
