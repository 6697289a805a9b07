"""ROS parameter files, as ``--config`` takes them."""

from __future__ import annotations

from pathlib import Path
from random import Random

import yaml

from benchmarks.fuzz.mutations import NUMBERS, changed_text
from benchmarks.fuzz.target import require
from geomid_ros.commands.live import shared_file
from geomid_ros.session.configuration import PARAMETERS, Configuration

_SNIPPETS = (
    "&a [1, 2]",
    "*a",
    "!!python/object/apply:os.system ['true']",
    "!!binary aGk=",
    "!!timestamp x",
    "!!int ''",
    "!!set {a}",
    "<<: {a: 1}",
    "? [a, b]\n: c\n",
    "---\n",
    "...\n",
    "%YAML 1.1\n",
    "%TAG ! tag:x,2000:\n",
    "|\n",
    ">-\n",
    "[" * 40,
    "[" * 2000,
    "{" * 40,
    "- " * 50,
    "\t",
    "\x00",
    "\ufeff",
    "1:30:00",
    "2001-02-30",
    "0x_",
    "0o7",
    "1:" * 3000 + "1",
    ".nan",
    "~",
    "yes",
    "'",
    '"\\x',
    '"\\U00110000"',
    "#",
    ": ",
    ",",
    "a: &a [*a]\n",
    "ä",
    "\x85",
    "\u2028",
)
_VALUES = (
    *NUMBERS,
    "[]",
    "['']",
    "{}",
    "null",
    "true",
    "[1.0, 2.0]",
    "[0, 0, -9.81]",
    "[nan, 0, 0]",
    "wrist",
    "['wrist']",
    "['tool=0.5:0.01']",
    "['=:']",
    "['total=nan:1']",
    "[viscous_friction]",
    "[fx, fx]",
    "external",
    "-1",
    "1e6",
    "[[1], [2]]",
)
_JOINTS = ("joint1", "joint2", "joint3")


class ParametersTarget:
    """Files with something changed; what is accepted makes settings for a robot with a few joints."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "parameters.yaml"
        shipped = [path.read_text(encoding="utf-8") for path in sorted(shared_file("config").glob("*.yaml"))]
        self._whole = [text for text in shipped if len(text) < 20_000]
        require(self._whole, "no files to begin with")

    def attempt(self, random: Random) -> None:
        """Change a file, or make one, and use it."""
        text = _made(random) if random.random() < 0.5 else random.choice(self._whole)
        if random.random() < 0.8:
            text = changed_text(text, random, _SNIPPETS)
        self._path.write_bytes(text.encode(errors="surrogatepass"))
        configuration = Configuration.read(self._path)
        again = Configuration(configuration.given_values)
        require(repr(again.given_values) == repr(configuration.given_values), "what was checked is not accepted again")
        _ = configuration.sensors, configuration.effects, configuration.buffer
        configuration.signals(_JOINTS)
        configuration.estimator(_JOINTS)


def _made(random: Random) -> str:
    """A file with some of the parameters, with values that may be right."""
    lines = []
    for parameter in random.sample(PARAMETERS, random.randint(0, 8)):
        name = parameter.name.replace("*", random.choice(("wrist", *_JOINTS, "ä", "a.b", "")))
        usual = yaml.safe_dump(parameter.default, default_flow_style=True).removesuffix("...\n").strip()
        lines.append(f"    {name}: {usual if random.random() < 0.3 else random.choice(_VALUES)}\n")
    return "/**:\n  ros__parameters:\n" + "".join(lines)
