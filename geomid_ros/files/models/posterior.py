"""``posterior.npz``, next to ``estimate.json``: joint posterior of links and effects, and the model's remainder; and
``population.json``: the distribution of robots of one type, written by ``geomid fleet`` and read as a prior.

The first is a NumPy archive without pickled objects. ``posterior`` is a JSON text: ``format``, ``links`` (``name``,
``merged``) and ``effects`` (``name``, ``place``, ``parameter``, ``unit``, ``positive``). The float64 arrays are fields
of :class:`~geomid_ros.estimation.posterior.Posterior`, which describes them; ``prior_spreads`` is ``prior_stds``.

From format 2 on, ``remainder`` in that text may hold ``joints`` and ``channels`` of a
:class:`~geomid_ros.gap.features.KnownRemainder`. Then ``knots`` are those of its basis. Each channel has
``scales_N``, ``mean_N``, which is empty if nothing is known, and ``triangle_N``: the upper triangle, row by row, in
float32.

In ``population.json``, ``links`` have ``name``, ``mass``, ``com`` and ``inertia`` as in ``estimate.json``. ``effects``
have ``name``, ``place``, ``parameter``, ``unit``, ``positive``, ``value`` and, if not positive, ``scale``.
``covariance`` is the upper triangle, row by row, of the covariance of a robot's tangent coordinates at these values:
little-endian float64 in base64. The coordinates of a link belong to the symmetric matrix X in ``P^1/2 exp(X) P^1/2``,
where P is its pseudo-inertia ``[[S, h], [h, m]]`` about the link's origin: X11, X22, X33, X44, and sqrt(2) times X12,
X13, X14, X23, X24, X34. A positive coefficient c becomes ``c exp(x)``, another coefficient r with scale s ``r + s x``.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from geomid_ros.errors import InputError, refusing
from geomid_ros.estimation.population import Population
from geomid_ros.estimation.posterior import EffectCoordinate, Posterior
from geomid_ros.estimation.tolerances import ROUNDING
from geomid_ros.files import schema
from geomid_ros.files.disk import read_bytes, write_bytes, write_json
from geomid_ros.files.models.estimate_file import LinkEntry, inertias_of, link_entry
from geomid_ros.files.schema import from_document, from_upper_triangle, to_base64, to_document, upper_triangle
from geomid_ros.gap.features import LARGEST_SCALE, Basis, KnownRemainder
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.types import AnyArray, FloatArray, IntArray, frozen

POSTERIOR = "posterior.npz"
FORMAT = 2
RTOL = 1e-6
"""Relative tolerance between the same number in two files, of which one has fewer digits."""
_HEADER = "posterior"
_VECTORS = {"parameters": "parameters", "prior": "prior", "prior_spreads": "prior_stds"}  # by their names in the file
_MOST_PARAMETERS = 2000

# Errors of NumPy, zipfile and json; RuntimeError for encrypted files, MemoryError for an array that is not there.
_UNREADABLE = (zipfile.BadZipFile, LookupError, TypeError, ValueError, RuntimeError, EOFError, MemoryError)
_Arrays: TypeAlias = Mapping[str, AnyArray]


def write_posterior(path: Path, posterior: Posterior, remainder: KnownRemainder | None = None) -> list[Path]:
    """Write a posterior, and the model's remainder if it is known, valid and not larger than the largest posterior.
    Nothing is written for a robot with more than 2000 parameters. Returns the files.

    Raises GeomidError naming the file.
    """
    if len(posterior.parameters) > _MOST_PARAMETERS:
        return []
    header = {
        "format": FORMAT,
        "links": [
            {"name": name, "merged": merged} for name, merged in zip(posterior.links, posterior.merged, strict=True)
        ],
        "effects": to_document(posterior.effects),
    }
    arrays = {"scales": posterior.scales, "covariance": posterior.covariance}
    arrays |= {name: getattr(posterior, attribute) for name, attribute in _VECTORS.items()}
    size = sum(4 * len(mean) * (len(mean) + 5) for mean in remainder.means) if remainder else 0  # upper bound [bytes]
    if remainder is not None and size < 8 * _MOST_PARAMETERS**2 and not _objection(remainder):
        header["remainder"] = {"joints": remainder.joints, "channels": remainder.channels}
        arrays |= _arrays_of(remainder)
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **{_HEADER: np.array(json.dumps(header))}, **arrays)
    write_bytes(path, content.getvalue())
    return [path]


def posterior_path(estimate: Path) -> Path:
    """Path of the posterior that was written with an ``estimate.json``. Raises InputError if there is none."""
    path = estimate.with_name(POSTERIOR)
    if estimate.is_file() and not path.is_file():
        raise InputError(
            f"{estimate}: {POSTERIOR} (the uncertainty of the estimate) is missing in the same folder. Only 'geomid "
            "identify' writes it: keep its files together in one folder, or identify again"
        )
    return path


def read_posterior(path: Path) -> Posterior:
    """Read a posterior. Raises InputError naming the file."""
    with _opened(path) as (arrays, header):
        links, effects = header.links, header.effects
        if [e.positive for e in effects] != sorted((e.positive for e in effects), reverse=True):
            raise InputError("its text: effects are not in order, expected the positive ones first")
        positives = sum(effect.positive for effect in effects)
        size = 10 * len(links) + len(effects)
        posterior = Posterior(
            links=tuple(link.name for link in links),
            merged=tuple(link.merged for link in links),
            effects=effects,
            covariance=_numbers(arrays, "covariance", (size, size)),
            scales=_numbers(arrays, "scales", (len(effects) - positives,)),
            **{attribute: _numbers(arrays, name, (size,)) for name, attribute in _VECTORS.items()},
        )
        _check(posterior)
        return posterior


def check_matches_estimate(posterior: Posterior, file: Path, inertias: Mapping[str, FloatArray], source: str) -> None:
    """Raise InputError unless a posterior, read from a ``file``, belongs to the estimate ``source``, which has these
    ``inertias (10,)`` by link."""
    if posterior.links != tuple(inertias):
        raise InputError(
            f"{file}: its links are {', '.join(posterior.links)}, those of {source} are {', '.join(inertias)}"
        )
    links = posterior.parameters[posterior.manifold.inertial].reshape(-1, 10)
    for link, inertia in zip(links, inertias.values(), strict=True):
        if not np.allclose(link, inertia, rtol=RTOL, atol=RTOL * np.max(np.abs(inertia))):
            raise InputError(f"{file}: belongs to another estimate than {source}; keep the files of one run together")


def places_in(posterior: Posterior, model: MeasurementModel) -> IntArray:
    """Index ``(D,)`` in a posterior of each parameter of a model; -1 where it has none."""
    bodies = {name: 10 * place for place, name in enumerate(posterior.links)}
    effects = {(e.name, e.place, e.parameter): place for place, e in enumerate(posterior.effects, 10 * len(bodies))}
    links = [bodies[name] + np.arange(10) if name in bodies else np.full(10, -1) for name in model.body_names]
    coefficients = [effects.get((c.effect.name, c.place_name, c.parameter), -1) for c in model.coefficients]
    return np.concatenate([*links, np.array(coefficients, dtype=np.int64)])


def read_remainder(path: Path) -> KnownRemainder | None:
    """Read the model's remainder; None if the file has none. Raises InputError naming the file."""
    with _opened(path) as (arrays, header):
        if header.remainder is None:
            return None
        joints, channels = header.remainder["joints"], header.remainder["channels"]
        knots, scales, means, triangles = _numbers(arrays, "knots", (len(joints), 3, 2)), [], [], []
        for place in range(len(channels)):
            size, columns = len(arrays[f"mean_{place}"]), len(arrays[f"scales_{place}"])
            rows = _numbers(arrays, f"triangle_{place}", (size * (size + 1) // 2,), np.float32)
            scales.append(_numbers(arrays, f"scales_{place}", (size or columns,)))
            means.append(_numbers(arrays, f"mean_{place}", (size,)))
            triangles.append(from_upper_triangle(rows, (size, size)))
        remainder = KnownRemainder(
            joints=joints,
            channels=channels,
            basis=Basis(knots, tuple(scales)),
            means=tuple(means),
            triangles=tuple(triangles),
        )
        if objection := _objection(remainder):
            raise InputError(objection)
        return remainder


@dataclass(frozen=True, kw_only=True)
class _Link:
    name: str
    merged: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class _Header:
    """Schema of the JSON text."""

    links: tuple[_Link, ...]
    effects: tuple[EffectCoordinate, ...]
    remainder: Mapping[str, tuple[str, ...]] | None = None


@contextmanager
def _opened(path: Path) -> Iterator[tuple[_Arrays, _Header]]:
    """Yield the arrays and the header of a file. Whatever is wrong with them becomes an InputError naming the file."""
    content = read_bytes(path, "posterior")
    try:
        arrays = _unpacked(content)
        document = json.loads(str(arrays[_HEADER]))
        if document["format"] not in (1, FORMAT):
            raise InputError(f"has format {document['format']!r}, this version reads formats 1 and {FORMAT}")  # noqa: TRY301
        yield arrays, from_document(_Header, document, "its text:")
    except InputError as error:
        raise InputError(f"{path}: {error}; identify again") from error
    except _UNREADABLE as error:
        raise InputError(f"{path}: the posterior cannot be read ({error}); identify again") from error


def _unpacked(content: bytes) -> _Arrays:
    """All arrays. Refuses compressed ones, as they may be larger than any memory."""
    with np.load(io.BytesIO(content), allow_pickle=False) as members:
        if any(member.compress_type != zipfile.ZIP_STORED for member in members.zip.infolist()):
            raise InputError("its arrays are compressed")
        arrays = dict(members)
    if not all(isinstance(array, np.ndarray) for array in arrays.values()):
        raise InputError("contains an object that is not an array")
    return arrays


def _objection(remainder: KnownRemainder) -> str:
    """Reason why a remainder is invalid; empty if it is valid."""
    knots, scales = remainder.basis.knots, remainder.basis.scales
    if not np.all(knots[:, :, 0] <= knots[:, :, 1]):
        return "contains a remainder with invalid ranges"
    if not all(np.all((array > 0.0) & (array <= LARGEST_SCALE)) for array in scales):
        return "contains a remainder with invalid scales"
    if not all(np.all(np.isfinite(array)) for array in (knots, *remainder.means, *remainder.triangles)):
        return "contains a remainder that is not finite"
    return ""


def _arrays_of(remainder: KnownRemainder) -> dict[str, FloatArray]:
    arrays: dict[str, Any] = {"knots": remainder.basis.knots}
    for place, (scales, mean, triangle) in enumerate(
        zip(remainder.basis.scales, remainder.means, remainder.triangles, strict=True)
    ):
        rows = upper_triangle(triangle).astype(np.float32)
        arrays |= {f"scales_{place}": scales, f"mean_{place}": mean, f"triangle_{place}": rows}
    return arrays


def _check(posterior: Posterior) -> None:
    """Raise InputError for an invalid posterior."""
    manifold = posterior.manifold
    for parameters in (posterior.parameters, posterior.prior):
        point = manifold.point(parameters)
        if not (np.all(np.linalg.eigvalsh(point.pseudo_inertias) > 0.0) and np.all(point.positives > 0.0)):
            raise InputError("contains a body that is not physically consistent, or a coefficient that is not positive")
    if not (np.all(posterior.scales > 0.0) and np.all(posterior.prior_stds > 0.0)):
        raise InputError("contains a scale or a prior standard deviation that is not positive")
    covariance = posterior.covariance
    deviations = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    scaled = covariance / np.outer(deviations, deviations)
    if not np.allclose(scaled, scaled.T, rtol=0.0, atol=ROUNDING) or np.linalg.eigvalsh(scaled)[0] < -ROUNDING:
        raise InputError("contains a covariance that is not positive semidefinite")


def _numbers(arrays: _Arrays, name: str, shape: tuple[int, ...], kind: type[np.floating] = np.float64) -> FloatArray:
    array = arrays[name]
    if array.shape != shape or array.dtype != kind or not np.all(np.isfinite(array)):
        expected = f"finite {np.dtype(kind)} of {shape}"
        raise InputError(f"'{name}' is {array.dtype} of shape {array.shape}, expected {expected}")
    return frozen(array)


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
    return {
        "format": schema.FORMAT,
        "robots": population.robots,
        "links": [link_entry(name, (), parameters) for name, parameters in zip(population.links, bodies, strict=True)],
        "effects": [
            to_document(effect) | {"value": value} | ({} if effect.positive else {"scale": next(scales)})
            for effect, value in zip(population.effects, values, strict=True)
        ],
        "covariance": to_base64(upper_triangle(population.covariance), _NUMBER),
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
    document = schema.read_document(path, "population", ("robots", "links", "effects", "covariance"))
    content = from_document(_PopulationDocument, document, f"{path}:")
    inertias, effects = inertias_of(content.links, str(path)), content.effects
    with refusing(f"{path}: covariance is not of its links and effects", ValueError, advice="run geomid fleet again"):
        triangle = schema.triangle_from_base64(content.covariance, _NUMBER, 10 * len(inertias) + len(effects))
    covariance = triangle + np.triu(triangle, 1).T
    values = np.array([effect.value for effect in effects])
    scales = np.array([effect.scale for effect in effects if not effect.positive])
    coordinates = tuple(EffectCoordinate(**{key: getattr(effect, key) for key in _OF_EFFECT}) for effect in effects)
    _check_population(path, coordinates, values, scales, covariance)
    return Population(
        links=tuple(inertias),
        effects=coordinates,
        parameters=frozen(np.concatenate([*inertias.values(), values])),
        covariance=frozen(covariance),
        scales=frozen(scales),
        robots=content.robots,
    )


def _check_population(
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
