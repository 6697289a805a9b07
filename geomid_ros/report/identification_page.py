"""``report.html`` of an identification: whether it can be used and for what, and all that is known of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geomid_ros.estimation.estimate import LinkEstimate
from geomid_ros.files.models.estimate_file import ChannelEntry, EstimateFile
from geomid_ros.model.effects import Quantity, effect_class
from geomid_ros.report import identification_words
from geomid_ros.report.gap_words import percent
from geomid_ros.report.page import Bars, Script, number, ticks, write_page
from geomid_ros.report.series import SCRIPT, Series, traces

_KINDS = {"before": "URDF", "after": "identified"}


@dataclass(frozen=True, eq=False)
class IdentificationPage:
    """What the page is made of: what ``estimate.json`` says, and the measured channels over time, if they are known."""

    file: EstimateFile
    series: Sequence[Series] = ()


def write_identification_page(path: Path, page: IdentificationPage) -> None:
    """Write the page.

    Raises:
        GeomidError: the file cannot be written.
    """
    file, verdict = page.file, page.file.judgement
    links, effects = file.link_estimates, file.effect_estimates
    content = {
        "file": file,
        "verdict": verdict,
        "written": file.description,
        "effects": file.known_effects,
        "uses": identification_words.uses(file),
        "judged_on": file.judged_on,
        "links": list(_links(file, links)),
        "end": _heaviest(file, links),
        "fit": _fit(file),
        "fit_bars": _bars(file),
        "kinds": _KINDS,
        "shares": {(effect.name, effect.joint): effect.from_data for effect in effects},
        "open": [link for link in links if link.cannot_tell or link.outlier],
        "cannot_tell": identification_words.cannot_tell,
        "telling": {name: identification_words.telling(motions) for name, motions in file.telling.items()},
        "weak": [
            (effect, effect_class(effect.name).settled_by)
            for effect in effects
            if effect.from_data < identification_words.WEAK
        ],
        "traces": traces(page.series),
        "script": Script.read(SCRIPT),
    }
    write_page(path, "identification.html.j2", content)


def _links(file: EstimateFile, links: Sequence[LinkEstimate]) -> Iterator[dict[str, Any]]:
    """Of every link: its mass in the URDF and as identified, and where that lies with 95 % probability."""
    for link in links:
        yield {
            "name": link.name,
            "merged": link.merged,
            "nominal": file.urdf_masses[link.name],
            "mass": Quantity(link.mass, link.std_mass, "kg"),
            "value": link.mass,
            "ends": link.mass_interval,
            "from_data": link.from_data,
            "distance": link.distance_from_prior,
            "known": "mass" in link.identified,
        }


def _heaviest(file: EstimateFile, links: Sequence[LinkEstimate]) -> float:
    """The end of the axis of masses [kg]: there is room for all masses, and for most intervals."""
    masses = [mass for link in links for mass in (file.urdf_masses[link.name], link.mass)]
    ends = [link.mass_interval[1] for link in links]
    return 1.05 * max(1e-9, min(max(ends, default=0.0), 3.0 * max(masses, default=0.0)), *masses)


def _fit(file: EstimateFile) -> Iterator[tuple[ChannelEntry, tuple[str, ...], float]]:
    """RMS per channel of the URDF, of the identified model, of the written file alone and with the errors of sensors
    beside it; and the share of the URDF's that the identified model explains."""
    for row in file.channels:
        errors = (row.urdf, row.identified, row.file, row.file_with_offsets)
        yield row, tuple(map(number, errors)), 1.0 - row.ratio


def _bars(file: EstimateFile) -> Bars:
    """RMS of the identified model beside that of the URDF, which is 100 %."""
    ratios = {row.channel: row.ratio for row in file.channels if math.isfinite(row.ratio)}
    end = max(1.0, min(2.0, max(ratios.values(), default=1.0)))
    rows = [
        (name, "", {"before": ("100 %", 100.0 / end), "after": (percent(ratio), 100.0 * min(ratio / end, 1.0))})
        for name, ratio in ratios.items()
    ]
    return Bars(rows, [(f"{100 * share:.0f}", 100.0 * share / end) for share in ticks(0.0, 1.0, 4)], "RMS")
