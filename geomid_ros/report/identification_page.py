"""``report.html`` of an identification: whether it can be used and for what, and all that is known of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geomid_ros.estimation.estimate import LinkEstimate
from geomid_ros.files.models.estimate_file import EstimateFile, HandoverEntry
from geomid_ros.model.effects import Quantity, effect_class
from geomid_ros.report import identification_words
from geomid_ros.report.gap_words import percent
from geomid_ros.report.page import Bars, Script, number, ticks, write_page
from geomid_ros.report.series import ChannelFit, Series
from geomid_ros.report.traces import SCRIPT, traces

_KINDS = {"before": "URDF", "after": "identified"}


@dataclass(frozen=True, eq=False)
class IdentificationPage:
    """What the page is made of.

    Attributes:
        file: what ``estimate.json`` says.
        series: the measured channels on what is judged on: over time, or how well they fit alone.
    """

    file: EstimateFile
    series: Sequence[ChannelFit]

    @property
    def held_out(self) -> bool:
        """Whether what is judged on was held out."""
        return self.file.rms.held_out is not None

    @property
    def masses(self) -> list[float]:
        """Masses of the links in the URDF [kg]."""
        return [self.file.urdf_masses[link.name] for link in self.file.links]

    @property
    def written(self) -> HandoverEntry:
        """The description that is written, and RMS of what it leaves."""
        own = (entry for entry in self.file.handover.values() if entry.file)
        return next(own, HandoverEntry(links=(), effects=(), file="identified.urdf"))


def write_identification_page(path: Path, page: IdentificationPage) -> None:
    """Write the page.

    Raises:
        GeomidError: the file cannot be written.
    """
    verdict, links, effects = page.file.judgement, page.file.link_estimates, page.file.effect_estimates
    content = {
        "file": page.file,
        "verdict": verdict,
        "written": page.written.file,
        "effects": page.file.known_effects,
        "uses": identification_words.uses(verdict, links, page.series, page.held_out),
        "judged_on": "held-out data" if page.held_out else "the fitted data",
        "links": list(_links(page, links)),
        "end": _heaviest(page, links),
        "fit": _fit(page),
        "fit_bars": _bars(page.series),
        "kinds": _KINDS,
        "shares": {(effect.name, effect.joint): effect.from_data for effect in effects},
        "open": [link for link in links if link.cannot_tell or link.outlier],
        "cannot_tell": identification_words.cannot_tell,
        "telling": {name: identification_words.telling(motions) for name, motions in page.file.telling.items()},
        "weak": [
            (effect, effect_class(effect.name).settled_by)
            for effect in effects
            if effect.from_data < identification_words.WEAK
        ],
        "traces": traces([channel for channel in page.series if isinstance(channel, Series)]),
        "script": Script.read(SCRIPT),
    }
    write_page(path, "identification.html.j2", content)


def _links(page: IdentificationPage, links: Sequence[LinkEstimate]) -> Iterator[dict[str, Any]]:
    """Of every link: its mass in the URDF and as identified, and where that lies with 95 % probability."""
    for link, nominal in zip(links, page.masses, strict=True):
        yield {
            "name": link.name,
            "merged": link.merged,
            "nominal": nominal,
            "mass": Quantity(link.mass, link.std_mass, "kg"),
            "value": link.mass,
            "ends": link.mass_interval,
            "from_data": link.from_data,
            "distance": link.distance_from_prior,
            "known": "mass" in link.identified,
        }


def _heaviest(page: IdentificationPage, links: Sequence[LinkEstimate]) -> float:
    """The end of the axis of masses [kg]: there is room for all masses, and for most intervals."""
    masses: list[float] = [*page.masses, *(link.mass for link in links)]
    ends = [link.mass_interval[1] for link in links]
    return 1.05 * max(1e-9, min(max(ends, default=0.0), 3.0 * max(masses, default=0.0)), *masses)


def _fit(page: IdentificationPage) -> Iterator[tuple[ChannelFit, tuple[str, ...], float]]:
    """RMS per channel of the URDF, of the identified model, of the written file alone and with the errors of sensors
    beside it; and the share of the URDF's that the identified model explains."""
    for channel in page.series:
        written = [each.get(channel.name, math.nan) for each in (page.written.alone, page.written.corrected)]
        yield channel, tuple(map(number, (*channel.rms, *written))), 1.0 - channel.ratio


def _bars(series: Sequence[ChannelFit]) -> Bars:
    """RMS of the identified model beside that of the URDF, which is 100 %."""
    ratios = {channel.name: channel.ratio for channel in series if math.isfinite(channel.ratio)}
    end = max(1.0, min(2.0, max(ratios.values(), default=1.0)))
    rows = [
        (name, "", {"before": ("100 %", 100.0 / end), "after": (percent(ratio), 100.0 * min(ratio / end, 1.0))})
        for name, ratio in ratios.items()
    ]
    return Bars(rows, [(f"{100 * share:.0f}", 100.0 * share / end) for share in ticks(0.0, 1.0, 4)], "RMS")
