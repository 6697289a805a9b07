"""Common parts of the pages: templates, tables of bars, numbers, SVG paths, and the colours of pages and pictures.

The colours of text, light and dark, are in ``page.html.j2``. Black is measured, grey is the URDF, and colour is
identified: links by ``SHARES``, lines and dots by ``IDENTIFIED``. For colour-blind readers: vermilion and blue by Okabe
and Ito; lines also differ in their dashes.
"""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomid_ros.files.disk import write_text
from geomid_ros.report import gap_words
from geomid_ros.types import FloatArray, IntArray

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup


INK, FAINT = "#1a1a1a", "#6b7075"
MEASURED = INK
URDF, BEFORE, INERTIAS_ONLY, IDENTIFIED = "#9a9fa5", "#7d848a", "#0072b2", "#d55e00"
DOUBT = "#b3261e"
GRID, FLOOR, FRAME, STICKS = "#eceeef", "#e9edf0", "#c8cbce", "#3c4043"
SHARES = ("#dcdcd8", "#9ad3c4", "#41b0c4", "#1d70b2", "#1f2a80")
"""Scale of the fraction from data, from 0 to 1."""


NONE = "—"
_FOLDER = Path(__file__).parent
_FILTERS = ("compared", "headline", "place", "title", "ratio", "percent", "measured", "measured_angle", "interval")
_COLORS = {"measured": MEASURED, "before": BEFORE, "inertias_only": INERTIAS_ONLY, "after": IDENTIFIED}
_FINE_TICKS, _TICKS = (1.0, 2.0, 5.0, 10.0, 20.0), (1.0, 10.0, 100.0, 1000.0, 10_000.0)


def write_page(path: Path, template: str, content: Mapping[str, Any]) -> None:
    """Write a page, see :func:`rendered_page`, as the file ``path``.

    Raises:
        GeomidError: the file cannot be written.
    """
    write_text(path, rendered_page(template, content))


def rendered_page(template: str, content: Mapping[str, Any]) -> str:
    """Render a page; all its content is escaped.

    Args:
        template: name of its template in this folder.
        content: values that the template shows.
    """
    return _templates().get_template(template).render(colors=_COLORS, **content)


@cache
def _templates() -> Environment:
    """Templates of this folder, cached because compiling one takes longer than rendering it."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415 only pages need it

    environment = Environment(
        loader=FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {name: getattr(gap_words, name) for name in _FILTERS} | {
        "breakable": _breakable,
        "number": number,
    }
    return environment


def _breakable(name: str) -> Markup:
    """Allow line breaks after the underscores of a name, so that a narrow column does not break it within a word."""
    from markupsafe import Markup, escape  # noqa: PLC0415 as above

    return escape(name).replace("_", Markup("_<wbr>"))


@dataclass(frozen=True)
class Script:
    """Script of this package on a page: its ``text``, and the ``hash`` by which the page's content security policy
    permits only this script."""

    text: str
    hash: str

    @staticmethod
    def read(name: str) -> Script:
        """Read a script in this folder."""
        text = (_FOLDER / name).read_text(encoding="utf-8")
        return Script(text, f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}")


Bar = tuple[str, float]
"""Text beside a bar, and the bar's length in percent of the axis."""


@dataclass(frozen=True)
class Bars:
    """Bars of a table: ``rows`` of name, note and bars by kind; ``ticks`` of the axis as labels and positions in
    percent of its length; ``heading`` of the column of texts beside the bars."""

    rows: Sequence[tuple[str, str, Mapping[str, Bar]]]
    ticks: Sequence[tuple[str, float]]
    heading: str

    @staticmethod
    def of_gaps(rows: Iterable[tuple[str, str, Mapping[str, float]]]) -> Bars:
        """Logarithmic bars that begin at 1 (the floor), on an axis that fits the longest."""
        rows = list(rows)
        largest = max((v for _, _, values in rows for v in values.values() if math.isfinite(v)), default=0.0)
        end = max(2.0, 1.1 * largest)

        def length(value: float) -> float:
            return 100.0 * math.log(max(value, 1.0)) / math.log(end) if math.isfinite(value) else 0.0

        ticks = [(f"{tick:g}", length(tick)) for tick in (_FINE_TICKS if end < 30.0 else _TICKS) if tick <= end]
        bars = [
            (name, note, {kind: (gap_words.ratio(value), length(value)) for kind, value in values.items()})
            for name, note, values in rows
        ]
        return Bars(bars, ticks, "gap")


_ROUND = np.array([1.0, 2.0, 2.5, 5.0, 10.0])


def ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers at equal distances between two ends, at most ``most`` intervals."""
    least = (high - low) / most
    power = 10.0 ** np.floor(np.log10(least))
    step = power * _ROUND[np.searchsorted(_ROUND, 0.999 * least / power)]
    multiples = np.arange(np.ceil(low / step), np.floor(high / step) + 1.0)
    values: list[float] = (step * multiples + 0.0).tolist()  # + 0: zero has no sign
    return values


_FAR = 1e5  # [units of a path] coordinates are clipped there


def line_path(x: FloatArray, y: FloatArray) -> str:
    """Path of a line in integer units, broken at NaN."""
    breaks = np.flatnonzero(np.isnan(x) | np.isnan(y))
    runs = np.split(np.column_stack([x, y]), breaks)
    finite = (run[np.all(np.isfinite(run), axis=1)] for run in runs)
    return "".join("M" + " ".join(map(str, _whole(run).ravel().tolist())) for run in finite if len(run))


def _whole(values: FloatArray) -> IntArray:
    return np.rint(np.clip(values, -_FAR, _FAR)).astype(np.int64)


def number(value: float) -> str:
    """Format with three digits or more; below 1e-3 and from 1e5 on, with two digits and an exponent."""
    if not np.isfinite(value):
        return NONE
    if value == 0.0:
        return "0"
    magnitude = int(np.floor(np.log10(abs(value))))
    if magnitude < -3 or magnitude > 4:
        mantissa, exponent = f"{value:.1e}".split("e")
        return f"{mantissa}e{int(exponent)}"
    return f"{value:.{max(2 - magnitude, 0)}f}"
