"""Pages of results: ``report.html`` of an identification, with its uses and open parameters in words; ``compare.html``,
two results of one robot side by side; ``fleet.html``, many robots."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from geomid_ros.checks.verdict import USABLE
from geomid_ros.estimation.comparison import Compared, Difference
from geomid_ros.estimation.estimate import QUANTITIES, STDS_OF_95, LinkEstimate
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.model.effects import Quantity, effect_class
from geomid_ros.report import gap_words
from geomid_ros.report.gap_words import percent
from geomid_ros.report.page import Bars, Script, ticks, write_page
from geomid_ros.report.series import SCRIPT, Series, traces


@dataclass(frozen=True, kw_only=True)
class ChannelErrors:
    """Residual RMS of two results in a channel, in its ``unit``; NaN where a result has none."""

    name: str
    unit: str
    first: float
    second: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparisonPage:
    """Content of the page: the files ``first`` and ``second``, their differences (``compared``), the ``errors`` of both
    by channel and the data that these are ``judged_on``, ``doubts`` and ``notes``."""

    first: str
    second: str
    compared: Compared
    errors: Sequence[ChannelErrors]
    judged_on: str
    doubts: Sequence[str]
    notes: Sequence[str]


def write_comparison_page(path: Path, page: ComparisonPage) -> None:
    """Write the page.

    Raises:
        GeomidError: the file cannot be written.
    """
    content = {
        "page": page,
        "verdict": verdict(page.compared),
        "sure": STDS_OF_95,
        "differing": [row(each) for each in page.compared.differing],
        "all": [row(each) for each in page.compared.differences],
        "errors": [(e.name, e.unit, error(e.first), error(e.second)) for e in page.errors],
    }
    write_page(path, "comparison.html.j2", content)


def verdict(found: Compared) -> str:
    """State in a sentence if the results differ."""
    links = [link.sentence for link in found.changed]
    numbers = len(found.differing)
    parts = [*links, *([f"{numbers} number{'s' * (numbers > 1)} beyond the joint 95 % intervals"] if numbers else [])]
    return f"The results differ: {'; '.join(parts)}." if parts else "Nothing differs beyond the joint 95 % intervals."


def row(difference: Difference) -> tuple[str, str, str, str, str]:
    """Return place, name, both values with their 95 % intervals, and the difference with its joint interval."""
    name = gap_words.headline(difference.effect) + (" " if difference.effect else "") + difference.parameter
    change = Quantity(difference.value, difference.half_width, difference.unit)
    apart = gap_words.measured(change) if math.isfinite(difference.value) else ""
    before, after = _value(difference.first), _value(difference.second)
    return difference.place or "the whole robot", name.replace("_", " "), before, after, apart


def _value(quantity: Quantity | None) -> str:
    if quantity is None:
        return "none"
    return gap_words.measured(Quantity(quantity.value, STDS_OF_95 * quantity.std, quantity.unit))


def error(value: float) -> str:
    """Format an error; empty if it is not known."""
    return f"{value:.3g}" if math.isfinite(value) else ""


@dataclass(frozen=True, kw_only=True)
class RobotLine:
    """Line of a robot on the page.

    Attributes:
        name: name of the robot.
        bags, used: number of its bags, and of those that its estimate is from.
        verdict, reasons: of its estimate, or why there is none.
        unlike: its deviations from the other robots, in words.
        distance: distance from the others, in standard deviations; None without others to compare with.
        changed: changes since an earlier run, in words.
        mass: mass of the identified links [kg].
    """

    name: str
    bags: int
    used: int
    verdict: str
    reasons: tuple[str, ...] = ()
    unlike: tuple[str, ...] = ()
    distance: float | None = None
    changed: tuple[str, ...] = ()
    mass: float | None = None

    @property
    def remarkable(self) -> tuple[bool, int, int, float]:
        """Sort key of robots: without a usable result, unlike the others, changed."""
        return self.verdict != USABLE, len(self.unlike), len(self.changed), self.distance or 0.0


@dataclass(frozen=True, kw_only=True)
class FleetPage:
    """Content of the page: the robots, the most remarkable first, bags that could not be used, and doubtful ones, each
    with the reason."""

    lines: Sequence[RobotLine]
    bad: Sequence[tuple[str, str]]
    doubtful: Sequence[tuple[str, str]]


def write_fleet_page(path: Path, page: FleetPage) -> None:
    """Write the page.

    Raises:
        GeomidError: the file cannot be written.
    """
    counts = {
        "differ from the others": sum(bool(line.unlike) for line in page.lines),
        "changed": sum(bool(line.changed) for line in page.lines),
        "not usable": sum(line.verdict != USABLE for line in page.lines),
        "bags that could not be read": len(page.bad),
    }
    write_page(path, "fleet.html.j2", {"page": page, "counts": counts})


WEAK = 0.5
"""Fraction of an effect's prior variance that the data removed; an effect below it is weakly identified."""

_GROUPS = (("c", "centre of mass"), ("I", "inertia"))
_KINDS = {"before": "URDF", "after": "identified"}


def write_identification_page(path: Path, file: EstimateFile, series: Sequence[Series] = ()) -> None:
    """Write the page of an ``estimate.json``, with its measured channels over time, if they are known.

    Raises:
        GeomidError: the file cannot be written.
    """
    links, effects = file.link_estimates, file.effect_estimates
    content = {
        "file": file,
        "uses": uses(file),
        "links": links,
        "quantity": Quantity,
        "end": _heaviest(file, links),
        "fit_bars": _bars(file),
        "kinds": _KINDS,
        "shares": {(effect.name, effect.joint): effect.from_data for effect in effects},
        "open": [link for link in links if link.cannot_tell or link.outlier],
        "not_identified": not_identified,
        "telling": {name: suggested_motions(motions) for name, motions in file.telling.items()},
        "weak": [(effect, effect_class(effect.name).settled_by) for effect in effects if effect.from_data < WEAK],
        "traces": traces(series),
        "script": Script.read(SCRIPT),
    }
    write_page(path, "identification.html.j2", content)


def _heaviest(file: EstimateFile, links: Sequence[LinkEstimate]) -> float:
    """End of the mass axis [kg], with room for all masses and for most intervals."""
    masses = [mass for link in links for mass in (file.urdf_masses[link.name], link.mass)]
    ends = [link.mass_interval[1] for link in links]
    return 1.05 * max(1e-9, min(max(ends, default=0.0), 3.0 * max(masses, default=0.0)), *masses)


def _bars(file: EstimateFile) -> Bars:
    """Residual RMS of the identified model relative to that of the URDF (100 %)."""
    ratios = {row.channel: row.ratio for row in file.channels if math.isfinite(row.ratio)}
    end = max(1.0, min(2.0, max(ratios.values(), default=1.0)))
    rows = [
        (name, "", {"before": ("100 %", 100.0 / end), "after": (percent(ratio), 100.0 * min(ratio / end, 1.0))})
        for name, ratio in ratios.items()
    ]
    return Bars(rows, [(f"{100 * share:.0f}", 100.0 * share / end) for share in ticks(0.0, 1.0, 4)], "RMS")


def uses(file: EstimateFile) -> list[str]:
    """List the uses of a result, in sentences."""
    if file.judgement.word != USABLE:
        return ["Do not use this result until the problem is corrected; the numbers below show where it is wrong."]
    return [*_predictions(file), *identified(file.link_estimates)]


def _predictions(file: EstimateFile) -> list[str]:
    rows = [row for row in file.channels if math.isfinite(row.ratio)]
    if not rows:
        return []
    alone = _span(row.file / row.urdf for row in rows)
    sentence = (
        f"Predicts efforts and wrenches of similar motions: on {file.judged_on}, {_span(row.ratio for row in rows)} of "
        f"the URDF's errors remain{f', in {file.description} alone {alone}' if alone else ''}."
    )
    judge = "No data were held out, so this is not a test on new data: give another recording with --validate."
    return [sentence, judge] if file.rms.held_out is None else [sentence]


def _span(ratios: Iterable[float]) -> str:
    """Range of ratios in percent; empty without any."""
    known = sorted(100.0 * ratio for ratio in ratios if math.isfinite(ratio))
    return f"{known[0]:.0f} to {known[-1]:.0f} %" if known else ""


def identified(links: Sequence[LinkEstimate]) -> list[str]:
    """List the identified quantities of links, in sentences."""
    masses = [link.name for link in links if "mass" in link.identified]
    moments = [_of_axes(link) for link in links if link.moments]
    inertias = [link.name for link in links if {*QUANTITIES[4:]} <= {*link.identified}]
    groups = {"mass": masses, "first moment": moments, "inertia": inertias}
    named = [f"{quantity} of {', '.join(names)}" for quantity, names in groups.items() if names]
    if not named:
        return ["Individually identified: none. Only combinations are identified; predictions are unaffected."]
    sentence = f"Identified from the data (95 % interval within ±20 %): {'; '.join(named)}."
    every = all(link.identified == QUANTITIES for link in links)
    return (
        [sentence] if every else [sentence, "All else is identified only in combination; predictions are unaffected."]
    )


def _of_axes(link: LinkEstimate) -> str:
    return link.name if len(link.moments) == len("xyz") else f"{link.name} ({', '.join(link.moments)})"


def not_identified(link: LinkEstimate) -> str:
    """List the quantities of a link that are not identified."""
    return cannot_tell([name for name in QUANTITIES if name not in link.identified])


def cannot_tell(quantities: Sequence[str]) -> str:
    """List :data:`QUANTITIES` that are not identified."""
    return "all" if len(quantities) == len(QUANTITIES) else grouped(quantities)


def grouped(quantities: Sequence[str]) -> str:
    """List :data:`QUANTITIES`; a complete group goes by its name."""
    parts = ["mass"] if "mass" in quantities else []
    for letter, name in _GROUPS:
        group = [quantity for quantity in QUANTITIES if quantity.startswith(letter)]
        present = [quantity for quantity in group if quantity in quantities]
        parts += [name] if len(present) == len(group) else present
    return ", ".join(parts)


def suggested_motions(motions: Mapping[str, Sequence[str]]) -> list[str]:
    """List the motions that would identify the open quantities of a link, in sentences.

    Args:
        motions: the quantities that each motion would identify; under an empty name those that none would.
    """
    sentences = [f"{grouped(quantities)}: {motion}" for motion, quantities in motions.items() if motion]
    rest = motions.get("", ())
    if rest:
        sentences.append(f"{grouped(rest)}: none of the simulated motions")
    return sentences
