"""A result read again from its files, for its page: what ``estimate.json`` and ``posterior.npz`` say of an estimate."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from geomid_ros.estimation.estimate import EffectEstimate, Estimate, LinkEstimate, LinksInformation, WeighedEstimate
from geomid_ros.estimation.posterior import Posterior
from geomid_ros.files.models.loaded_model import known_effects
from geomid_ros.files.models.results import known_inertias, known_information
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.signals.ledger import Account
from geomid_ros.types import FloatArray

_STD_PRIOR = 13  # quantities and first moments, whose prior no file has


def estimate_of(document: Mapping[str, Any], posterior: Posterior, source: str) -> Estimate:
    """The estimate of a document.

    Args:
        document: of an ``estimate.json``, as ``geomid identify`` writes it.
        posterior: of the same run.
        source: the file, for messages.

    Raises:
        InputError: a link or an effect is none.
        KeyError, TypeError, ValueError: the document lacks something.
    """
    inertias = known_inertias(document, source)
    rows, targets = posterior.evidence
    size, rms = 10 * len(inertias), document["rms"]
    unknown = LinksInformation(np.zeros((size, size)), np.zeros(size))
    return Estimate(
        converged=bool(document["converged"]),
        reason=str(document["reason"]),
        seconds=float(document["seconds"]),
        steps=int(document["steps"]),
        gamma=float(document["gamma"]),
        rows_accepted=int(document["rows"]["accepted"]),
        rows_set_aside=int(document["rows"]["set_aside"]),
        links=tuple(_link(link, inertias[str(link["name"])]) for link in document["links"]),
        effects=tuple(_effects(document, source)),
        parameters=posterior.parameters,
        channels=tuple(rms["train"]),
        sigmas=_numbers(document["sigma"]),
        spreads=np.full(len(inertias), np.nan),
        rms_nominal=_numbers(rms["nominal"]),
        rms=_numbers(rms["train"]),
        information=known_information(document, inertias, source) or unknown,
        posterior=posterior,
        rows=rows,
        targets=targets,
        known=tuple(WeighedEstimate(**entry) for entry in document["known"]),
    )


def _link(link: Mapping[str, Any], parameters: FloatArray) -> LinkEstimate:
    quantities, std = pseudo_inertia.quantities_of(parameters), link["std"]
    return LinkEstimate(
        name=str(link["name"]),
        merged=tuple(map(str, link["merged"])),
        mass=float(quantities[0]),
        com=quantities[1:4],
        inertia=pseudo_inertia.rotational_inertia(quantities),
        std_mass=float(std["mass"]),
        std_com=np.array(std["com"], dtype=float),
        std_inertia=np.array(std["inertia"], dtype=float),
        parameters=parameters,
        distance_from_prior=float(link["distance_from_prior"]),
        from_data=float(link["from_data"]),
        min_eigenvalue_ratio=float(link["min_eigenvalue_ratio"]),
        cannot_tell=tuple(map(str, link["cannot_tell"])),
        moments=tuple(map(str, link["identified_moments"])),
        std_prior=np.full(_STD_PRIOR, np.nan),
        outlier=bool(link["outlier"]),
    )


def _effects(document: Mapping[str, Any], source: str) -> list[EffectEstimate]:
    """The effects that the data say something of."""
    entries = [(entry["name"], entry) for entry in document["effects"]]
    entries += [(entry["effect"], entry) for entry in document.get("added", [])]
    shares = {(name, entry["joint"]): entry["from_data"] for name, entry in entries if "from_data" in entry}
    return [
        EffectEstimate(
            name=effect.effect,
            joint=effect.joint,
            parameters=effect.parameters,
            from_data=float(shares[effect.effect, effect.joint]),
        )
        for effect in known_effects(document, source)
        if (effect.effect, effect.joint) in shares
    ]


def _numbers(entry: Mapping[str, Any]) -> FloatArray:
    return np.array([math.nan if value is None else value for value in entry.values()], dtype=float)


def accounts_of(document: Mapping[str, Any]) -> dict[str, Account]:
    """What became of the messages, by topic. Raises KeyError, TypeError or ValueError for what says no such thing."""
    return {
        str(topic): Account(
            accepted=int(entry["accepted"]),
            lost=int(entry["lost"]),
            **{kind: Counter(entry[kind]) for kind in ("rejected", "dropped", "noted")},
        )
        for topic, entry in document["messages"].items()
    }
