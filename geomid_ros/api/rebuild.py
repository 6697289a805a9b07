"""Page and tables of a result, rebuilt from its files without the recordings."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from jinja2 import TemplateError

from geomid_ros.errors import InputError
from geomid_ros.files.models.estimate_file import OF_PAGE, EstimateFile
from geomid_ros.files.models.gap_file import ErrorsByStage, GapFile, read_gap
from geomid_ros.files.models.tables import tables, write_tables
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
