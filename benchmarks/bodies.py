"""Bodies as the ellipsoids of constant density with their inertia, seen from the front: Fig. 4 and Fig. 5."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from benchmarks.problem import Problem
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import FloatArray

_SPAN = 1.0  # of the colours, in decades of the mass ratio to either side
_COLOURS = colormaps["RdBu_r"]
_SHARE = 5.0  # a uniform ellipsoid of semi-axes s has the covariance s^2/5


def draw_bodies(problem: Problem, frames: FloatArray, results: Sequence[tuple[str, FloatArray]]) -> Figure:
    """One view per result, the bodies placed in ``frames (links, 4, 4)`` and coloured by mass over the prior's."""
    figure = Figure(figsize=(3.0 * len(results) + 0.9, 4.3), layout="constrained")
    panels = figure.subplots(1, len(results), sharex=True, sharey=True)
    outline = _placed(problem, frames, problem.prior)
    wide = _widest_plane(np.array([centre for centre, _ in outline]))
    prior_masses = problem.prior[: 10 * problem.manifold.links : 10]
    for panel, (name, parameters) in zip(np.atleast_1d(panels), results, strict=True):
        masses = parameters[: 10 * problem.manifold.links : 10]
        ratios = np.log10(np.maximum(masses / prior_masses, 1e-9))
        for (centre, covariance), ratio in zip(_placed(problem, frames, parameters), ratios, strict=True):
            colour = _COLOURS(0.5 + 0.5 * np.clip(ratio / _SPAN, -1.0, 1.0))
            _ellipse(panel, centre[wide], covariance[np.ix_(wide, wide)], facecolor=colour, alpha=0.85)
        for centre, covariance in outline:
            _ellipse(panel, centre[wide], covariance[np.ix_(wide, wide)], fill=False, linestyle=":", linewidth=0.7)
        panel.set_title(name, fontsize=10)
        panel.set_aspect("equal")
        panel.autoscale_view()
        panel.tick_params(labelsize=7)
    scale = ScalarMappable(Normalize(-_SPAN, _SPAN), _COLOURS)
    bar = figure.colorbar(scale, ax=panels, shrink=0.7, ticks=[-1.0, -0.5, 0.0, 0.5, 1.0])
    bar.set_ticklabels(["0.1", "0.3", "1", "3", "10"])
    bar.set_label("mass / prior's mass")
    figure.supxlabel("dotted: the prior [m]", fontsize=9)
    return figure


def _placed(problem: Problem, frames: FloatArray, parameters: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Centre and squared semi-axes' matrix of every link in the world; flat where the body cannot exist."""
    bodies = parameters[problem.manifold.inertial].reshape(-1, 10)
    semi_axes, axes = pseudo_inertia.equivalent_ellipsoid(bodies)
    placed = []
    for frame, body, sizes, directions in zip(frames, bodies, semi_axes, axes, strict=True):
        turned = frame[:3, :3] @ directions
        centre = frame[:3, :3] @ pseudo_inertia.centre_of_mass(body) + frame[:3, 3]
        placed.append((centre, (turned * sizes**2) @ turned.T))
    return placed


def _widest_plane(centres: FloatArray) -> list[int]:
    """The two axes of the world along which the bodies are spread most, the longest upwards."""
    order = np.argsort(np.ptp(centres, axis=0))
    return [int(order[1]), int(order[2])]


def _ellipse(panel: Axes, centre: FloatArray, covariance: FloatArray, **style: object) -> None:
    """The outline of an ellipsoid: the ellipse of the projected matrix of squared semi-axes."""
    values, vectors = np.linalg.eigh(covariance)
    widths = 2.0 * np.sqrt(np.maximum(values, 1e-8))
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    panel.add_patch(Ellipse(tuple(centre), widths[1], widths[0], angle=angle, edgecolor="black", **style))
