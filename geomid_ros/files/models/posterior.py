"""``posterior.npz``: the joint posterior of links and effects on disk, beside ``estimate.json``.

A NumPy archive without pickled objects. ``posterior`` is a JSON text: ``format``, ``links`` (``name``, ``merged``) and
``effects`` (``name``, ``place``, ``parameter``, ``unit``, ``positive``). The arrays of float64 are the fields of
:class:`~geomid_ros.estimation.posterior.Posterior` of the same names, where their coordinates are described.
"""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.posterior import EffectCoordinate, Posterior
from geomid_ros.files.disk import read_bytes, write_bytes
from geomid_ros.types import AnyArray, FloatArray, frozen

POSTERIOR = "posterior.npz"
FORMAT = 1
_HEADER = "posterior"
_VECTORS = ("parameters", "prior", "prior_spreads")
_MOST_PARAMETERS = 2000
_MOST_HEADER = 2_000_000  # bytes
_ENCRYPTED = 1  # bit of a zip entry's flags
_MOST_BYTES = 8 * _MOST_PARAMETERS * (_MOST_PARAMETERS + 8) + _MOST_HEADER
_ROUNDING = 1e-8
_UNREADABLE = (zipfile.BadZipFile, KeyError, TypeError, ValueError, RecursionError, EOFError, NotImplementedError)


def write_posterior(path: Path, posterior: Posterior) -> list[Path]:
    """Write a posterior; of a robot with more than 2000 parameters, none. Returns the files.

    Raises GeomidError naming the file.
    """
    if len(posterior.parameters) > _MOST_PARAMETERS:
        return []
    header = {
        "format": FORMAT,
        "links": [
            {"name": name, "merged": merged} for name, merged in zip(posterior.links, posterior.merged, strict=True)
        ],
        "effects": [asdict(effect) for effect in posterior.effects],
    }
    arrays = {name: getattr(posterior, name) for name in (*_VECTORS, "scales", "covariance")}
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **{_HEADER: np.array(json.dumps(header))}, **arrays)
    write_bytes(path, content.getvalue())
    return [path]


def beside(estimate: Path) -> Path:
    """The posterior that was written with an ``estimate.json``. Raises InputError if there is none."""
    path = estimate.with_name(POSTERIOR)
    if estimate.is_file() and not path.is_file():
        raise InputError(
            f"{estimate}: there is no {POSTERIOR} beside it, which says how well the robot is known. Only 'geomid "
            "identify' writes it: keep its files together in one folder, or identify again"
        )
    return path


def read_posterior(path: Path) -> Posterior:
    """Read a posterior. Raises InputError naming the file."""
    content = read_bytes(path, "posterior", _MOST_BYTES)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            return _posterior(archive)
    except InputError as error:
        raise InputError(f"{path}: {error}; identify again") from error
    except _UNREADABLE as error:
        raise InputError(f"{path}: the posterior cannot be read ({error}); identify again") from error


def _posterior(archive: zipfile.ZipFile) -> Posterior:
    header = json.loads(str(_array(archive, _HEADER)))
    if header["format"] != FORMAT:
        raise InputError(f"has format {header['format']!r}, this version reads format {FORMAT}")
    links, effects = header["links"], [EffectCoordinate(**entry) for entry in header["effects"]]
    _check_names(links, effects)
    positives = sum(effect.positive for effect in effects)
    size = 10 * len(links) + len(effects)
    posterior = Posterior(
        links=tuple(link["name"] for link in links),
        merged=tuple(tuple(link["merged"]) for link in links),
        effects=tuple(effects),
        covariance=_numbers(archive, "covariance", (size, size)),
        scales=_numbers(archive, "scales", (len(effects) - positives,)),
        **{name: _numbers(archive, name, (size,)) for name in _VECTORS},
    )
    _check(posterior)
    return posterior


def _check_names(links: Any, effects: list[EffectCoordinate]) -> None:
    named = [name for link in links for name in (link["name"], *link["merged"])]
    named += [text for e in effects for text in (e.name, e.place, e.parameter, e.unit)]
    positive = [effect.positive for effect in effects]
    if not all(isinstance(name, str) for name in named) or positive != sorted(positive, key=lambda p: p is not True):
        raise InputError("links or effects are not named as expected")


def _check(posterior: Posterior) -> None:
    """Raise InputError for what no estimate can be."""
    manifold = posterior.manifold
    for parameters in (posterior.parameters, posterior.prior):
        point = manifold.point(parameters)
        if not (np.all(np.linalg.eigvalsh(point.pseudo_inertias) > 0.0) and np.all(point.positives > 0.0)):
            raise InputError("holds a body or a coefficient that cannot exist")
    if not (np.all(posterior.scales > 0.0) and np.all(posterior.prior_spreads > 0.0)):
        raise InputError("holds a scale or a spread that is not greater than zero")
    covariance = posterior.covariance
    deviations = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    scaled = covariance / np.outer(deviations, deviations)
    if not np.allclose(scaled, scaled.T, rtol=0.0, atol=_ROUNDING) or np.linalg.eigvalsh(scaled)[0] < -_ROUNDING:
        raise InputError("holds a covariance that is not positive semidefinite")


def _numbers(archive: zipfile.ZipFile, name: str, shape: tuple[int, ...]) -> FloatArray:
    array = _array(archive, name)
    if array.shape != shape or array.dtype != np.float64 or not np.all(np.isfinite(array)):
        raise InputError(f"'{name}' is {array.dtype} of shape {array.shape}, expected finite float64 of {shape}")
    return frozen(array)


def _array(archive: zipfile.ZipFile, name: str) -> AnyArray:
    """An array of the archive; one that is larger than its file is not made."""
    entry = archive.getinfo(f"{name}.npy")
    if entry.compress_type != zipfile.ZIP_STORED or entry.flag_bits & _ENCRYPTED:
        raise InputError(f"'{name}' is compressed or encrypted")
    content = io.BytesIO(archive.read(entry))
    if np.lib.format.read_magic(content) != (1, 0):
        raise InputError(f"'{name}' is no array of NumPy's format 1.0")
    shape, _, dtype = np.lib.format.read_array_header_1_0(content)
    if dtype.hasobject or dtype.itemsize * int(np.prod(shape, dtype=object)) != entry.file_size - content.tell():
        raise InputError(f"'{name}' is torn, or of objects")
    content.seek(0)
    return np.asarray(np.lib.format.read_array(content, allow_pickle=False))
