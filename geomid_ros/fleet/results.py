"""The results of a robot, as workers hand them over."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.population import RobotLikelihood
from geomid_ros.estimation.posterior import EffectCoordinate
from geomid_ros.files.disk import write_bytes

_HEADER, _FILE = "header", "file "
_ARRAYS = ("rows", "targets", "parameters", "prior", "scales")


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotResults:
    """The ``files`` of a robot's folder by name, and the ``evidence`` that a population is made of."""

    files: Mapping[str, bytes]
    evidence: RobotLikelihood

    @property
    def encoded(self) -> bytes:
        """As a NumPy archive without pickled objects."""
        header = {"links": self.evidence.links, "effects": [asdict(effect) for effect in self.evidence.effects]}
        arrays = {name: getattr(self.evidence, name) for name in _ARRAYS}
        files = {_FILE + name: np.frombuffer(content, np.uint8) for name, content in self.files.items()}
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, **{_HEADER: np.array(json.dumps(header))}, **arrays, **files)
        return content.getvalue()

    @staticmethod
    def decoded(content: bytes) -> RobotResults:
        """From such an archive. Raises InputError for what is none."""
        try:
            return RobotResults._read(content)
        except (zipfile.BadZipFile, KeyError, TypeError, ValueError, EOFError) as error:
            raise InputError(f"the stored result of a robot cannot be read ({error})") from error

    @staticmethod
    def _read(content: bytes) -> RobotResults:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            header = json.loads(str(archive[_HEADER]))
            evidence = RobotLikelihood(
                links=tuple(header["links"]),
                effects=tuple(EffectCoordinate(**entry) for entry in header["effects"]),
                **{name: archive[name] for name in _ARRAYS},
            )
            files = {key[len(_FILE) :]: archive[key].tobytes() for key in archive.files if key.startswith(_FILE)}
        return RobotResults(files=files, evidence=evidence)

    @property
    def document(self) -> dict[str, Any]:
        """What ``estimate.json`` says."""
        document: dict[str, Any] = json.loads(self.files["estimate.json"])
        return document

    def write(self, folder: Path) -> None:
        """Write the files into a folder. Raises GeomidError if they cannot be written."""
        for name, content in self.files.items():
            write_bytes(folder / Path(name).name, content)
