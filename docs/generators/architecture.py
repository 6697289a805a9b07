"""Draws the ways of a message and of a bag through the package; with ``--check`` it only says whether that is stale."""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from html import escape
from pathlib import Path

ROOT = Path(__file__).parents[2]
PICTURE = ROOT / "docs/pages/figures/architecture.svg"

_WIDTH, _HEIGHT, _GAP, _MARGIN = 214, 74, 34, 20
_LINE = 16
_COLORS = {"node": "#d7e6f5", "bag": "#e4efd9", "both": "#f1f1ee"}
_INK, _FAINT = "#1a1a1a", "#6b7075"
_TIP = (
    '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
    f'<path d="M0 0L8 4L0 8z" fill="{_FAINT}"/></marker></defs>'
)


@dataclass(frozen=True)
class Station:
    """Where a message passes: its ``module``, what is done there in at most two lines, at a ``column`` and a ``row`` of
    the picture; who passes it, and the modules that it ``goes_to``."""

    module: str
    does: tuple[str, ...]
    column: int
    row: float
    who: str = "both"
    goes_to: tuple[str, ...] = ()


STATIONS = (
    Station("ros.inputs", ("receives and counts", "messages"), 0, 0, "node", ("live.threads",)),
    Station("live.threads", ("a queue: no message", "waits for a solve"), 1, 0, "node", ("live.worker",)),
    Station("live.worker", ("a thread that turns", "messages into rows"), 2, 0, "node", ("signals.messages",)),
    Station("files.bags.bag", ("reads mcap and db3,", "also truncated files"), 0, 1, "bag", ("session.recordings",)),
    Station("session.recordings", ("splits bags: training", "and held-out parts"), 1, 1, "bag", ("signals.messages",)),
    Station("signals.messages", ("bytes to blocks of", "numbers"), 2, 1, goes_to=("signals.pipeline",)),
    Station(
        "signals.pipeline", ("admits messages, counts", "the refused by reason"), 2, 2, goes_to=("signals.sampler",)
    ),
    Station("signals.sampler", ("aligns, filters,", "differentiates"), 1, 2, goes_to=("model.samples",)),
    Station(
        "model.samples",
        ("motion and efforts at", "common times"),
        0,
        2,
        goes_to=("checks.recording_check", "model.measurement_model"),
    ),
    Station("checks.recording_check", ("is this recording this", "robot's?"), 0, 3, goes_to=("checks.verdict",)),
    Station(
        "model.measurement_model",
        ("rows: each channel is", "linear in all unknowns"),
        1,
        3,
        goes_to=("estimation.summary",),
    ),
    Station(
        "estimation.summary", ("triangular factors:", "bounded memory"), 2, 3, goes_to=("estimation.effect_selection",)
    ),
    Station(
        "estimation.effect_selection",
        ("selects the effects", "that the rows support"),
        2,
        4,
        goes_to=("estimation.fit",),
    ),
    Station("estimation.fit", ("bodies that can exist,", "near what was known"), 1, 4, goes_to=("checks.verdict",)),
    Station(
        "checks.verdict",
        ("can it be used, and", "for what?"),
        0,
        4,
        goes_to=("ros.outputs", "files.models.estimate_file"),
    ),
    Station("ros.outputs", ("inertias, diagnostics,", "gaps on topics"), 0, 5, "node"),
    Station("files.models.estimate_file", ("estimate.json, URDF,", "MJCF, posterior, page"), 1, 5),
)


def drawn() -> str:
    """The picture as SVG."""
    width = 2 * _MARGIN + 3 * _WIDTH + 2 * 2 * _GAP
    height = 2 * _MARGIN + 6 * _HEIGHT + 5 * _GAP + 2 * _LINE
    places = {station.module: _place(station) for station in STATIONS}
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height:g}" font-family="sans-serif">',
        _TIP,
        f'<rect width="{width}" height="{height:g}" fill="white"/>',
        *(_arrow(places[s.module], places[other]) for s in STATIONS for other in s.goes_to),
        *(part for station in STATIONS for part in _box(station, places[station.module])),
        *_legend(height),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _place(station: Station) -> tuple[float, float]:
    """The middle of a station."""
    across = _MARGIN + station.column * (_WIDTH + 2 * _GAP) + _WIDTH / 2
    return across, _MARGIN + station.row * (_HEIGHT + _GAP) + _HEIGHT / 2


def _box(station: Station, at: tuple[float, float]) -> list[str]:
    x, y = at
    top = y - _HEIGHT / 2
    frame = f'x="{x - _WIDTH / 2:g}" y="{top:g}" width="{_WIDTH}" height="{_HEIGHT}" rx="6"'
    lines = [
        f'<rect {frame} fill="{_COLORS[station.who]}" stroke="{_FAINT}"/>',
        _text(x, top + 1.3 * _LINE, station.module.replace(".", "/"), weight="bold"),
    ]
    return [*lines, *(_text(x, top + (2.6 + k) * _LINE, line) for k, line in enumerate(station.does))]


def _arrow(start: tuple[float, float], end: tuple[float, float]) -> str:
    """From the edge of one box to that of another beside or below it."""
    (x, y), (right, down) = start, end
    if y == down:
        side = _WIDTH / 2 if right > x else -_WIDTH / 2
        line = f"M{x + side:g} {y:g}H{right - side:g}"
    else:
        y, down = y + _HEIGHT / 2, down - _HEIGHT / 2
        line = f"M{x:g} {y:g}V{y + _GAP / 2:g}H{right:g}V{down:g}"
    return f'<path d="{line}" stroke="{_FAINT}" fill="none" marker-end="url(#tip)"/>'


def _legend(height: float) -> list[str]:
    said = (("node", "of a node alone"), ("bag", "of a bag alone"), ("both", "of both: one path"))
    parts = []
    for place, (who, text) in enumerate(said):
        left, top = _MARGIN + place * (_WIDTH + 2 * _GAP), height - _MARGIN - 14
        parts += [
            f'<rect x="{left}" y="{top:g}" width="14" height="14" fill="{_COLORS[who]}" stroke="{_FAINT}"/>',
            _text(left + 22, top + 12, text, anchor="start"),
        ]
    return parts


def _text(x: float, y: float, text: str, *, weight: str = "normal", anchor: str = "middle") -> str:
    return (
        f'<text x="{x:g}" y="{y:g}" font-size="13" font-weight="{weight}" text-anchor="{anchor}" '
        f'fill="{_INK}">{escape(text)}</text>'
    )


def main() -> None:
    """Write the picture, or say whether it is stale."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; fail if the picture is stale")
    picture = drawn()
    if not parser.parse_args().check:
        PICTURE.write_text(picture, encoding="utf-8")
    elif PICTURE.read_text(encoding="utf-8") != picture:
        sys.exit(f"{PICTURE} is stale; run make docs")


if __name__ == "__main__":
    main()
