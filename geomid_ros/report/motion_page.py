"""``motion.html``: a page that plays a designed motion."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.model.collision import HalfSpace, Obstacle
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import samples_of
from geomid_ros.report.page import Script, write_page
from geomid_ros.session.excitation import Excitation
from geomid_ros.types import FloatArray

_SCRIPT = "motion.js"
_RATE = 10.0  # [Hz] of the frames; the page goes straight from one to the next
_DIRECTIONS = 80  # in which the corners of a shape lie that are drawn
_PLANE = 1.0  # [m] to either side that is drawn of a plane
_TURN, _POSITION = 4, 4  # decimals


def write_motion_page(path: Path, found: Excitation) -> None:
    """Write the page, which needs no network. Raises GeomidError naming the file."""
    margins, feasibility = found.margins, found.task.feasibility
    shares = np.array([margins.velocity, margins.acceleration, margins.jerk, margins.effort]).T
    ends = np.clip(feasibility.limits.position, -np.pi, np.pi)
    positions = found.trajectory.positions
    content = {
        "robot": found.task.knowledge.model.robot.name,
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


def _scene(found: Excitation) -> dict[str, Any]:
    """What is drawn: corners of bodies in their own frames, and where these are in each frame of one period."""
    robot, collision = found.task.knowledge.model.robot, found.task.feasibility.collision
    shapes = collision.shapes if collision is not None else {}
    links = [link for link in robot.tree.links if link in shapes or robot.is_divided_at(link)]
    times = np.arange(0.0, found.motion.form.period + 0.5 / _RATE, 1.0 / _RATE)
    states = found.motion.at(times)[:3]
    frames = [robot.link_frames(samples_of(states[:, [index]])) for index in range(len(times))]
    turns = np.array([[frame[link][0] for link in links] for frame in frames])
    origins = np.array([[frame[link][1] for link in links] for frame in frames])
    solid = [obstacle for obstacle in (collision.obstacles if collision else ()) if not isinstance(obstacle, HalfSpace)]
    drawn = np.vstack([origins.reshape(-1, 3), np.zeros((1, 3)), *(corners(body.vertices) for body in solid)])
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    return {
        "positions": states[0].round(_POSITION).tolist(),
        "bodies": [[corners(shape.vertices).tolist() for shape in shapes.get(link, ())] for link in links],
        "above": [_above(robot, link, links) for link in links],
        "turns": turns.reshape(len(times), len(links), 9).round(_TURN).tolist(),
        "origins": origins.round(_POSITION).tolist(),
        "around": [_outline(obstacle).tolist() for obstacle in (collision.obstacles if collision else ())],
        "centre": (0.5 * (low + high)).tolist(),
        "reach": float(0.5 * np.linalg.norm(high - low)),
    }


def _above(robot: Robot, link: str, links: list[str]) -> int:
    """The place of the nearest link above that is drawn; -1 for none."""
    above: Iterator[str] = (joint.parent for joint in robot.tree.joints_above(link))
    return next((links.index(parent) for parent in above if parent in links), -1)


def _outline(obstacle: Obstacle) -> FloatArray:
    """Corners ``(V, 3)`` [m] of what is drawn of an obstacle."""
    if not isinstance(obstacle, HalfSpace):
        return corners(obstacle.vertices)
    *_, sideways = np.linalg.svd(obstacle.normal[None])
    square = np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)]) * _PLANE
    return np.asarray((obstacle.normal * obstacle.offset + square @ sideways[1:]).round(_POSITION))


def corners(vertices: FloatArray) -> FloatArray:
    """Those of ``vertices (V, 3)`` that are farthest in some of many directions, spread over the sphere (Fibonacci)."""
    height = 1.0 - 2.0 * (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(_DIRECTIONS)
    flat = np.sqrt(1.0 - height**2)
    directions = np.array([flat * np.cos(angle), flat * np.sin(angle), height])
    return np.asarray(vertices[np.unique(np.argmax(vertices @ directions, axis=0))].round(_POSITION))
