"""Tables of a result as CSV, for spreadsheets and data frames, made from its document alone."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeAlias

from geomid_ros.estimation.uncertain_inertia import QUANTITIES
from geomid_ros.files.disk import write_text
from geomid_ros.files.models.estimate_file import InertiaEntry
from geomid_ros.files.schema import from_document
from geomid_ros.model.effects import effect_class

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
                yield _row(
                    entry["name"], entry, form.name, {"value": entry[form.name], "std": 0.0, "unit": form.units[0]}
                )
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
