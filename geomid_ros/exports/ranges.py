"""Ranges of the numbers of drawn robots, for simulators that randomise by themselves.

``ranges.yaml`` has the 95 % range of every number by itself: robots that are drawn from ranges know nothing of how the
numbers belong together, and are spread as much wider. For Isaac Lab, ``events`` has the same as arguments of event
terms (``isaaclab.envs.mdp``: randomize_rigid_body_mass, randomize_rigid_body_com, randomize_joint_parameters), by the
term's name: ``func``, ``mode`` and ``params`` of an EventTermCfg, ``asset_cfg`` being those of a SceneEntityCfg.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import yaml

from geomid_ros.exports.posterior_samples import BAND, DrawnRobots
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import effect_class
from geomid_ros.model.effects.parameters import COM_ENTRIES
from geomid_ros.types import FloatArray

_HEADER = """\
# 95 % ranges [low, high] of robots drawn from an identification, in SI units: masses, centres of mass in the links'
# frames, inertias about them, and the effects at joints.
"""
_EVENTS = (
    "# Event terms of Isaac Lab; the inertia is scaled with the mass, the centre of mass is shifted by com_range.\n"
)
_ISAAC_JOINT = {"joint/armature": "armature_distribution_params", "joint/frictionloss": "friction_distribution_params"}


def ranges_text(robots: DrawnRobots, *, isaac: bool = False) -> str:
    """The YAML of the ranges, and with ``isaac`` of the event terms."""
    text = _HEADER + _yaml({"links": _links(robots), "effects": _effects(robots)})
    return text + _EVENTS + _yaml({"events": _events(robots)}) if isaac else text


def _yaml(document: dict[str, Any]) -> str:
    return str(yaml.safe_dump(document, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120))


def _band(values: FloatArray) -> list[float]:
    """The range of drawn ``values (N,)``, to six digits."""
    return [float(f"{value:.6g}") for value in np.quantile(values, BAND)]


def _quantities(robots: DrawnRobots) -> dict[str, FloatArray]:
    """Quantities ``(N, 10)`` of the drawn links, by name."""
    count = len(robots.posterior.links)
    parameters = robots.parameters[:, : 10 * count].reshape(-1, count, 10).swapaxes(0, 1)
    return dict(zip(robots.posterior.links, pseudo_inertia.quantities_of(parameters), strict=True))


def _links(robots: DrawnRobots) -> dict[str, Any]:
    names = ("mass", *COM_ENTRIES, *pseudo_inertia.INERTIA_NAMES)
    return {
        link: {name: _band(values) for name, values in zip(names, quantities.T, strict=True)}
        for link, quantities in _quantities(robots).items()
    }


def _effects(robots: DrawnRobots) -> list[dict[str, Any]]:
    first = 10 * len(robots.posterior.links)
    return [
        {"effect": c.name, "joint": c.place, "parameter": c.parameter, "unit": c.unit, "range": _band(values)}
        for c, values in zip(robots.posterior.effects, robots.parameters[:, first:].T, strict=True)
    ]


def _events(robots: DrawnRobots) -> dict[str, Any]:
    events = {}
    for link, quantities in _quantities(robots).items():
        body = {"name": "robot", "body_names": link}
        centre = robots.model.bodies[link].inertial.com
        shifts = dict(zip("xyz", map(_band, quantities[:, 1:4].T - centre[:, None]), strict=True))
        mass = {"mass_distribution_params": _band(quantities[:, 0]), "recompute_inertia": True}
        events[f"mass_of_{link}"] = _event("randomize_rigid_body_mass", body, mass, absolute=True)
        events[f"com_of_{link}"] = _event("randomize_rigid_body_com", body, {"com_range": shifts})
    for joint, ranges in _joint_ranges(robots).items():
        named = {"name": "robot", "joint_names": joint}
        events[f"parameters_of_{joint}"] = _event("randomize_joint_parameters", named, ranges, absolute=True)
    return events


def _event(function: str, asset: dict[str, str], ranges: dict[str, Any], *, absolute: bool = False) -> dict[str, Any]:
    how = {"operation": "abs", "distribution": "uniform"} if absolute else {}
    return {
        "func": f"isaaclab.envs.mdp.{function}",
        "mode": "startup",
        "params": {"asset_cfg": dict(asset), **ranges, **how},
    }


def _joint_ranges(robots: DrawnRobots) -> dict[str, dict[str, list[float]]]:
    """What Isaac Lab draws at joints: armature and dry friction."""
    found: dict[str, dict[str, list[float]]] = {}
    first = 10 * len(robots.posterior.links)
    for c, values in zip(robots.posterior.effects, robots.parameters[:, first:].T, strict=True):
        forms = {form.name: form.mjcf for form in effect_class(c.name).parameters}
        if (key := _ISAAC_JOINT.get(forms.get(c.parameter, ""))) is not None:
            found.setdefault(c.place, {})[key] = _band(values)
    return found
