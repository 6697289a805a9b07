"""(a) Fig. 2: geodesic distances and a geodesic between densities in the plane."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from benchmarks.report import Report
from geomid_ros.geometry import spd
from geomid_ros.types import FloatArray

_COVARIANCE = np.diag([1.0, 0.15])
_DIRECTIONS = (0.0, 30.0, 60.0, 90.0)  # degrees from the major axis
_DISPLACEMENTS = np.linspace(0.0, 3.0, 61)
_COLOURS = colormaps["viridis"](np.linspace(0.0, 0.85, len(_DIRECTIONS)))
_STEPS = 9


def run(report: Report) -> None:
    """The distances as a table, both pictures as one."""
    curves = np.array([[_displaced(angle, by) for by in _DISPLACEMENTS] for angle in _DIRECTIONS])
    path = _geodesic()
    report.picture("fig2_planar_densities", _draw(curves, path))
    chosen = [20, 40, 60]
    named = zip(_DIRECTIONS, curves, strict=True)
    rows = [[f"{angle:.0f} deg", *(f"{curve[k]:.3f}" for k in chosen)] for angle, curve in named]
    headings = ["displaced along", *(f"distance at {_DISPLACEMENTS[k]:.0f}" for k in chosen)]
    caption = "Same mass and covariance diag(1, 0.15), centres apart. Angles from the major axis: along it is nearest."
    report.table("(a) Planar densities, Fig. 2", headings, rows, caption)
    report.result(
        "planar",
        {
            "displacements": _DISPLACEMENTS.tolist(),
            "distances": {f"{angle:.0f}": curve.tolist() for angle, curve in zip(_DIRECTIONS, curves, strict=True)},
            "geodesic_centres": [_centre(p).tolist() for p in path],
        },
    )


def _density(centre: FloatArray, covariance: FloatArray) -> FloatArray:
    """Pseudo-inertia ``(3, 3)`` of a unit mass in the plane."""
    pseudo = np.ones((3, 3))
    pseudo[:2, :2] = covariance + np.outer(centre, centre)
    pseudo[:2, 2] = pseudo[2, :2] = centre
    return pseudo


def _direction(degrees: float) -> FloatArray:
    return np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])


def _displaced(degrees: float, by: float) -> float:
    here = _density(np.zeros(2), _COVARIANCE)
    return float(spd.distance(here, _density(by * _direction(degrees), _COVARIANCE)))


def _geodesic() -> list[FloatArray]:
    turn = np.column_stack([_direction(60.0), _direction(150.0)])
    first = _density(np.zeros(2), _COVARIANCE)
    last = _density(np.array([4.0, 1.5]), turn @ _COVARIANCE @ turn.T)
    root = scipy.linalg.sqrtm(first)
    velocity = scipy.linalg.logm(spd.congruence(np.linalg.inv(root), last))
    return [spd.congruence(root, spd.sym_exp(t * velocity)) for t in np.linspace(0.0, 1.0, _STEPS)]


def _centre(pseudo: FloatArray) -> FloatArray:
    centre: FloatArray = pseudo[:2, 2] / pseudo[2, 2]
    return centre


def _draw(curves: FloatArray, path: list[FloatArray]) -> Figure:
    figure = Figure(figsize=(13.0, 4.0), layout="constrained")
    places, distances, geodesic = figure.subplots(1, 3)
    _ellipse(places, _density(np.zeros(2), _COVARIANCE), "black", 0.4)
    for angle, colour in zip(_DIRECTIONS, _COLOURS, strict=True):
        _ellipse(places, _density(2.0 * _direction(angle), _COVARIANCE), colour, 0.4)
    places.set_title("displaced by 2, in four directions")
    for angle, curve, colour in zip(_DIRECTIONS, curves, _COLOURS, strict=True):
        distances.plot(_DISPLACEMENTS, curve, color=colour, label=f"{angle:.0f}° from the major axis")
    distances.set(xlabel="displacement", ylabel="geodesic distance", title="(a) distance from the black one")
    distances.legend()
    distances.grid(alpha=0.3)
    for step, pseudo in enumerate(path):
        ends = step in (0, len(path) - 1)
        _ellipse(geodesic, pseudo, "tab:green" if ends else "tab:gray", 0.8 if ends else 0.25)
    centres = np.array([_centre(p) for p in path])
    geodesic.plot(centres[:, 0], centres[:, 1], "k.-", linewidth=1.0)
    geodesic.set_title("(b) the geodesic between the green ones")
    for panel in (places, geodesic):
        panel.set_aspect("equal")
        panel.autoscale_view()
        panel.grid(alpha=0.3)
    return figure


def _ellipse(panel: Axes, pseudo: FloatArray, colour: object, alpha: float) -> None:
    """The ellipse of one standard deviation."""
    centre = _centre(pseudo)
    values, vectors = np.linalg.eigh(pseudo[:2, :2] / pseudo[2, 2] - np.outer(centre, centre))
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    widths = 2.0 * np.sqrt(values)
    panel.add_patch(
        Ellipse(tuple(centre), widths[1], widths[0], angle=angle, facecolor=colour, edgecolor="black", alpha=alpha)
    )


if __name__ == "__main__":
    run(Report())
