"""Robots drawn from an estimate's posterior, in the terms of other software, and how much their torques differ."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np
import yaml

from geomid_ros.errors import InputError
from geomid_ros.estimation.posterior import EffectCoordinate, Posterior
from geomid_ros.estimation.suggested_motions import instants
from geomid_ros.exports.descriptions import DESCRIPTIONS, as_described, described_robot
from geomid_ros.exports.formats import JSON
from geomid_ros.exports.model import Model, read_model
from geomid_ros.exports.patch_mjcf import OwnMjcf, read_own_mjcf
from geomid_ros.files.models.effects_file import QUANTITY_NAMES, by_parameter, effects_entries
from geomid_ros.files.models.estimate_file import link_entry
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.files.models.posterior import SAME, beside, check_of, places_in, read_posterior
from geomid_ros.files.models.urdf import with_inertials
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import KnownEffect, Quantity, effect_class
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

BAND = (0.025, 0.975)
"""Quantiles at the ends of 95 % ranges."""
ENOUGH = 1000
"""Robots for these."""


@dataclass(frozen=True, eq=False)
class DrawnRobots:
    """Robots drawn from a posterior.

    Attributes:
        model: The estimate.
        posterior: What is known of it.
        parameters: Of drawn robots ``(N, D)``, in the posterior's order, enough of them for ranges.
        count: How many of these were asked for.
    """

    model: Model
    posterior: Posterior
    parameters: FloatArray
    count: int

    def __iter__(self) -> Iterator[Model]:
        """Each robot that was asked for in turn."""
        return map(self._robot, range(self.count))

    @property
    def links(self) -> dict[str, FloatArray]:
        """Parameters ``(N, 10)`` of the links by name."""
        return {name: self.parameters[:, 10 * k : 10 * k + 10] for k, name in enumerate(self.posterior.links)}

    @property
    def coefficients(self) -> list[tuple[EffectCoordinate, FloatArray]]:
        """The effects' coefficients, each with its values ``(N,)``."""
        return list(zip(self.posterior.effects, self.parameters[:, 10 * len(self.posterior.links) :].T, strict=True))

    def _robot(self, number: int) -> Model:
        bodies, unknown = self.model.bodies, np.full(10, np.nan)
        inertias = {name: own[number] for name, own in self.links.items()}
        drawn = {name: replace(bodies[name], parameters=own, std=unknown) for name, own in inertias.items()}
        return replace(
            self.model,
            bodies={**bodies, **drawn},
            urdf=with_inertials(self.model.urdf, inertias),
            effects=tuple(self._effect(effect, number) for effect in self.model.effects),
        )

    def _effect(self, effect: KnownEffect, number: int) -> KnownEffect:
        """An effect of the model as a robot has it."""
        parameters = dict(effect.parameters)
        for name in parameters:
            if (key := (effect.effect, effect.joint, name)) in self._drawn:
                c, values = self._drawn[key]
                parameters[name] = Quantity(float(values[number]), np.nan, c.unit)
        return replace(effect, parameters=parameters)

    @cached_property
    def _drawn(self) -> dict[tuple[str, str, str], tuple[EffectCoordinate, FloatArray]]:
        """The effects' parameters that are drawn, by effect, place and parameter: those of which the posterior and the
        estimate have the same number."""
        said, found = by_parameter(self.model.effects), {}
        estimated = self.posterior.parameters[10 * len(self.posterior.links) :]
        for (c, drawn), value in zip(self.coefficients, estimated, strict=True):
            key = c.name, c.place, c.parameter
            if key in said and abs(said[key].value - value) <= SAME * abs(value):
                found[key] = c, drawn
        return found

    @property
    def not_drawn(self) -> str:
        """The effects that all robots have as the estimate has them, in a sentence; empty if there are none."""
        drawn = {(effect, place) for effect, place, _ in self._drawn}
        names = [
            f"{e.effect.replace('_', ' ')} of {e.joint or e.link or 'the robot'}"
            for e in self.model.effects
            if (e.effect, e.joint) not in drawn
        ]
        return f"the same in all robots, as the posterior has nothing of it: {', '.join(names)}" if names else ""


def draw_robots(path: Path, count: int, seed: int, spread: float) -> DrawnRobots:
    """Draw ``count`` robots from the posterior beside an ``estimate.json``, standard deviations times ``spread``.

    Raises:
        InputError: there is no posterior beside it, or it is of another estimate.
    """
    model = read_model(path)
    if not model.estimated:
        raise InputError(f"{path}: no estimate.json, and so nothing is known of how sure its numbers are")
    file = beside(path)
    posterior = read_posterior(file)
    check_of(posterior, file, {name: model.bodies[name].parameters for name in model.estimated}, model.source)
    drawn = posterior.draw(max(count, ENOUGH), np.random.default_rng(seed), spread)
    return DrawnRobots(model, posterior, drawn, count)


def descriptions_of(
    robots: DrawnRobots, tool: str, into: Path | None, packages: Mapping[str, Path]
) -> Iterator[tuple[str, str]]:
    """Names and texts of files of the drawn robots.

    Args:
        robots: What was drawn.
        tool: Who is to read it: of :data:`~geomid_ros.exports.descriptions.DESCRIPTIONS` a file each, or ``json`` one
            of all.
        into: An MJCF of the user's own, for mujoco.
        packages: Folders of ROS packages, by name.
    """
    if tool == JSON:
        entries = [_entries(robots, model) for model in robots]
        yield "robots.json", json.dumps({"format": 1, "robots": entries}) + "\n"
        return
    write, digits = _writer(robots.model, tool, into, packages), len(str(robots.count))
    for number, model in enumerate(robots, 1):
        yield f"robot_{number:0{digits}d}{'.xml' if tool == 'mujoco' else '.urdf'}", write(model)


def _writer(model: Model, tool: str, into: Path | None, packages: Mapping[str, Path]) -> Callable[[Model], str]:
    """What makes the text of a drawn robot."""
    if tool != "mujoco":
        return lambda drawn: DESCRIPTIONS[tool].whole(as_described(drawn, packages)).text
    if into is not None:
        own = read_own_mjcf(model, into)
        return replace(own, text=_with_absolute_folders(own.text, into)).with_numbers
    text = DESCRIPTIONS[tool].whole(as_described(model, packages)).text
    placements = {name: np.eye(4) for name in model.estimated}
    joints = [joint.name for joint in model.tree.joints]
    return OwnMjcf(model.urdf_path, text, placements, joints, ()).with_numbers


def _with_absolute_folders(text: str, path: Path) -> str:
    """An MJCF that finds its files from any folder: what it says of their folders is said once more, absolutely."""
    root = ElementTree.fromstring(text)  # noqa: S314 MuJoCo has read it, expat has limits
    if not any(element.get("file") for element in root.iter()):
        return text
    said = {key: value for compiler in root.iter("compiler") for key, value in compiler.attrib.items()}
    folders = {key: said.get(key, said.get("assetdir", "")) for key in ("meshdir", "texturedir")}
    attributes = " ".join(
        f"{key}={quoteattr(str((path.parent / folder).resolve()))}" for key, folder in folders.items()
    )
    end = text.rindex("</mujoco")
    return f"{text[:end]}  <compiler {attributes}/>\n{text[end:]}"


def _entries(robots: DrawnRobots, model: Model) -> dict[str, Any]:
    """A robot's links and effects as ``estimate.json`` has them."""
    links = [
        link_entry(name, merged, model.bodies[name].parameters)
        for name, merged in zip(robots.posterior.links, robots.posterior.merged, strict=True)
    ]
    return {"links": links, **effects_entries(model.effects)}


_HEADER = """\
# 95 % ranges [low, high] of robots drawn from an identification, in SI units: masses, centres of mass in the links'
# frames, inertias about them, and the effects at joints.
"""
_EVENTS = (
    "# Event terms of Isaac Lab; the inertia is scaled with the mass, the centre of mass is shifted by com_range.\n"
)
_ISAAC_JOINT = {"joint/armature": "armature_distribution_params", "joint/frictionloss": "friction_distribution_params"}


def ranges_text(robots: DrawnRobots, *, isaac: bool = False) -> str:
    """The YAML of the 95 % range of every number by itself, for simulators that randomise by themselves.

    Robots that are drawn from ranges know nothing of how the numbers belong together, and are as much wider. With
    ``isaac``, ``events`` has the same as arguments of Isaac Lab's event terms (``isaaclab.envs.mdp``), by the term's
    name: ``func``, ``mode`` and ``params`` of an EventTermCfg, ``asset_cfg`` being those of a SceneEntityCfg.
    """
    text = _HEADER + _yaml({"links": _links(robots), "effects": _effects(robots)})
    return text + _EVENTS + _yaml({"events": _events(robots)}) if isaac else text


def _yaml(document: dict[str, Any]) -> str:
    return str(yaml.safe_dump(document, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120))


def _band(values: FloatArray) -> list[float]:
    """The range of drawn ``values (N,)``, to six digits."""
    return [float(f"{value:.6g}") for value in np.quantile(values, BAND)]


def _quantities(robots: DrawnRobots) -> dict[str, FloatArray]:
    """Quantities ``(N, 10)`` of the drawn links, by name."""
    return {name: pseudo_inertia.quantities_of(parameters) for name, parameters in robots.links.items()}


def _links(robots: DrawnRobots) -> dict[str, Any]:
    return {
        link: {name: _band(values) for name, values in zip(QUANTITY_NAMES, quantities.T, strict=True)}
        for link, quantities in _quantities(robots).items()
    }


def _effects(robots: DrawnRobots) -> list[dict[str, Any]]:
    return [
        {"effect": c.name, "joint": c.place, "parameter": c.parameter, "unit": c.unit, "range": _band(values)}
        for c, values in robots.coefficients
    ]


def _events(robots: DrawnRobots) -> dict[str, Any]:
    events = {}
    for link, quantities in _quantities(robots).items():
        body = {"name": "robot", "body_names": link}
        centre = robots.model.bodies[link].com
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
    for c, values in robots.coefficients:
        forms = {form.name: form.mjcf for form in effect_class(c.name).parameters}
        if (key := _ISAAC_JOINT.get(forms.get(c.parameter, ""))) is not None:
            found.setdefault(c.place, {})[key] = _band(values)
    return found


RANGE = 0.2
"""Half of the width of the ranges that drawn robots are compared with, as a share of each number."""


@dataclass(frozen=True, eq=False)
class TorqueSpread:
    """Widths of 95 % bands of efforts, root mean square over many instants of fast motion.

    Attributes:
        joints: Their names.
        units: Of their efforts.
        drawn: Of the drawn robots ``(joints,)``.
        ranges: Of robots whose links, and whose effects, are each within 20 % of the estimate, independently
            ``(joints,)``.
    """

    joints: tuple[str, ...]
    units: tuple[str, ...]
    drawn: FloatArray
    ranges: FloatArray

    @property
    def ratio(self) -> float:
        """How wide drawn robots are spread beside ranges, mean over the joints."""
        return float(np.mean(self.drawn / self.ranges))


def torque_spread(robots: DrawnRobots) -> TorqueSpread:
    """The spread of joint torques of drawn robots."""
    model = MeasurementModel(
        described_robot(robots.model), [], local_effects=LoadedModel.read(robots.model.source).local_effects(())
    )
    motion = instants(model, moving=True)
    estimate = _in_order(model, robots, robots.posterior.parameters[None])[0]
    drawn = _in_order(model, robots, robots.parameters[:ENOUGH])
    bands = [torque_bands(model, motion, each) for each in (drawn, within_ranges(model, estimate))]
    joints = model.robot.joints
    return TorqueSpread(
        tuple(joint.name for joint in joints),
        tuple(joint.unit for joint in joints),
        *(np.sqrt(np.mean((high - low) ** 2, axis=0)) for low, high in bands),
    )


def torque_bands(model: MeasurementModel, motion: Samples, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lower and upper ends ``(N, channels)`` of the 95 % bands of what robots with ``parameters (robots, D)`` feel at N
    instants."""
    _, efforts = model.predict(motion, parameters.T)
    low, high = np.quantile(efforts, BAND, axis=2)
    return low, high


def _in_order(model: MeasurementModel, robots: DrawnRobots, parameters: FloatArray) -> FloatArray:
    """Drawn ``parameters (N, D)`` in the order of a measurement model; links that were not drawn are the URDF's."""
    order = places_in(robots.posterior, model)
    return np.where(order >= 0, parameters[:, order], model.nominal_parameters)


def within_ranges(model: MeasurementModel, estimate: FloatArray) -> FloatArray:
    """Robots ``(N, D)`` within 20 % of the ``estimate (D,)``: a factor for each link, and one for each effect."""
    links = len(model.body_names)
    factors = np.random.default_rng(1).uniform(1.0 - RANGE, 1.0 + RANGE, (ENOUGH, links + len(model.coefficients)))
    return np.asarray(
        estimate * np.concatenate([np.repeat(factors[:, :links], 10, axis=1), factors[:, links:]], axis=1)
    )
