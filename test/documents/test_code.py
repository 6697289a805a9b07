"""Code in the documents: commands exist with their options, Python compiles, and what says that it runs does."""

from __future__ import annotations

import doctest
import importlib.util
import json
import re
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import chdir
from functools import cache
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
import yaml
from commands.running import done, undrawn

import geomid_ros
from geomid_ros.commands import root
from geomid_ros.estimation import paper_estimator
from geomid_ros.session.configuration import PARAMETERS, Configuration
from geomid_ros.simulation.effect_sizes import SIZES
from geomid_ros.simulation.options import NOTHING, parse_hidden

from .reading import DOCUMENTS, NOTEBOOK, ROOT, Block, blocks, cells, outputs, spans, text_of

REFERENCE = text_of("docs/pages/reference.md")
NODE = set(re.findall(r"`(~/[\w/]+)`", REFERENCE))
LAUNCHED = set(re.findall(r'DeclareLaunchArgument\(\s*"(\w+)"', text_of("launch/geomid.launch.py")))
EXECUTABLES = set(re.findall(r'f?"(\w+) = ', text_of("setup.py")))
PATTERNS = [re.compile(re.escape(parameter.name).replace(r"\*", r"[\w/-]+") + "$") for parameter in PARAMETERS]
# Parameters are told by these beginnings from files and modules, which have dots, too.
FAMILIES = ("filter.", "gap.", "payload.", "checkpoint.", "wrench.", "joint.")
# What blocks that run print, in parts.
PRINTED = {
    "README.md": ("Identification of arm3", "link3: "),
    "docs/pages/use/compare.md": ("first/estimate.json and second/estimate.json: nothing beyond chance", "joint1"),
    "docs/pages/use/library.md": ("link3: ", "usable", "link33"),
}
FILES = (".json", ".yaml", ".yml", ".xml", ".html", ".urdf", ".py", ".md")


def lines(document: str) -> Iterator[str]:
    """Lines that a user may type, and commands within sentences."""
    for block in blocks(document):
        if block.language in ("", "bash", "console"):
            yield from block.text.replace("\\\n", " ").splitlines()
    for span in spans(document):
        if " " in span:
            yield f"{span} VALUE" if re.search(r" --[\w-]+$", span) else span


LINES = [line for document in DOCUMENTS for line in lines(document)]


def commands(document: str) -> Iterator[list[str]]:
    """Arguments of every ``geomid``, also by ``ros2 run``."""
    for line in lines(document):
        typed = line.strip().removeprefix("ros2 run geomid_ros ")
        if re.match(r"geomid [a-z]+( |$)", typed):
            yield shlex.split(typed, comments=True)[1:]


def test_commands_exist_with_their_options() -> None:
    """The parser of the command line takes them; values are checked where they are one of a few."""
    context = click.Context(root)
    found = [(document, typed) for document in DOCUMENTS for typed in commands(document)]
    assert len(found) > 40
    assert {name for _, (name, *_) in found} == set(root.list_commands(context)) - {"demo"}
    for document, (name, *arguments) in found:
        command = root.get_command(context, name)
        assert command is not None, f"{document}: geomid {name}"
        of_it = click.Context(command, help_option_names=root.context_settings["help_option_names"])  # it keeps them
        values, _, _ = command.make_parser(of_it).parse_args(list(arguments))
        for parameter in command.params:
            for value in np.atleast_1d(values.get(parameter.name) or []):
                if isinstance(parameter.type, click.Choice):
                    assert value in parameter.type.choices, f"{document}: {value}"
                if parameter.name == "hide":
                    assert parse_hidden(value).effect in {*SIZES, NOTHING}, f"{document}: {value}"


def test_what_ros_and_python_are_told_exists() -> None:
    for line in LINES:
        for module in re.findall(r"python[\d.]* -m\s+(benchmarks[\w.]*|geomid_ros[\w.]*)", line):
            assert importlib.util.find_spec(module), line
        for file in re.findall(r"python[\d.]* ((?:bags|examples|docs|test)/\S+\.py)", line):
            assert (ROOT / file).exists(), line
        if "ros2 launch geomid_ros" in line:
            words = line.split("geomid_ros", 1)[1].split()
            assert (ROOT / "launch" / words[0]).exists(), line
            assert {word.partition(":=")[0] for word in words if ":=" in word} <= LAUNCHED, line
            named = [word.removeprefix("config:=") for word in words if word.startswith("config:=")]
            assert all((ROOT / "config" / name).exists() for name in named), line
        if "ros2 run geomid_ros" in line:
            assert line.split("ros2 run geomid_ros ")[1].split()[0] in EXECUTABLES, line
        if match := re.search(r"/geomid(/[\w/]+)", line):
            assert f"~{match[1]}" in NODE, line


def test_topics_services_and_parameters_exist() -> None:
    for document, span in ((d, span) for d in DOCUMENTS for span in spans(d)):
        name = span.partition(":")[0]
        if re.fullmatch(r"~/[\w/]+", span) and span != "~/wrench":  # a broadcaster's
            assert span in NODE, f"{document}: {span}"
        if name.startswith(FAMILIES) and not name.endswith(FILES) and re.fullmatch(r"[\w.*]+", name):
            family = name.replace("NAME", "name").replace("*", "name")
            assert any(pattern.match(family) for pattern in PATTERNS), f"{document}: {span}"


def of_language(language: str) -> list[tuple[str, Block]]:
    found = [(document, block) for document in DOCUMENTS for block in blocks(document)]
    return [(document, block) for document, block in found if block.language == language]


def test_parameter_files_are_read() -> None:
    assert of_language("yaml")
    for document, block in of_language("yaml"):
        (content,) = yaml.safe_load(block.text).values()
        assert Configuration(content["ros__parameters"], document)


def test_python_compiles_uses_names_that_exist_and_runs() -> None:
    """Here, or by tests that need more for it: test_new_effect.py, api/test_front_door.py, files/test_posterior.py."""
    elsewhere = [document for document, block in of_language("python") if not block.runs]
    assert elsewhere == ["CONTRIBUTING.md", "docs/pages/use/library.md", "docs/pages/use/read.md"]
    assert {document for document, block in of_language("python") if block.runs} == PRINTED.keys()
    for document, block in of_language("python"):
        compile(block.text, document, "exec")
        for name in re.findall(r"\bgeomid_ros\.(\w+)", block.text):
            assert hasattr(geomid_ros, name) or importlib.util.find_spec(f"geomid_ros.{name}"), name


def user_s_folder(path: Path) -> Path:
    """With the bags that come with the package, one of which is the user's."""
    for name, file in (("bags", "bags"), ("my_bag", "bags/arm3"), ("robot.urdf", "bags/arm3.urdf")):
        (path / name).symlink_to(ROOT / file)
    return path


@pytest.mark.parametrize("document", PRINTED)
def test_what_says_that_it_runs_does(document: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Block after block."""
    names: dict[str, Any] = {}
    with chdir(user_s_folder(tmp_path)):
        for block in (block for block in blocks(document) if block.language == "python" and block.runs):
            exec(compile(block.text, document, "exec"), names)
    printed = capsys.readouterr().out
    assert all(words in printed for words in PRINTED[document])


@pytest.fixture(scope="module")
def printed_by(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], str]:
    """What a command prints, which runs once."""
    folder = user_s_folder(tmp_path_factory.mktemp("user"))

    @cache
    def run(command: str) -> str:
        with chdir(folder), pytest.MonkeyPatch.context() as patch:
            undrawn(patch)
            return done(*shlex.split(command)[1:])

    return run


def test_every_output_is_printed_again() -> None:
    """But for what a node, a simulation or a search of many seconds prints, and for files of other programs."""
    elsewhere = {Path(document).stem for document, block in of_language("text") if not block.runs}
    other = {"adaptation", "excite", "feedforward", "gap", "identify", "node", "payload", "sample", "simulate"}
    assert elsewhere == other


@pytest.mark.parametrize("document", [document for document in DOCUMENTS if outputs(document)])
def test_output_is_what_the_command_above_it_prints(document: str, printed_by: Callable[[str], str]) -> None:
    """Line after line, however they are wrapped; others of the command's lines may be left out between them."""
    for command, text in outputs(document):
        printed, place = words_of(printed_by(command)), 0
        known = [masked(word) for word in printed]
        for words in filter(None, map(words_of, text.splitlines())):
            looked_for, count = [masked(word) for word in words], len(words)
            places = (k for k in range(place, len(known)) if known[k : k + count] == looked_for)
            place = next(places, -1)
            assert place >= 0, f"{document}: '{command}' does not print: {' '.join(words)}"
            same(" ".join(words), " ".join(printed[place : place + count]))
            place += count


def words_of(text: str) -> list[str]:
    return [word for word in text.split() if word.strip("─")]


NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?")


def masked(text: str) -> str:
    return NUMBER.sub("0", text)


def said_by(cells_of_code: list[dict[str, Any]]) -> str:
    """What cells print and show, but for pictures."""
    outputs = [output for cell in cells_of_code for output in cell["outputs"]]
    return "".join("".join(output.get("text", output.get("data", {}).get("text/plain", []))) for output in outputs)


def same(written: str, printed: str) -> None:
    """Texts in which nothing differs but the last digit of a number, which is not the same on all machines."""
    assert masked(written) == masked(printed)
    for old, new in zip(NUMBER.findall(written), NUMBER.findall(printed), strict=True):
        last = 10.0 ** -len(new.partition(".")[2])
        assert abs(float(old) - float(new)) <= 1.01 * last, (written, old, new)


def test_the_notebook_runs_and_finds_the_truth() -> None:
    """Cell by cell in one namespace, as the program that stores its outputs does."""
    sys.path.insert(0, str(ROOT / "docs/generators"))
    try:
        from notebook import run  # noqa: PLC0415
    finally:
        sys.path.pop(0)
    fresh = [cell for cell in run(NOTEBOOK)["cells"] if cell["cell_type"] == "code"]
    stored = [cell for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    text = said_by(fresh)
    same(said_by(stored), text)
    rows = re.findall(r"\| (\w+) \| [\d.]+ \| ([\d.]+ ± [\d.]+) \| [\d.]+ \| (\d+ %) \|", text_of("README.md"))
    assert len(rows) == 4
    for link, mass, share in rows:
        same(f"{link}: {mass} kg, {share}", re.search(rf"{link}: .* %", text)[0])  # type: ignore[index]
    errors = [abs(float(error)) for error in re.findall(r"truth [\d.]+, ([+-][\d.]+) std", text)]
    assert len(errors) == 8
    assert max(errors) < 4.0
    improved = [(float(before), float(after)) for before, after in re.findall(r": +([\d.]+) -> ([\d.]+)", text)]
    assert len(improved) == 13
    assert all(after < before for before, after in improved)
    assert sum("image/png" in output.get("data", {}) for cell in fresh for output in cell["outputs"]) == 1
    assert len(cells()) == len(fresh) == 6


def test_the_example_in_a_docstring_runs() -> None:
    failed, attempted = doctest.testmod(paper_estimator)
    assert attempted
    assert not failed
