"""Robots sampled from the posterior of an estimate, in formats of other software, and the spread of their torques."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
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
from geomid_ros.exports.descriptions import DESCRIPTIONS, UserMjcf, as_described, read_user_mjcf
from geomid_ros.exports.formats import JSON
from geomid_ros.exports.model import ExportModel, read_model
from geomid_ros.files.models.effects_file import QUANTITY_NAMES, by_parameter, effect_name, effects_entries
from geomid_ros.files.models.estimate_file import EstimateFile, link_entry
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.files.models.posterior import RTOL, check_matches_estimate, places_in, posterior_path, read_posterior
from geomid_ros.files.models.readers import MUJOCO
from geomid_ros.files.models.urdf import with_inertials
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import KnownEffect, Quantity, effect_class
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

BAND = (0.025, 0.975)
"""Quantiles at the ends of 95 % ranges."""
ENOUGH = 1000
"""Least number of robots that these quantiles are computed from."""


@dataclass(frozen=True, eq=False)
class DrawnRobots:
    """Robots sampled from a posterior.

    Attributes:
        model: the estimate.
        posterior: posterior of the estimate.
        parameters: of sampled robots ``(N, D)``, in the order of the posterior; enough of them for ranges.
        count: the number of robots requested.
    """

    model: ExportModel
    posterior: Posterior
    parameters: FloatArray
    count: int

    def __iter__(self) -> Iterator[ExportModel]:
        """Iterate over the requested robots."""
        return map(self._robot, range(self.count))

    @property
    def links(self) -> dict[str, FloatArray]:
        """Parameters ``(N, 10)`` of the links by name."""
        return {name: self.parameters[:, 10 * k : 10 * k + 10] for k, name in enumerate(self.posterior.links)}

    @property
    def coefficients(self) -> list[tuple[EffectCoordinate, FloatArray]]:
        """Coefficients of the effects, each with its values ``(N,)``."""
        return list(zip(self.posterior.effects, self.parameters[:, 10 * len(self.posterior.links) :].T, strict=True))

    def inertias(self, number: int) -> dict[str, FloatArray]:
        """Return parameters ``(10,)`` of the links of robot ``number``, see :meth:`ExportModel.as_links`."""
        return self.model.as_links({name: values[number] for name, values in self.links.items()})

    def _robot(self, number: int) -> ExportModel:
        bodies, unknown = self.model.bodies, np.full(10, np.nan)
        inertias = self.inertias(number)
        drawn = {name: replace(bodies[name], parameters=values, std=unknown) for name, values in inertias.items()}
        return replace(
            self.model,
            bodies={**bodies, **drawn},
            urdf=with_inertials(self.model.urdf, inertias),
            effects=tuple(self._effect(effect, number) for effect in self.model.effects),
        )

    def _effect(self, effect: KnownEffect, number: int) -> KnownEffect:
        """Return an effect of the model with the parameters of robot ``number``."""
        parameters = dict(effect.parameters)
        for name in parameters:
            if (key := (effect.effect, effect.joint, name)) in self._drawn:
                c, values = self._drawn[key]
                parameters[name] = Quantity(float(values[number]), np.nan, c.unit)
        return replace(effect, parameters=parameters)

    @cached_property
    def _drawn(self) -> dict[tuple[str, str, str], tuple[EffectCoordinate, FloatArray]]:
        """Sampled parameters of effects, by effect, place and parameter. They are those that have the same value in the
        posterior and in the estimate."""
        given, sampled = by_parameter(self.model.effects), {}
        estimated = self.posterior.parameters[10 * len(self.posterior.links) :]
        for (c, drawn), value in zip(self.coefficients, estimated, strict=True):
            key = c.name, c.place, c.parameter
            if key in given and abs(given[key].value - value) <= RTOL * abs(value):
                sampled[key] = c, drawn
        return sampled

    @property
    def not_drawn(self) -> str:
        """Effects that are fixed at their estimates in all robots, in a sentence; empty if there are none."""
        drawn = {(effect, place) for effect, place, _ in self._drawn}
        names = [
            f"{effect_name(e.effect)} of {e.joint or e.link or 'the robot'}"
            for e in self.model.effects
            if (e.effect, e.joint) not in drawn
        ]
        return f"identical in all robots (not in the posterior): {', '.join(names)}" if names else ""


def sample_robots(path: Path, count: int, seed: int, std_factor: float) -> DrawnRobots:
    """Sample ``count`` robots from the posterior next to an ``estimate.json``, with all stds times ``std_factor``.

    Raises:
        InputError: there is no posterior next to it, or it is of another estimate.
    """
    model = read_model(path)
    if not model.estimated:
        raise InputError(f"{path}: not an estimate.json; it has no uncertainties to sample from")
    file = posterior_path(path)
    posterior = read_posterior(file)
    check_matches_estimate(posterior, file, EstimateFile.read(path).inertias, model.source)
    drawn = posterior.draw(max(count, ENOUGH), np.random.default_rng(seed), std_factor)
    return DrawnRobots(model, posterior, drawn, count)


def descriptions_of(
    robots: DrawnRobots, tool: str, into: Path | None, packages: Mapping[str, Path]
) -> Iterator[tuple[str, str]]:
    """Yield names and texts of the files of the sampled robots.

    Args:
        robots: the sampled robots.
        tool: reader of the files: for :data:`~geomid_ros.exports.descriptions.DESCRIPTIONS` those of each robot, for
            ``json`` one file of all.
        into: MJCF of the user, for mujoco.
        packages: folders of ROS packages, by name.
    """
    if tool == JSON:
        entries = [_entries(robots, number, model) for number, model in enumerate(robots)]
        yield "robots.json", json.dumps({"format": 1, "robots": entries}) + "\n"
        return
    template = _template(robots.model, into, packages) if tool == MUJOCO else None
    digits = len(str(robots.count))
    for number, model in enumerate(robots, 1):
        name = f"robot_{number:0{digits}d}"
        if template is None:
            files = DESCRIPTIONS[tool].whole(as_described(model, packages))
            yield f"{name}.urdf", files.text
            yield from ((f"{name}_{beside}", text) for beside, text in files.extra_files.items())
        else:
            yield f"{name}.xml", template.with_numbers(model)


def _template(model: ExportModel, into: Path | None, packages: Mapping[str, Path]) -> UserMjcf:
    """MJCF that the numbers of the sampled robots are written into: the user's, or that of the estimate."""
    if into is not None:
        template = read_user_mjcf(model, into)
        return replace(template, text=_with_absolute_folders(template.text, into))
    text = DESCRIPTIONS[MUJOCO].whole(as_described(model, packages)).text
    joints = {joint.name: dict[str, float]() for joint in model.tree.joints}
    return UserMjcf(model.urdf_path, text, {name: np.eye(4) for name in model.written}, joints)


def _with_absolute_folders(text: str, path: Path) -> str:
    """Repeat the asset folders of an MJCF as absolute paths, so that its files are found from any folder."""
    root = ElementTree.fromstring(text)  # noqa: S314 MuJoCo has read it, expat has limits
    if not any(element.get("file") for element in root.iter()):
        return text
    settings = {key: value for compiler in root.iter("compiler") for key, value in compiler.attrib.items()}
    folders = {key: settings.get(key, settings.get("assetdir", "")) for key in ("meshdir", "texturedir")}
    attributes = " ".join(
        f"{key}={quoteattr(str((path.parent / folder).resolve()))}" for key, folder in folders.items()
    )
    end = text.rindex("</mujoco")
    return f"{text[:end]}  <compiler {attributes}/>\n{text[end:]}"


def _entries(robots: DrawnRobots, number: int, model: ExportModel) -> dict[str, Any]:
    """Return links and effects of robot ``number`` as in ``estimate.json``."""
    links = [
        link_entry(name, merged, robots.links[name][number])
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
    """Return YAML with the 95 % range of every number, for simulators that randomise by themselves.

    Independent ranges ignore the correlations of the posterior, so robots sampled from them vary more. With ``isaac``,
    ``events`` has the same as arguments of Isaac Lab's event terms (``isaaclab.envs.mdp``), by the name of the term:
    ``func``, ``mode`` and ``params`` of an EventTermCfg, ``asset_cfg`` being those of a SceneEntityCfg.
    """
    text = _HEADER + _yaml({"links": _links(robots), "effects": _effects(robots)})
    return text + _EVENTS + _yaml({"events": _events(robots)}) if isaac else text


def _yaml(document: dict[str, Any]) -> str:
    return str(yaml.safe_dump(document, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120))


def _band(values: FloatArray) -> list[float]:
    """95 % range of ``values (N,)``, to six digits."""
    return [float(f"{value:.6g}") for value in np.quantile(values, BAND)]


def _quantities(robots: DrawnRobots) -> dict[str, FloatArray]:
    """Quantities ``(N, 10)`` of the sampled links, by name."""
    drawn = [robots.inertias(number) for number in range(len(robots.parameters))]
    links = {name: np.array([inertias[name] for inertias in drawn]) for name in robots.model.estimated}
    return {name: pseudo_inertia.quantities_of(parameters) for name, parameters in links.items()}


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
    distribution = {"operation": "abs", "distribution": "uniform"} if absolute else {}
    return {
        "func": f"isaaclab.envs.mdp.{function}",
        "mode": "startup",
        "params": {"asset_cfg": dict(asset), **ranges, **distribution},
    }


def _joint_ranges(robots: DrawnRobots) -> dict[str, dict[str, list[float]]]:
    """Ranges of the joint parameters that Isaac Lab randomises: armature and dry friction."""
    ranges: dict[str, dict[str, list[float]]] = {}
    for c, values in robots.coefficients:
        forms = {form.name: form.mjcf for form in effect_class(c.name).parameters}
        if (key := _ISAAC_JOINT.get(forms.get(c.parameter, ""))) is not None:
            ranges.setdefault(c.place, {})[key] = _band(values)
    return ranges


RANGE = 0.2
"""Half-width of the uniform ranges that sampled robots are compared with, as a fraction of each number."""


@dataclass(frozen=True, eq=False)
class TorqueSpread:
    """Widths of 95 % bands of joint efforts, as RMS over many samples of fast motion.

    Attributes:
        joints: names of the joints.
        units: units of their efforts.
        drawn: of the sampled robots ``(joints,)``.
        ranges: of robots whose links and effects are each within 20 % of the estimate, independently ``(joints,)``.
    """

    joints: tuple[str, ...]
    units: tuple[str, ...]
    drawn: FloatArray
    ranges: FloatArray

    @property
    def ratio(self) -> float:
        """Width of the band of sampled robots relative to that of ranges, mean over the joints."""
        return float(np.mean(self.drawn / self.ranges))


def torque_spread(robots: DrawnRobots) -> TorqueSpread:
    """Compute the variation of joint torques among sampled robots."""
    model = MeasurementModel(
        robots.model.robot, [], local_effects=LoadedModel.read(robots.model.source).local_effects(())
    )
    motion = instants(model, moving=True)
    estimate = _in_order(model, robots, robots.posterior.parameters[None])[0]
    drawn = _in_order(model, robots, robots.parameters[:ENOUGH])
    bands = [torque_bands(model, motion, parameters) for parameters in (drawn, within_ranges(model, estimate))]
    joints = model.robot.joints
    return TorqueSpread(
        tuple(joint.name for joint in joints),
        tuple(joint.unit for joint in joints),
        *(np.sqrt(np.mean((high - low) ** 2, axis=0)) for low, high in bands),
    )


def torque_bands(model: MeasurementModel, motion: Samples, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute the ends ``(N, channels)`` of the 95 % bands of efforts at N samples, lower and upper, for robots with
    ``parameters (robots, D)``."""
    _, efforts = model.predict(motion, parameters.T)
    low, high = np.quantile(efforts, BAND, axis=2)
    return low, high


def _in_order(model: MeasurementModel, robots: DrawnRobots, parameters: FloatArray) -> FloatArray:
    """Reorder ``parameters (N, D)`` from the posterior to the model; links not sampled take the values of the URDF."""
    order = places_in(robots.posterior, model)
    return np.where(order >= 0, parameters[:, order], model.nominal_parameters)


def within_ranges(model: MeasurementModel, estimate: FloatArray) -> FloatArray:
    """Sample robots ``(N, D)`` within 20 % of the ``estimate (D,)``: one factor for each link and each effect."""
    links = len(model.body_names)
    factors = np.random.default_rng(1).uniform(1.0 - RANGE, 1.0 + RANGE, (ENOUGH, links + len(model.coefficients)))
    return np.asarray(
        estimate * np.concatenate([np.repeat(factors[:, :links], 10, axis=1), factors[:, links:]], axis=1)
    )
