"""Sidecars, ``effects.yaml``."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random

import yaml

from benchmarks.fuzz.mutations import changed_text
from benchmarks.fuzz.target import require
from benchmarks.fuzz.targets.model import changed_document, effect_entries
from geomid_ros.files.models.effects_file import combined, read_sidecar, write_sidecar

_SNIPPETS = ("*a", "&a", "!!float x", "[", "{", "\t", "? ", "- ", ": ", "\x00", "1e999", ".inf", "~")


class EffectsTarget:
    """Sidecars with something changed; what is read and written again is the same."""

    def __init__(self, folder: Path) -> None:
        self._path, self._again = folder / "effects.yaml", folder / "again.yaml"
        entries = [{key: value for key, value in entry.items() if value} for entry in effect_entries()]
        self._document = {"format": 1, "robot": "arm", "effects": entries}
        self._use(yaml.safe_dump(self._document))

    def attempt(self, random: Random) -> None:
        """Change a sidecar, and read it."""
        document = json.loads(json.dumps(self._document))
        document["effects"] = random.sample(document["effects"], 3)
        if random.random() < 0.7:
            changed_document(document, random)
        text = yaml.safe_dump(document, default_flow_style=random.choice((None, True, False)), allow_unicode=True)
        if random.random() < 0.5:
            text = changed_text(text, random, _SNIPPETS)
        self._use(text)

    def _use(self, text: str) -> None:
        self._path.write_bytes(text.encode(errors="surrogatepass"))
        effects = read_sidecar(self._path)
        write_sidecar(self._again, "arm3", effects)
        before, after = ([effect.values for effect in each] for each in (effects, read_sidecar(self._again)))
        require(before == after, f"{before} has become {after}")
        combined(effects)
