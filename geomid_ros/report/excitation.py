"""A designed motion on disk: trajectory, picture, page and report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from geomid_ros.estimation.estimate import QUANTITIES
from geomid_ros.excitation.learning import Expected
from geomid_ros.files.disk import make_folder, write_json
from geomid_ros.files.trajectories import write_bag, write_csv, write_yaml
from geomid_ros.report.motion_page import write_motion_page
from geomid_ros.report.sheet import DPI, FAINT, IDENTIFIED, INK, write_picture
from geomid_ros.session.excitation import Excitation
from geomid_ros.types import FloatArray

FORMAT = 1
_ROW_HEIGHT, _WIDTH = 1.5, 12.0  # [inch]


def save(found: Excitation, folder: Path) -> list[Path]:
    """Write all files of a motion into a folder; returns their paths. Raises GeomidError naming a file."""
    make_folder(folder)
    names = ("trajectory.yaml", "trajectory.csv", "trajectory_bag", "excitation.json", "excitation.png", "motion.html")
    yaml, csv, bag, document, picture, page = (folder / name for name in names)
    trajectory = found.trajectory
    write_yaml(yaml, trajectory)
    write_csv(csv, trajectory)
    write_bag(bag, trajectory)
    write_json(document, excitation_document(found))
    write_picture(picture, motion_figure(found))
    write_motion_page(page, found)
    return [yaml, csv, bag, document, picture, page]


def excitation_document(found: Excitation) -> dict[str, Any]:
    """The report of limits, margins, clearances and what is expected, for programs."""
    feasibility, margins, limits = found.task.feasibility, found.margins, found.task.feasibility.limits
    kinds = ("velocity", "acceleration", "jerk", "effort")
    posterior, learning = found.task.knowledge.posterior, found.learning
    stages = {name: getattr(learning, name) for name in ("before", "designed", "random", "twice", "random_twice")}
    return {
        "format": FORMAT,
        "period": found.motion.form.period,
        "repeats": found.motion.form.repeats,
        "start": _by(feasibility.names, found.motion.start),
        "limits": {kind: _by(feasibility.names, getattr(limits, kind)) for kind in kinds},
        "used": {kind: _by(feasibility.names, getattr(margins, kind)) for kind in kinds},
        "to_position_limit": _by(feasibility.names, margins.position),
        "distances": [
            {"first": pair.first, "second": pair.second, "at_least": float(distance), "clearance": float(clearance)}
            for pair, distance, clearance in zip(
                feasibility.collision.pairs if feasibility.collision else (),
                margins.distance,
                feasibility.clearances,
                strict=True,
            )
        ],
        "not_watched": [[pair.first, pair.second] for pair in found.task.not_watched],
        "expected": {
            name: {
                "error": stage.error,
                "links": {
                    link: dict(zip(QUANTITIES, own.tolist(), strict=True))
                    for link, own in zip(posterior.links, stage.links, strict=True)
                },
                "effects": _effects(found, stage),
            }
            for name, stage in stages.items()
        },
        "decisions": [
            {"found": d.found, "rival": d.rival, "difference": d.difference, "random": d.random}
            for d in found.decisions
        ],
        "notes": list(found.task.notes),
    }


def _effects(found: Excitation, stage: Expected) -> list[dict[str, Any]]:
    return [
        {"name": effect.name, "place": effect.place, "parameter": effect.parameter, "std": float(std)}
        for effect, std in zip(found.task.knowledge.posterior.effects, stage.effects, strict=True)
    ]


def _by(names: tuple[str, ...], values: FloatArray) -> dict[str, float | None]:
    return {name: value if np.isfinite(value) else None for name, value in zip(names, values.tolist(), strict=True)}


def motion_figure(found: Excitation) -> Figure:
    """Positions, and speeds and efforts as shares of their limits, of every joint over time."""
    trajectory, feasibility = found.trajectory, found.task.feasibility
    names, limits = feasibility.names, feasibility.limits
    figure = Figure(figsize=(_WIDTH, _ROW_HEIGHT * len(names) + 1.0), dpi=DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(names), 2, sharex=True, squeeze=False)
    efforts = found.task.knowledge.efforts(found.motion.at(trajectory.times)[:3])
    for index, (name, (left, right)) in enumerate(zip(names, axes, strict=True)):
        left.plot(trajectory.times, trajectory.positions[:, index], color=INK, lw=1.2)
        left.set_ylabel(name, fontsize=8, parse_math=False)
        right.plot(trajectory.times, trajectory.velocities[:, index] / limits.velocity[index], color=INK, lw=1.0)
        right.plot(trajectory.times, efforts[:, index] / limits.effort[index], color=IDENTIFIED, lw=1.0)
        right.set_ylim(-1.05, 1.05)
        for edge in (-1.0, 1.0):
            right.axhline(edge, color=FAINT, lw=0.8, ls="--")
    axes[0, 0].set_title("position [rad, m]", fontsize=10)
    axes[0, 1].set_title("speed (black) and expected effort (orange), shares of the limits", fontsize=10)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    return figure
