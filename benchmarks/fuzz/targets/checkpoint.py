"""Checkpoints of the node."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random

import numpy as np

from benchmarks.fuzz.mutations import changed_bytes
from benchmarks.fuzz.target import require
from benchmarks.fuzz.targets.model import EDGES, changed_document
from geomid_ros.commands.live import shared_file
from geomid_ros.files.archive import decoded, encoded, pack, unpack
from geomid_ros.files.checkpoints import Checkpoint
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.signals.ledger import Account

_CRAFTED = 0.6  # of the inputs have the right checksum around something else
_INSTANTS = 60


class CheckpointTarget:
    """Files with something changed; unless the checksum was made anew, only the whole one may be accepted."""

    def __init__(self, folder: Path) -> None:
        del folder
        self._urdf = shared_file("bags/arm3.urdf").read_text(encoding="utf-8")
        session = Session(self._urdf, Configuration({"gap.memory": 0.0}), "arm3.urdf")
        session.identifier.add(_samples(session))
        session.pipeline.ledger.restore({"joint_states": Account(1234)})
        self._session = session
        checkpoint = session.checkpoint()
        self._whole = encoded(vars(checkpoint), checkpoint.accounts)
        self._text, self._vectors = unpack(self._whole)
        self._use(self._whole)

    def attempt(self, random: Random) -> None:
        """Change a file, and go on from it."""
        if random.random() < _CRAFTED:
            self._use(self._crafted(random))
            return
        content = changed_bytes(self._whole, random)
        self._use(content)
        require(content == self._whole, "a value has changed under its checksum")

    def _crafted(self, random: Random) -> bytes:
        text, vectors = self._text, {name: vector.copy() for name, vector in self._vectors.items()}
        if random.random() < 0.6:
            document = json.loads(text)
            meaning = document.pop("meaning") if random.random() < 0.9 else None  # else most changes would be there
            changed_document(document, random)
            if meaning:
                document["meaning"] = meaning
            text = json.dumps(document)
        if random.random() < 0.6:
            name = random.choice(list(vectors))
            vector = vectors.pop(name)
            if len(vector):
                numbers = [edge for edge in EDGES if isinstance(edge, float)]
                vector[random.randrange(len(vector))] = random.choice(numbers)
            choices = (vector, vector, vector[:-1], np.zeros(0), np.repeat(vector, 2))
            vectors[random.choice((name, name, name, "x"))] = random.choice(choices)
        return pack(text, vectors)

    def _use(self, content: bytes) -> None:
        checkpoint = decoded(Checkpoint, content, self._session.meaning)
        self._session.restore(checkpoint)
        require(self._session.identifier.rows >= 0, "a negative number of rows")


def _samples(session: Session) -> Samples:
    """Instants of a random motion with random efforts."""
    rng = np.random.default_rng(0)
    motion = rng.normal(size=(4, _INSTANTS, len(session.robot.joints)))
    stamps = 10**18 + np.arange(_INSTANTS) * 25_000_000
    nothing, wrenches = np.zeros((_INSTANTS, 0)), np.zeros((_INSTANTS, 0, 6))
    return Samples(stamps, *motion, nothing, nothing, nothing, wrenches)
