"""Files of a designed motion: trajectory, picture, report, and ``motion.html``, which animates it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from geomid_ros.estimation.estimate import QUANTITIES
from geomid_ros.excitation.belief import ExpectedUncertainty
from geomid_ros.files.disk import check_writable, make_folder, write_json
from geomid_ros.files.models.estimate_file import by_channel
from geomid_ros.files.schema import FORMAT, attributes_entry
from geomid_ros.files.trajectories import write_bag, write_csv, write_yaml
from geomid_ros.model.collision import HalfSpace, Obstacle
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import samples_of
from geomid_ros.report.page import FAINT, IDENTIFIED, INK, Script, write_page
from geomid_ros.report.pictures import new_figure, write_picture
from geomid_ros.session.excitation import Excitation
from geomid_ros.types import FloatArray


def save(found: Excitation, folder: Path) -> list[Path]:
    """Write all files of a motion into a folder; return their paths. Raises GeomidError naming a file."""
    check_writable(folder)
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
    """Limits, margins, clearances and expected results of a motion, for programs."""
    feasibility, margins, limits = found.task.feasibility, found.margins, found.task.feasibility.limits
    kinds = ("velocity", "acceleration", "jerk", "effort")
    posterior, learning = found.task.belief.posterior, found.learning
    pairs = feasibility.collision.pairs if feasibility.collision else ()
    stages = {name: getattr(learning, name) for name in ("before", "designed", "random", "twice", "random_twice")}
    return {
        "format": FORMAT,
        "period": found.motion.form.period,
        "repeats": found.motion.form.repeats,
        "start": by_channel(feasibility.names, found.motion.start),
        "limits": {kind: by_channel(feasibility.names, getattr(limits, kind)) for kind in kinds},
        "used": {kind: by_channel(feasibility.names, getattr(margins, kind)) for kind in kinds},
        "to_position_limit": by_channel(feasibility.names, margins.position),
        "distances": [
            attributes_entry(pair, "first", "second") | {"at_least": float(distance), "clearance": float(clearance)}
            for pair, distance, clearance in zip(pairs, margins.distance, feasibility.clearances, strict=True)
        ],
        "not_watched": [[pair.first, pair.second] for pair in found.task.excluded_pairs],
        "expected": {
            name: {
                "error": stage.error,
                "links": {
                    link: dict(zip(QUANTITIES, std.tolist(), strict=True))
                    for link, std in zip(posterior.links, stage.links, strict=True)
                },
                "effects": _effects(found, stage),
            }
            for name, stage in stages.items()
        },
        "decisions": [attributes_entry(each, "found", "rival", "difference", "random") for each in found.decisions],
        "notes": list(found.task.notes),
    }


def _effects(design: Excitation, stage: ExpectedUncertainty) -> list[dict[str, Any]]:
    return [
        attributes_entry(effect, "name", "place", "parameter") | {"std": float(std)}
        for effect, std in zip(design.task.belief.posterior.effects, stage.effects, strict=True)
    ]


def motion_figure(found: Excitation) -> Figure:
    """Plot positions of every joint over time, and speeds and efforts as fractions of their limits."""
    trajectory, feasibility = found.trajectory, found.task.feasibility
    names, limits = feasibility.names, feasibility.limits
    figure = new_figure(12.0, 1.5 * len(names) + 1.0)
    axes = figure.subplots(len(names), 2, sharex=True, squeeze=False)
    efforts = found.task.belief.efforts(found.motion.at(trajectory.times)[:3])
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


_SCRIPT = "motion.js"
_RATE = 10.0  # [Hz] of the frames; the page interpolates linearly
_DIRECTIONS = 80  # number; the farthest corner of a shape in each is drawn
_DECIMALS = 4


def write_motion_page(path: Path, found: Excitation) -> None:
    """Write the page, which needs no network. Raises GeomidError naming the file."""
    margins, feasibility = found.margins, found.task.feasibility
    shares = np.array([margins.velocity, margins.acceleration, margins.jerk, margins.effort]).T
    ends = np.clip(feasibility.limits.position, -np.pi, np.pi)
    positions = found.trajectory.positions
    content = {
        "robot": found.task.belief.model.robot.name,
        "found": found,
        "joints": list(zip(feasibility.names, positions.min(axis=0), positions.max(axis=0), shares, strict=True)),
        "motion": {
            "rate": _RATE,
            "repeats": found.motion.form.repeats,
            "ranges": np.where(np.isfinite(feasibility.limits.position), feasibility.limits.position, ends).tolist(),
            **_scene(found),
        },
        "script": Script.read(_SCRIPT),
    }
    write_page(path, "motion.html.j2", content)


def _scene(design: Excitation) -> dict[str, Any]:
    """Drawing data: corners of bodies in their frames, and the pose of each frame over one period."""
    robot, collision = design.task.belief.model.robot, design.task.feasibility.collision
    shapes = collision.shapes if collision is not None else {}
    links = [link for link in robot.tree.links if link in shapes or robot.is_divided_at(link)]
    times = np.arange(0.0, design.motion.form.period + 0.5 / _RATE, 1.0 / _RATE)
    states = design.motion.at(times)[:3]
    frames = [robot.link_frames(samples_of(states[:, [index]])) for index in range(len(times))]
    turns = np.array([[frame[link][0] for link in links] for frame in frames])
    origins = np.array([[frame[link][1] for link in links] for frame in frames])
    solid = [obstacle for obstacle in (collision.obstacles if collision else ()) if not isinstance(obstacle, HalfSpace)]
    drawn = np.vstack([origins.reshape(-1, 3), np.zeros((1, 3)), *(corners(body.vertices) for body in solid)])
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    return {
        "positions": states[0].round(_DECIMALS).tolist(),
        "bodies": [[corners(shape.vertices).tolist() for shape in shapes.get(link, ())] for link in links],
        "above": [_drawn_ancestor(robot, link, links) for link in links],
        "turns": turns.reshape(len(times), len(links), 9).round(_DECIMALS).tolist(),
        "origins": origins.round(_DECIMALS).tolist(),
        "around": [_outline(obstacle).tolist() for obstacle in (collision.obstacles if collision else ())],
        "centre": (0.5 * (low + high)).tolist(),
        "reach": float(0.5 * np.linalg.norm(high - low)),
    }


def _drawn_ancestor(robot: Robot, link: str, links: list[str]) -> int:
    """Index of the nearest drawn ancestor of a link; -1 if there is none."""
    ancestors: Iterator[str] = (joint.parent for joint in robot.tree.joints_above(link))
    return next((links.index(parent) for parent in ancestors if parent in links), -1)


def _outline(obstacle: Obstacle) -> FloatArray:
    """Corners ``(V, 3)`` [m] to draw for an obstacle."""
    if not isinstance(obstacle, HalfSpace):
        return corners(obstacle.vertices)
    *_, sideways = np.linalg.svd(obstacle.normal[None])
    square = np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)])  # [m]
    return np.asarray((obstacle.normal * obstacle.offset + square @ sideways[1:]).round(_DECIMALS))


def corners(vertices: FloatArray) -> FloatArray:
    """Select ``vertices (V, 3)`` that are farthest in one of many directions, spread over the sphere (Fibonacci)."""
    height = 1.0 - 2.0 * (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(_DIRECTIONS)
    flat = np.sqrt(1.0 - height**2)
    directions = np.array([flat * np.cos(angle), flat * np.sin(angle), height])
    return np.asarray(vertices[np.unique(np.argmax(vertices @ directions, axis=0))].round(_DECIMALS))
