"""``population.json``: what robots of a type have in common, written by ``geomid fleet`` and read as a prior.

``links`` have ``name``, ``mass``, ``com`` and ``inertia`` as in ``estimate.json``; ``effects`` ``name``, ``place``,
``parameter``, ``unit``, ``positive``, ``value`` and, if not positive, ``scale``. ``covariance`` is the upper triangle,
row by row, of the covariance of a robot's tangent coordinates at these: little-endian float64 in base64. Of a link they
are those of the symmetric matrix X in ``P^1/2 exp(X) P^1/2``, where P is its pseudo-inertia ``[[S, h], [h, m]]`` about
the link's origin: X11, X22, X33, X44, and sqrt(2) times X12, X13, X14, X23, X24, X34. A positive coefficient c is
``c exp(x)``, another r with its scale s is ``r + s x``.
"""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.population import Population
from geomid_ros.estimation.posterior import EffectCoordinate
from geomid_ros.files.disk import read_text, write_json
from geomid_ros.files.models.results import known_inertias, link_entry
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.types import FloatArray, frozen

FORMAT = 1
_MOST_BYTES = 50_000_000
_NUMBER = "<f8"
_OF_EFFECT = ("name", "place", "parameter", "unit", "positive")


def write_population(path: Path, population: Population) -> None:
    """Write a population. Raises GeomidError naming the file."""
    write_json(path, population_document(population))


def population_document(population: Population) -> dict[str, Any]:
    """The document of ``population.json``."""
    first = 10 * len(population.links)
    bodies = population.parameters[:first].reshape(-1, 10)
    masses, central = bodies[:, 0], pseudo_inertia.central_inertia(bodies)
    scales = iter(population.scales.tolist())
    values = population.parameters[first:].tolist()
    triangle = population.covariance[np.triu_indices(len(population.parameters))]
    return {
        "format": FORMAT,
        "robots": population.robots,
        "links": [
            link_entry(name, (), (float(mass), body[1:4] / mass, inertia))
            for name, mass, body, inertia in zip(population.links, masses, bodies, central, strict=True)
        ],
        "effects": [
            {key: getattr(effect, key) for key in _OF_EFFECT}
            | {"value": value}
            | ({} if effect.positive else {"scale": next(scales)})
            for effect, value in zip(population.effects, values, strict=True)
        ],
        "covariance": base64.b64encode(triangle.astype(_NUMBER).tobytes()).decode(),
    }


def read_population(path: Path) -> Population:
    """Read a population. Raises InputError naming the file."""
    try:
        document = json.loads(read_text(path, "population", _MOST_BYTES))
        if document["format"] != FORMAT:
            raise InputError(f"{path}: has format {document['format']!r:.80}, this version reads format {FORMAT}")
        inertias = known_inertias(document, str(path))
        effects = tuple(EffectCoordinate(**{key: entry[key] for key in _OF_EFFECT}) for entry in document["effects"])
        values = np.array([float(entry["value"]) for entry in document["effects"]])
        scales = np.array([float(entry["scale"]) for entry in document["effects"] if not entry["positive"]])
        covariance = _symmetric(document["covariance"], 10 * len(inertias) + len(effects))
        robots = int(document["robots"])
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise InputError(f"{path}: no population.json of geomid fleet ({error!r:.200})") from error
    _check(path, effects, values, scales, covariance)
    parameters = np.concatenate([*inertias.values(), values])
    return Population(
        links=tuple(inertias),
        effects=effects,
        parameters=frozen(parameters),
        covariance=frozen(covariance),
        scales=frozen(scales),
        robots=robots,
    )


def _symmetric(text: str, size: int) -> FloatArray:
    triangle = np.frombuffer(base64.b64decode(text, validate=True), _NUMBER).astype(np.float64)
    matrix = np.zeros((size, size))
    matrix[np.triu_indices(size)] = triangle.reshape(size * (size + 1) // 2)  # as many as the file has room for
    return matrix + np.triu(matrix, 1).T


def _check(
    path: Path, effects: tuple[EffectCoordinate, ...], values: FloatArray, scales: FloatArray, covariance: FloatArray
) -> None:
    """Raise InputError for what no population can be."""
    texts = [(effect.name, effect.place, effect.parameter, effect.unit) for effect in effects]
    positive = np.array([effect.positive is True for effect in effects], dtype=bool)
    possible = (
        all(isinstance(text, str) for own in texts for text in own)
        and all(isinstance(effect.positive, bool) for effect in effects)
        and len(set(texts)) == len(texts)
        and bool(np.all(np.diff(positive.astype(int)) <= 0))  # the positive ones come first
        and bool(np.all(np.isfinite(values)) and np.all(values[positive] > 0.0))
        and bool(np.all(np.isfinite(scales)) and np.all(scales > 0.0))
        and bool(np.all(np.isfinite(covariance)) and np.all(np.diag(covariance) > 0.0))
    )
    if possible:
        deviations = np.sqrt(np.diag(covariance))
        possible = bool(np.linalg.eigvalsh(covariance / np.outer(deviations, deviations))[0] > 0.0)
    if not possible:
        raise InputError(f"{path}: its effects or its covariance are none that robots can have; run geomid fleet again")
