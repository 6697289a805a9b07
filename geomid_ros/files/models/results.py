"""``estimate.json``: an estimate on disk, written for people and programs, and read again as a starting point."""

from __future__ import annotations

import base64
import json
import reprlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import FINEST, Estimate, LinksInformation
from geomid_ros.files.disk import read_text
from geomid_ros.files.models.effect_forms import (
    by_channel,
    coefficient_entry,
    combined,
    continued,
    effect_entry,
    is_coefficient,
)
from geomid_ros.files.models.urdf import Inertia
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.model.effects import KnownEffect
from geomid_ros.model.robot import GRAVITY
from geomid_ros.types import FloatArray

FORMAT = 1
_MOST_BYTES = 5_000_000
_MOST_LINKS = 1000
_MOST_LINKS_TOGETHER = 100  # of more, what is known of all together would be most of the file
_MOST_EFFECTS = 10_000
_LARGEST = 1e50  # products of three still fit
_LARGEST_RESIDUAL = 1e9
_PACKED = "<f4"
_WITHOUT_INFORMATION = "identify again, or delete 'information', without which less is known of payloads"


def estimate_document(
    estimate: Estimate,
    rows_rejected: Mapping[str, int],
    held_out: FloatArray | None = None,
    known: Sequence[KnownEffect] = (),
) -> dict[str, Any]:
    """The document of an estimate.

    Args:
        estimate: what was found.
        rows_rejected: how many rows were not used, by reason.
        held_out: RMS residuals ``(channels,)`` on data that were not used, if any were held out.
        known: the effects of the model that the estimation began with.
    """
    effects = model_effects(estimate, known)
    shares = shares_from_data(estimate)
    rms = {"nominal": estimate.rms_nominal, "train": estimate.rms, "held_out": held_out}
    return {
        "format": FORMAT,
        "converged": estimate.converged,
        "reason": estimate.reason,
        "seconds": round(estimate.seconds, 3),
        "steps": estimate.steps,
        "gamma": estimate.gamma,
        "rows": {
            "accepted": estimate.rows_accepted,
            "set_aside": estimate.rows_set_aside,
            "rejected": {reason: count for reason, count in sorted(rows_rejected.items()) if count},
        },
        "links": [
            link_entry(link.name, link.merged, (link.mass, link.com, link.inertia))
            | {
                "std": _inertia_entries(link.std_mass, link.std_com, link.std_inertia),
                "distance_from_prior": link.distance_from_prior,
                "from_data": link.from_data,
                "min_eigenvalue_ratio": link.min_eigenvalue_ratio,
                "cannot_tell": list(link.cannot_tell),
                "identified_moments": list(link.moments),
                "outlier": link.outlier,
            }
            for link in estimate.links
        ],
        "effects": [
            coefficient_entry(effect) | {"from_data": shares[effect.effect, effect.joint]}
            for effect in effects
            if is_coefficient(effect)
        ],
        "added": [
            effect_entry(effect) | ({"from_data": shares[key]} if key in shares else {})
            for effect in effects
            if not is_coefficient(effect)
            for key in [(effect.effect, effect.joint)]
        ],
        "known": [
            {"name": k.name, "mass": k.mass, "std": k.std, "given": k.given, "given_std": k.given_std}
            for k in estimate.known
        ],
        "rms": {
            kind: None if values is None else by_channel(estimate.channels, values) for kind, values in rms.items()
        },
        "sigma": by_channel(estimate.channels, estimate.sigmas),
        "information": _together(estimate) if len(estimate.links) <= _MOST_LINKS_TOGETHER else None,
    }


def shares_from_data(estimate: Estimate) -> dict[tuple[str, str], float]:
    """Share of an effect's uncertainty that the data removed, by its name and place: the mean over its coefficients."""
    found: dict[tuple[str, str], list[float]] = {}
    for effect in estimate.effects:
        found.setdefault((effect.name, effect.joint), []).append(effect.from_data)
    return {key: float(np.mean(shares)) for key, shares in found.items()}


def link_entry(name: str, merged: Sequence[str], inertia: Inertia) -> dict[str, Any]:
    """A link with its inertia and the fixed links that are merged into it."""
    return {"name": name, "merged": list(merged)} | _inertia_entries(*inertia)


def _inertia_entries(mass: float, com: FloatArray, inertia: FloatArray) -> dict[str, Any]:
    return {"mass": mass, "com": com.tolist(), "inertia": inertia.tolist()}


def model_effects(estimate: Estimate, known: Sequence[KnownEffect]) -> list[KnownEffect]:
    """All effects of the model with an estimate that began with the ``known`` ones, as files have them."""
    found = combined(KnownEffect(effect.name, effect.joint, "", effect.parameters) for effect in estimate.effects)
    return continued(found, known)


def _together(estimate: Estimate) -> dict[str, Any]:
    rows = estimate.information.rows
    return {
        "links": [link.name for link in estimate.links],
        "rows": _packed(rows[np.triu_indices(len(rows))]),
        "residuals": _packed(estimate.information.residuals),
    }


def _packed(numbers: FloatArray) -> str:
    """Little-endian numbers of four bytes in base64: seven digits do, and nobody reads so many."""
    return base64.b64encode(numbers.astype(_PACKED).tobytes()).decode()


def read_estimate(path: Path) -> dict[str, Any]:
    """Read an estimate's document. Raises InputError naming the file."""
    try:
        document = json.loads(read_text(path, "model", _MOST_BYTES))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: the model cannot be read ({error})") from error
    if not isinstance(document, dict) or not {"links", "effects"} <= document.keys():
        raise InputError(f"{path}: not an estimate.json, it has no 'links' and 'effects'")
    if document.get("format") != FORMAT:
        raise InputError(f"{path}: has format {document.get('format')}, this version reads format {FORMAT}")
    for key, most in (("links", _MOST_LINKS), ("effects", _MOST_EFFECTS), ("added", _MOST_EFFECTS)):
        _check_list(document.get(key, []), most, f"{path}: {key}")
    for entry in document["effects"]:
        if "name" not in entry:
            raise InputError(f"{path}: an effect lacks a valid name, joint or value")
    return document


def _check_list(found: Any, most: int, where: str) -> None:
    if not isinstance(found, list) or len(found) > most:
        raise InputError(f"{where} is {reprlib.repr(found)}, expected a list of at most {most}")
    for index, entry in enumerate(found):
        if not isinstance(entry, dict):
            raise InputError(f"{where}[{index}] is {reprlib.repr(entry)}, expected an object")


def known_inertias(document: Mapping[str, Any], source: str) -> dict[str, FloatArray]:
    """Parameters ``(10,)`` in pinocchio's order of the links in a document, by name."""
    known: dict[str, FloatArray] = {}
    for link in document["links"]:
        parameters, name = _inertia(link, source), str(link["name"])
        if name in known:
            raise InputError(f"{source}: there are two links '{name}', expected each once")
        known[name] = parameters
    return known


def gravity_of(document: Mapping[str, Any], source: str) -> FloatArray:
    """Gravity ``(3,)`` [m/s^2] that a document is for, where the base stands straight. Raises InputError for what is no
    such thing."""
    try:
        found = np.array(document.get("gravity", GRAVITY), dtype=np.float64).reshape(3)
    except (TypeError, ValueError) as error:
        raise InputError(f"{source}: gravity is no list of three numbers ({error})") from error
    if not np.all(np.abs(found) < _LARGEST):
        raise InputError(f"{source}: gravity is {found.tolist()}, expected three finite numbers")
    return found


def known_information(
    document: Mapping[str, Any], inertias: Mapping[str, FloatArray], source: str
) -> LinksInformation | None:
    """What a document says of its links together, which have these ``inertias (10,)``, in their order; None if it says
    nothing.

    Raises InputError for what is no such thing.
    """
    if (entry := document.get("information")) is None:
        return None
    size = 10 * len(inertias)
    try:
        names = list(entry["links"])
        triangle = _unpacked(entry["rows"]).reshape(size * (size + 1) // 2)  # as many as the file has room for
        residuals = _unpacked(entry["residuals"]).reshape(size)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        what = f"the information on {len(inertias)} links cannot be read ({error})"
        raise InputError(f"{source}: {what}; {_WITHOUT_INFORMATION}") from error
    if names != list(inertias):
        what = "the information is on other links than those listed, or in another order"
        raise InputError(f"{source}: {what}; {_WITHOUT_INFORMATION}")
    rows = np.zeros((size, size))
    rows[np.triu_indices(size)] = triangle
    if not _can_be_measured(rows, inertias) or not np.all(np.abs(residuals) < _LARGEST_RESIDUAL):
        what = "the information on the links is more than any measurement can tell"
        raise InputError(f"{source}: {what}; {_WITHOUT_INFORMATION}")
    return LinksInformation(rows, residuals)


def _can_be_measured(rows: FloatArray, inertias: Mapping[str, FloatArray]) -> bool:
    """Whether rows ``(n, 10 links)`` determine no inertia more finely than it is believed."""
    manifold = ParameterManifold(len(inertias), 0, np.zeros(0))
    if not np.all(np.isfinite(rows)):
        return False
    with np.errstate(all="ignore"):  # of bodies beyond all measure; what is no number is refused
        whitened = manifold.whiten(manifold.point(np.concatenate([*inertias.values()])), rows)
    return bool(np.all(np.abs(whitened) < 2.0 * FINEST))  # rounded to seven digits


def _unpacked(text: Any) -> FloatArray:
    return np.frombuffer(base64.b64decode(text, validate=True), _PACKED).astype(np.float64)


def _inertia(link: Mapping[str, Any], source: str) -> FloatArray:
    """Parameters ``(10,)`` of a link's entry."""
    try:
        mass, com, inertia = (np.array(link[key], dtype=float) for key in ("mass", "com", "inertia"))
        parts = mass.reshape(()), com.reshape(3), inertia.reshape(3, 3)
        name = link["name"]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{source}: a link lacks a valid mass, com or inertia ({error})") from error
    usable = all(np.all(np.abs(part) < _LARGEST) for part in parts)
    parameters = pseudo_inertia.assemble(*parts) if usable else np.zeros(10)
    if not np.linalg.eigvalsh(pseudo_inertia.from_parameters(parameters))[0] > 0.0:
        raise InputError(f"{source}: the inertia of link '{name}' belongs to no body that can exist")
    return parameters
