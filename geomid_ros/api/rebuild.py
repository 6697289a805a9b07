"""From the files of a result to its page and tables, without the recordings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jinja2 import TemplateError

from geomid_ros.api.arguments import PathLike
from geomid_ros.errors import InputError
from geomid_ros.files.models.gap_reading import gap_of, number, read_gap
from geomid_ros.files.models.judgements import doubts_of, read_verdict
from geomid_ros.files.models.loaded_model import known_effects
from geomid_ros.files.models.posterior import beside, read_posterior
from geomid_ros.files.models.reading import accounts_of, estimate_of
from geomid_ros.files.models.results import read_estimate
from geomid_ros.files.models.sidecar import effect_of
from geomid_ros.files.models.tables import tables, write_tables
from geomid_ros.report.gap_page import GapPage, write_gap_page
from geomid_ros.report.identification_page import IdentificationPage, Origin, write_identification_page
from geomid_ros.report.series import SavedFit
from geomid_ros.report.simulated_again import SENTENCES, SimulatedAgain

_GAP, _ESTIMATE, _PAGE = "gap.json", "estimate.json", "report.html"


def rebuild_report(folder: PathLike, *, out: PathLike | None = None) -> list[Path]:
    """Write the page and the tables of a result again from its files, without the recordings.

    ``geomid report`` calls this; its options have the same names. What needs the recordings, above all time series, is
    left out, and the page says so.

    Args:
        folder: of ``geomid identify`` (estimate.json with posterior.npz) or ``geomid gap`` (gap.json).
        out: folder of what is written; None for the same.

    Returns:
        The files.

    Raises:
        InputError: the folder has no result, or one of an earlier version.
    """
    source, target = Path(folder), Path(folder if out is None else out)
    page = target / _PAGE
    if (source / _GAP).is_file():
        document = read_gap(source / _GAP)
        with _needed(source / _GAP, "geomid gap"):
            found = tables(document)
            write_gap_page(page, _gap_page(document, str(source / _GAP)), lambda _: None)
        return [page, *write_tables(target, found)]
    if not (source / _ESTIMATE).is_file():
        raise InputError(f"{source}: no result is in this folder, neither {_ESTIMATE} nor {_GAP}")
    document = read_estimate(source / _ESTIMATE)
    with _needed(source / _ESTIMATE, "geomid identify"):
        found = tables(document)
        write_identification_page(page, _identification_page(document, source / _ESTIMATE))
    return [page, *write_tables(target, found)]


@contextmanager
def _needed(path: Path, command: str) -> Iterator[None]:
    """Say of a file that lacks what its page needs which one it is. Raises InputError."""
    try:
        yield
    except (AttributeError, IndexError, KeyError, TypeError, ValueError, TemplateError) as error:
        raise InputError(
            f"{path}: lacks what its page needs ({error}): it was not written by '{command}', or by an earlier "
            f"version; run '{command}' again"
        ) from error


def _identification_page(document: Mapping[str, Any], path: Path) -> IdentificationPage:
    source = str(path)
    estimate = estimate_of(document, read_posterior(beside(path)), source)
    masses, rows = document["urdf_masses"], document["channels"]
    written: Mapping[str, Any] = next((own for own in document["handover"].values() if "file" in own), {})
    return IdentificationPage(
        robot=str(document["robot"]),
        verdict=read_verdict(document, source),
        warnings=document["warnings"],
        notes=document["notes"],
        estimate=estimate,
        masses=np.array([float(masses[link.name]) for link in estimate.links]),
        effects=known_effects(document, source),
        series=[SavedFit(row["channel"], row["unit"], (row["urdf"], row["identified"])) for row in rows],
        held_out=document["rms"]["held_out"] is not None,
        file=str(written.get("file", "identified.urdf")),
        alone=_numbers(written.get("alone", {})),
        corrected=_numbers(written.get("corrected", {})),
        telling=document["telling"],
        messages=accounts_of(document),
        refused_rows=document["rows"]["rejected"],
        origin=Origin(**document["origin"]),
    )


def _numbers(given: Mapping[str, Any]) -> dict[str, float]:
    return {name: math.nan if value is None else float(value) for name, value in given.items()}


def _gap_page(document: Mapping[str, Any], source: str) -> GapPage:
    result, nominal = gap_of(document, source)
    return GapPage(
        robot=str(document["robot"]),
        recordings=document["recordings"],
        joints=[],
        units=[],
        result=result,
        nominal=nominal,
        rigid=np.zeros((0, len(result.channels))),
        known=[effect_of(entry, f"{source}: known") for entry in document["known"]],
        simulated=_simulated(document),
        not_simulated=str(document["not_simulated"]),
        seconds=float(document["judged_seconds"]),
        doubts=doubts_of(document),
        warnings=document["warnings"],
        notes=document["notes"],
    )


def _simulated(document: Mapping[str, Any]) -> list[SimulatedAgain]:
    """The errors of the simulations that there were, without their motions."""
    nothing = np.zeros((0, 0))
    kinds: list[tuple[Literal["windows", "closed_loop"], Any]]
    kinds = [("windows", document["resimulated"]), ("closed_loop", document["closed_loop"])]
    return [
        SimulatedAgain(
            kind=kind,
            sentence=SENTENCES[kind],
            errors={key: {name: number(value) for name, value in own.items()} for key, own in errors.items()},
            joints=[],
            units=[],
            times=np.zeros(0),
            measured=nothing,
            before=nothing,
            after=nothing,
        )
        for kind, errors in kinds
        if errors is not None
    ]
