"""Models of an earlier run, ``estimate.json``."""

from __future__ import annotations

import base64
import copy
import json
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any, TypeAlias

import numpy as np

from benchmarks.fuzz.mutations import changed_text
from benchmarks.fuzz.target import require
from geomid_ros.commands.live import shared_file
from geomid_ros.model.effects import EFFECTS
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

# A place in a document: the list or object, and the index or key in it.
_Place: TypeAlias = tuple[Any, Any]
EDGES: tuple[Any, ...] = (
    None,
    True,
    0,
    -1,
    1,
    0.0,
    -0.0,
    1e308,
    -1e308,
    1e-308,
    10**400,
    float("nan"),
    float("inf"),
    "",
    "x",
    "link1",
    "joint1",
    [],
    {},
    [[]],
    [1, 2, 3],
    {"value": 1, "std": None, "unit": "N m"},
    "nan",
    "1",
    "\x1b[2J",
    "x" * 10_000,
    [0.1] * 9,
)
_SNIPPETS = (
    "NaN",
    "-Infinity",
    "[" * 3000,
    "{" * 30,
    "null",
    '"',
    "1e999",
    "9" * 5000,
    "\x00",
    "\\ud800",
    ",",
    "}",
    "]",
)


def places(value: Any) -> Iterator[_Place]:
    """Every place in a document."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in list(pairs):
        yield value, key
        yield from places(inner)


def changed_document(document: Any, random: Random) -> None:
    """Change one to four places of a document."""
    for _ in range(random.choice((1, 1, 2, 4))):
        found = list(places(document))
        if not found:
            return
        container, key = random.choice(found)
        other, other_key = random.choice(found)
        if random.random() < 0.2:
            del container[key]
        elif random.random() < 0.3:
            container[key] = json.loads(json.dumps(other[other_key]))
        else:
            container[key] = copy.deepcopy(random.choice((*EDGES, *EFFECTS)))


def effect_entries() -> list[dict[str, Any]]:
    """An entry for each effect, as files have it."""
    return [
        {
            "effect": name,
            "joint": "" if effect.place in ("robot", "link") else "joint1",
            "link": "tool" if effect.place == "link" else "",
            "parameters": {
                form.name: {"value": 0.01, "std": 0.001, "unit": form.units[0]} for form in effect.parameters
            },
        }
        for name, effect in EFFECTS.items()
    ]


class ModelTarget:
    """Documents with something changed are where an identification begins."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "estimate.json"
        self._urdf = shared_file("bags/arm3.urdf").read_text(encoding="utf-8")
        session = Session(self._urdf, Configuration(), "arm3.urdf")
        inertia = [[0.02, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.02]]
        links = [
            {"name": body.name, "merged": list(body.merged), "mass": 1.5, "com": [0.0, 0.01, 0.1], "inertia": inertia}
            for body in session.robot.bodies
        ]
        size = 10 * len(links)
        information = {
            "links": [link["name"] for link in links],
            "rows": _packed(np.ones(size * (size + 1) // 2)),
            "residuals": _packed(np.ones(size)),
        }
        effects = [
            {"name": c.effect.name, "joint": c.place_name, "value": 0.1, "std": 0.01, "unit": c.unit}
            for c in session.model.coefficients
            if len(c.effect.parameters) == 1
        ]
        added = [entry for entry in effect_entries() if entry["link"] != "tool"]
        whole = {"format": 1, "links": links, "effects": effects, "added": added, "information": information}
        self._whole = json.dumps(whole)
        self._configuration = Configuration({"model": str(self._path), "gap.memory": 0.0})
        self._use(self._whole)

    def attempt(self, random: Random) -> None:
        """Change a document, and start from it."""
        if random.random() < 0.3:
            self._use(changed_text(self._whole, random, _SNIPPETS))
            return
        document = json.loads(self._whole)
        changed_document(document, random)
        self._use(json.dumps(document))

    def _use(self, text: str) -> None:
        self._path.write_bytes(text.encode(errors="surrogatepass"))
        session = Session(self._urdf, self._configuration, "arm3.urdf")
        prior = session.prior
        require(prior is not None and not np.any(np.isinf(prior)), "parameters that are no numbers")
        known = session.loaded.information(session.model)
        require(known is None or np.all(np.isfinite(known.rows)), "information that is no numbers")


def _packed(numbers: FloatArray) -> str:
    """As the file has them: four bytes each, in base64."""
    return base64.b64encode(numbers.astype("<f4").tobytes()).decode()
