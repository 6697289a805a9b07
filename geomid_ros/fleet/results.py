"""The results of a robot, as workers hand them over, and what of it has changed since earlier ones."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.estimation.comparison import compared
from geomid_ros.estimation.population import RobotLikelihood
from geomid_ros.estimation.posterior import EffectCoordinate
from geomid_ros.files.disk import write_bytes
from geomid_ros.files.models.estimate_file import EstimateFile

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
    def estimate(self) -> EstimateFile:
        """What ``estimate.json`` says."""
        return EstimateFile.of(json.loads(self.files["estimate.json"]), "the new estimate")

    def write(self, folder: Path) -> None:
        """Write the files into a folder. Raises GeomidError if they cannot be written."""
        for name, content in self.files.items():
            write_bytes(folder / Path(name).name, content)


_CHANCE = 1e-4  # a fleet has many robots: of any of one robot's numbers, if none has changed


def changes(before: EstimateFile, after: EstimateFile) -> list[str]:
    """The links that have changed, and the numbers of links and effects that differ by more than their standard
    deviations explain, in words, the surest first.

    What both estimates took from the same prior counts as uncertain twice: little data tell no change.

    Args:
        before, after: of one robot.

    Raises:
        InputError: a file says what cannot be.
    """
    found = compared(before.values, after.values, _CHANCE)
    return [*(link.sentence for link in found.changed), *(number.sentence for number in found.differing)]
