"""Page and tables (CSV) of a result, made from its files without the recordings."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jinja2 import TemplateError

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import QUANTITIES
from geomid_ros.files.disk import write_text
from geomid_ros.files.models.estimate_file import OF_PAGE, EstimateFile, InertiaEntry
from geomid_ros.files.models.gap_file import ErrorsByStage, GapFile, read_gap
from geomid_ros.files.schema import from_document
from geomid_ros.model.effects import effect_class
from geomid_ros.report.gap_page import GapPage, write_gap_page
from geomid_ros.report.result_pages import write_identification_page
from geomid_ros.resimulation.resimulate import Kind, Resimulated
from geomid_ros.session.options import PathLike

_GAP, _ESTIMATE, _PAGE = "gap.json", "estimate.json", "report.html"


def rebuild_report(folder: PathLike, *, out: PathLike | None = None) -> list[Path]:
    """Write the page and the tables of a result again from its files, without the recordings.

    ``geomid report`` calls this; its options have the same names. Parts that need the recordings, above all time
    series, are left out, and the page says so.

    Args:
        folder: of ``geomid identify`` (estimate.json) or ``geomid gap`` (gap.json).
        out: output folder; None for the same folder.

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
            csv = tables(document)
            file = GapFile.of(document, str(source / _GAP))
            rigid = np.zeros((0, len(file.result.channels)))
            write_gap_page(page, GapPage(file=file, result=file.result, rigid=rigid, simulated=_simulated(file)))
        return [page, *write_tables(target, csv)]
    if not (source / _ESTIMATE).is_file():
        raise InputError(f"{source}: no result is in this folder, neither {_ESTIMATE} nor {_GAP}")
    estimate = EstimateFile.read(source / _ESTIMATE)
    with _needed(source / _ESTIMATE, "geomid identify"):
        if missing := [key for key in OF_PAGE if key not in estimate.document]:
            raise InputError(f"{missing[0]} is not given")
        csv = tables(estimate.document)
        write_identification_page(page, estimate)
    return [page, *write_tables(target, csv)]


@contextmanager
def _needed(path: Path, command: str) -> Iterator[None]:
    """Turn errors about entries that the page needs into one InputError that names the file."""
    try:
        yield
    except (InputError, AttributeError, IndexError, KeyError, TypeError, ValueError, TemplateError) as error:
        raise InputError(
            f"{path}: lacks what its page needs ({str(error).removeprefix(f'{path}: ')}): it was not written by "
            f"'{command}', or by an earlier version; run '{command}' again"
        ) from error


def _simulated(file: GapFile) -> list[Resimulated]:
    """Return the errors of the resimulations in the file, without their motions."""
    kinds: list[tuple[Kind, ErrorsByStage | None]] = [("windows", file.resimulated), ("closed_loop", file.closed_loop)]
    return [
        Resimulated(kind=kind, before=errors["before"], after=errors["after"])
        for kind, errors in kinds
        if errors is not None
    ]


TableRows: TypeAlias = list[dict[str, Any]]
"""A table: a list of rows, each with its cells by column."""

_BETWEEN = ";"
_FINDING = ("probability", "confidence", "share", "separability", "loss", "sentence")


def write_tables(folder: Path, found: Mapping[str, TableRows]) -> list[Path]:
    """Write tables into a folder, one file with its name each.

    Returns:
        The files.

    Raises:
        GeomidError: a file cannot be written.
    """
    files = {folder / f"{name}.csv": rows for name, rows in found.items()}
    for file, rows in files.items():
        write_text(file, csv_text(rows))
    return list(files)


def tables(document: Mapping[str, Any]) -> dict[str, TableRows]:
    """Make the tables of a document, by name: links, effects and channels of an ``estimate.json``, findings of a
    ``gap.json``. Raises AttributeError, KeyError, TypeError or ValueError if the document is incomplete."""
    if "findings" in document:
        return {"findings": list(_findings(document))}
    return {
        "links": [_link(link, document.get("urdf_masses", {})) for link in document["links"]],
        "effects": list(_effects(document)),
        "channels": [dict(channel) for channel in document.get("channels", [])],
    }


def csv_text(rows: TableRows) -> str:
    """Rows as CSV with a header line; unknown values are empty."""
    text = io.StringIO()
    columns = list(dict.fromkeys(column for row in rows for column in row))
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _link(link: Mapping[str, Any], urdf_masses: Mapping[str, float]) -> dict[str, Any]:
    """Quantities and standard deviations of a link, and how well they are identified."""
    numbers: dict[str, float] = {}
    for prefix, entry in {"": link, "std_": link.get("std")}.items():
        if entry is not None:
            sizes = from_document(InertiaEntry, entry, f"link {link['name']}:").quantities.tolist()
            numbers |= {prefix + name.replace(" ", "_"): x for name, x in zip(QUANTITIES, sizes, strict=True)}
    return {
        "link": link["name"],
        "merged": _BETWEEN.join(link.get("merged", ())),
        "urdf_mass": urdf_masses.get(link["name"]),
        **numbers,
        **{key: link[key] for key in ("distance_from_prior", "from_data") if key in link},
        "not_identifiable": _BETWEEN.join(link.get("cannot_tell", ())),
    }


def _effects(document: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a row for each parameter of each effect."""
    for entry in document["effects"]:
        parameter, *constants = effect_class(entry["name"]).parameters
        yield _row(entry["name"], entry, parameter.name, entry) | {"from_data": entry.get("from_data")}
        for form in constants:
            if form.name in entry:
                unit = form.units[parameter.slides_by(entry.get("unit", ""))]
                yield _row(entry["name"], entry, form.name, {"value": entry[form.name], "std": 0.0, "unit": unit})
    for entry in document.get("added", []):
        for name, quantity in entry["parameters"].items():
            yield _row(entry["effect"], entry, name, quantity) | {"from_data": entry.get("from_data")}


def _findings(document: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a row for each parameter of each finding."""
    for entry in document["findings"]:
        for name, quantity in entry["parameters"].items():
            yield _row(entry["effect"], entry, name, quantity) | {key: entry.get(key) for key in _FINDING}


def _row(effect: str, entry: Mapping[str, Any], parameter: str, quantity: Mapping[str, Any]) -> dict[str, Any]:
    numbers = {key: quantity.get(key) for key in ("value", "std", "unit")}
    return {"effect": effect, "joint": entry.get("joint"), "link": entry.get("link"), "parameter": parameter, **numbers}
