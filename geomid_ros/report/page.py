"""What pages share: the frame that they are written in, tables of bars, numbers, and what is drawn as SVG."""

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
from geomid_ros.report.colours import BEFORE, IDENTIFIED, INERTIAS_ONLY, MEASURED
from geomid_ros.types import FloatArray, IntArray

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

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
    """A page, all of whose content is escaped.

    Args:
        template: name of its template in this folder.
        content: what the template shows.
    """
    return _templates().get_template(template).render(colors=_COLORS, **content)


@cache
def _templates() -> Environment:
    """Those of this folder. They are kept: to compile one takes longer than to fill it in."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415 of pages alone

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
    """A name whose lines may end behind an underscore, and not in the midst of a word, where a column is narrow."""
    from markupsafe import Markup, escape  # noqa: PLC0415 as above

    return escape(name).replace("_", Markup("_<wbr>"))


@dataclass(frozen=True)
class Script:
    """A script of this package as it stands on a page: its ``text``, and the ``hash`` by which the page's policy lets
    it run and no other."""

    text: str
    hash: str

    @staticmethod
    def read(name: str) -> Script:
        """The script of this name in this folder."""
        text = (_FOLDER / name).read_text(encoding="utf-8")
        return Script(text, f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}")


Bar = tuple[str, float]
"""What is written beside a bar, and the bar's length in percent of the axis."""


@dataclass(frozen=True)
class Bars:
    """Bars for a table: ``rows`` of a name, a note and bars by kind; ``ticks`` of the axis are labels and where they
    are, in percent of its length; ``heading`` of what is written beside the bars."""

    rows: Sequence[tuple[str, str, Mapping[str, Bar]]]
    ticks: Sequence[tuple[str, float]]
    heading: str

    @staticmethod
    def of_gaps(rows: Iterable[tuple[str, str, Mapping[str, float]]]) -> Bars:
        """Bars from 1 (the floor) on, logarithmic, on an axis on which the longest has room."""
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


def round_step(least: float) -> float:
    """The smallest round number that is not less."""
    power = 10.0 ** np.floor(np.log10(least))
    return float(power * _ROUND[np.searchsorted(_ROUND, 0.999 * least / power)])


def ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers at equal distances between two ends, of which they leave ``most`` intervals or fewer."""
    step = round_step((high - low) / most)
    whole = np.arange(np.ceil(low / step), np.floor(high / step) + 1.0)
    found: list[float] = (step * whole + 0.0).tolist()  # + 0: zero has no sign
    return found


_FAR = 1e5  # units of a path beyond which nothing is drawn


def line_path(x: FloatArray, y: FloatArray) -> str:
    """The path of a line in whole units that is broken where it is NaN."""
    breaks = np.flatnonzero(np.isnan(x) | np.isnan(y))
    runs = np.split(np.column_stack([x, y]), breaks)
    known = (run[np.all(np.isfinite(run), axis=1)] for run in runs)
    return "".join("M" + " ".join(map(str, _whole(run).ravel().tolist())) for run in known if len(run))


def dots_path(x: FloatArray, y: FloatArray) -> str:
    """The path of dots in whole units, to be drawn with round ends; none where a value is NaN."""
    dots = np.column_stack([x, y])
    places = _whole(dots[np.all(np.isfinite(dots), axis=1)])
    return "".join(f"m{right} {down}h0" for right, down in np.diff(places, axis=0, prepend=0).tolist())


def _whole(values: FloatArray) -> IntArray:
    return np.rint(np.clip(values, -_FAR, _FAR)).astype(np.int64)


def number(value: float) -> str:
    """Three digits, with an exponent only where it is shorter."""
    if not np.isfinite(value):
        return NONE
    if value == 0.0:
        return "0"
    magnitude = int(np.floor(np.log10(abs(value))))
    if magnitude < -3 or magnitude > 4:
        mantissa, exponent = f"{value:.1e}".split("e")
        return f"{mantissa}e{int(exponent)}"
    return f"{value:.{max(2 - magnitude, 0)}f}"
