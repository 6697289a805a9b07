"""``population.json``: the distribution of robots of one type, written by ``geomid fleet`` and read as a prior.

``links`` have ``name``, ``mass``, ``com`` and ``inertia`` as in ``estimate.json``. ``effects`` have ``name``,
``place``, ``parameter``, ``unit``, ``positive``, ``value`` and, if not positive, ``scale``. ``covariance`` is the upper
triangle, row by row, of the covariance of a robot's tangent coordinates at these values: little-endian float64 in
base64. The coordinates of a link belong to the symmetric matrix X in ``P^1/2 exp(X) P^1/2``, where P is its
pseudo-inertia ``[[S, h], [h, m]]`` about the link's origin: X11, X22, X33, X44, and sqrt(2) times X12, X13, X14, X23,
X24, X34. A positive coefficient c becomes ``c exp(x)``, another coefficient r with scale s ``r + s x``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.population import Population
from geomid_ros.estimation.posterior import EffectCoordinate
from geomid_ros.files.disk import write_json
from geomid_ros.files.models.estimate_file import LinkEntry, inertias_of, link_entry
from geomid_ros.files.schema import FORMAT, from_document, read_document, to_base64, to_document, triangle_from_base64
from geomid_ros.types import FloatArray, frozen

_NUMBER = "<f8"
_OF_EFFECT = ("name", "place", "parameter", "unit", "positive")


def write_population(path: Path, population: Population) -> None:
    """Write a population. Raises GeomidError naming the file."""
    write_json(path, population_document(population))


def population_document(population: Population) -> dict[str, Any]:
    """Make the document of ``population.json``."""
    first = 10 * len(population.links)
    bodies = population.parameters[:first].reshape(-1, 10)
    scales = iter(population.scales.tolist())
    values = population.parameters[first:].tolist()
    triangle = population.covariance[np.triu_indices(len(population.parameters))]
    return {
        "format": FORMAT,
        "robots": population.robots,
        "links": [link_entry(name, (), parameters) for name, parameters in zip(population.links, bodies, strict=True)],
        "effects": [
            to_document(effect) | {"value": value} | ({} if effect.positive else {"scale": next(scales)})
            for effect, value in zip(population.effects, values, strict=True)
        ],
        "covariance": to_base64(triangle, _NUMBER),
    }


@dataclass(frozen=True, kw_only=True)
class _EffectOfPopulation(EffectCoordinate):
    value: float
    scale: float = math.nan


@dataclass(frozen=True, kw_only=True)
class _PopulationDocument:
    robots: int
    links: tuple[LinkEntry, ...]
    effects: tuple[_EffectOfPopulation, ...]
    covariance: str


def read_population(path: Path) -> Population:
    """Read a population. Raises InputError naming the file and its fault."""
    document = read_document(path, "population", ("robots", "links", "effects", "covariance"))
    content = from_document(_PopulationDocument, document, f"{path}:")
    inertias, effects = inertias_of(content.links, str(path)), content.effects
    try:
        triangle = triangle_from_base64(content.covariance, _NUMBER, 10 * len(inertias) + len(effects))
    except ValueError as error:
        raise InputError(
            f"{path}: covariance is not of its links and effects ({error!r:.200}); run geomid fleet again"
        ) from error
    covariance = triangle + np.triu(triangle, 1).T
    values = np.array([effect.value for effect in effects])
    scales = np.array([effect.scale for effect in effects if not effect.positive])
    coordinates = tuple(EffectCoordinate(**{key: getattr(effect, key) for key in _OF_EFFECT}) for effect in effects)
    _check(path, coordinates, values, scales, covariance)
    return Population(
        links=tuple(inertias),
        effects=coordinates,
        parameters=frozen(np.concatenate([*inertias.values(), values])),
        covariance=frozen(covariance),
        scales=frozen(scales),
        robots=content.robots,
    )


def _check(
    path: Path, effects: Sequence[EffectCoordinate], values: FloatArray, scales: FloatArray, covariance: FloatArray
) -> None:
    """Raise InputError for an invalid population."""
    positive = np.array([effect.positive for effect in effects], dtype=bool)
    valid = (
        len({(effect.name, effect.place, effect.parameter, effect.unit) for effect in effects}) == len(effects)
        and bool(np.all(np.diff(positive.astype(int)) <= 0))  # the positive ones come first
        and bool(np.all(np.isfinite(values)) and np.all(values[positive] > 0.0) and np.all(scales > 0.0))
        and bool(np.all(np.isfinite(covariance)) and np.all(np.diag(covariance) > 0.0))
    )
    if valid:
        deviations = np.sqrt(np.diag(covariance))
        valid = bool(np.linalg.eigvalsh(covariance / np.outer(deviations, deviations))[0] > 0.0)
    if not valid:
        raise InputError(f"{path}: its effects or its covariance are none that robots can have; run geomid fleet again")
