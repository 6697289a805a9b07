"""Named numbers of the package: where they are, which lines read them, and how to change one everywhere."""

from __future__ import annotations

import ast
import importlib
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias

import numpy as np

import geomid_ros

ROOT = Path(geomid_ros.__file__).parent
PACKAGES = ("estimation", "signals", "monitoring", "checks", "inference", "gap")
_FACTORS = {"x3": 3.0, "x1/3": 1.0 / 3.0}
VARIANTS = ("0", "inf", *_FACTORS)
_NAME = re.compile(r"_?[A-Z][A-Z0-9_]*")
_HUGE = 10**6  # an integer that stands for infinity

Line: TypeAlias = tuple[str, int]
"""A file and the number of a line in it."""
Assignment: TypeAlias = ast.Assign | ast.AnnAssign


@dataclass(frozen=True)
class Constant:
    """A number, or several, with a ``name`` in a ``module`` or in a class of it, the ``owner``."""

    module: str
    owner: str
    name: str

    @property
    def label(self) -> str:
        """The name with its module within the package."""
        return ".".join(filter(None, (self.module.removeprefix("geomid_ros."), self.owner, self.name)))

    @property
    def value(self) -> Any:
        """The number, or a tuple or an array of numbers."""
        return getattr(self._namespace, self.name)

    @property
    def _namespace(self) -> Any:
        module = importlib.import_module(self.module)
        return getattr(module, self.owner) if self.owner else module

    def variants(self) -> dict[str, Any]:
        """Other values by their names; several numbers are scaled, but never zero or infinite."""
        value = self.value
        if isinstance(value, np.ndarray):
            others: dict[str, Any] = {"x3": 3.0 * value, "x1/3": value / 3.0}
        elif isinstance(value, tuple):
            others = {name: tuple(_scaled(each, factor) for each in value) for name, factor in _FACTORS.items()}
        else:
            none, huge = (0, _HUGE) if isinstance(value, int) else (0.0, np.inf)
            others = {"0": none, "inf": huge}
            others |= {name: _scaled(value, factor) for name, factor in _FACTORS.items()}
        return {name: other for name, other in others.items() if not np.array_equal(other, value)}

    def change(self, value: Any) -> None:
        """Let every module see another value, and the module-level numbers that are computed from it theirs."""
        if self.owner:
            setattr(self._namespace, self.name, value)
            return
        setattr(self._namespace, self.name, value)
        changed = {self.name}
        module = sources()[self.module]
        for name, statement in module.assignments:
            if name not in changed and changed & _names_in(statement):
                code = compile(ast.Module([statement], []), module.path, "exec")
                exec(code, vars(self._namespace))  # noqa: S102 a line of the package, evaluated anew
                changed |= set(module.assigned_with(name))
        for name in changed:
            for importer, alias in _importers(self.module, name):
                setattr(sys.modules[importer], alias, getattr(self._namespace, name))

    @cached_property
    def lines(self) -> frozenset[Line]:
        """The lines in functions that read it, or a number that is computed from it."""
        return frozenset(_reads(self.module, self.name, bool(self.owner)))


def _scaled(value: float, factor: float) -> float:
    return max(1, round(value * factor)) if isinstance(value, int) else value * factor


@dataclass(frozen=True, eq=False)
class Source:
    """A module's syntax."""

    name: str
    path: str
    tree: ast.Module

    @cached_property
    def assignments(self) -> list[tuple[str, Assignment]]:
        """Assignments to upper-case names, in the order of the file."""
        return [
            (name, statement)
            for statement in self.tree.body
            if isinstance(statement, ast.Assign | ast.AnnAssign)
            for name in _targets(statement)
        ]

    def assigned_with(self, name: str) -> list[str]:
        """The names that one statement assigns."""
        return [other for other, statement in self.assignments if name in _targets(statement)]

    @cached_property
    def aliases(self) -> dict[tuple[str, str], str]:
        """What the module calls names that it imports from other modules, by these and the names there."""
        return {
            (node.module, name.name): name.asname or name.name
            for node in self.tree.body
            if isinstance(node, ast.ImportFrom) and node.module
            for name in node.names
        }

    @cached_property
    def loads(self) -> Mapping[str, frozenset[int]]:
        """The lines within functions at which a name or an attribute is read."""
        found: dict[str, set[int]] = {}
        for function in ast.walk(self.tree):
            if isinstance(function, ast.FunctionDef | ast.Lambda):
                body = function.body if isinstance(function.body, list) else [function.body]
                for node in (inner for statement in body for inner in ast.walk(statement)):
                    name = (
                        node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""
                    )
                    if name:
                        found.setdefault(name, set()).add(node.lineno)
        return {name: frozenset(lines) for name, lines in found.items()}


def _targets(statement: Assignment) -> list[str]:
    targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
    names = [node for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)]
    return [node.id for node in names if _NAME.fullmatch(node.id)]


def _names_in(statement: Assignment) -> set[str]:
    return {node.id for node in ast.walk(statement.value or statement) if isinstance(node, ast.Name)}


@cache
def sources() -> dict[str, Source]:
    """All modules of the package, by name."""
    found = {}
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT.parent).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = Source(name, str(path), ast.parse(path.read_text(encoding="utf-8")))
    return found


def _importers(module: str, name: str) -> Iterator[tuple[str, str]]:
    """Loaded modules that have imported a name, and what they call it."""
    for other, source in sources().items():
        alias = source.aliases.get((module, name))
        if alias is not None and other in sys.modules:
            yield other, alias


def _reads(module: str, name: str, in_class: bool) -> Iterator[Line]:
    source = sources()[module]
    yield from ((source.path, line) for line in source.loads.get(name, ()))
    if in_class:
        return
    for derived, statement in source.assignments:
        if derived != name and name in _names_in(statement):
            yield from _reads(module, derived, in_class=False)
    for importer, alias in _importers(module, name):
        yield from ((sources()[importer].path, line) for line in sources()[importer].loads.get(alias, ()))


def constants(package: str) -> list[Constant]:
    """The named numbers of a package, in the order of files and lines."""
    found = []
    for name, source in sources().items():
        if name.startswith(f"geomid_ros.{package}.") or name == f"geomid_ros.{package}":
            module = importlib.import_module(name)
            found += [Constant(name, "", own) for own, _ in source.assignments if _is_number(getattr(module, own))]
            found += _of_classes(name, source, module)
    return [constant for constant in found if constant.variants()]


def _of_classes(name: str, source: Source, module: ModuleType) -> Iterator[Constant]:
    for owner in (node for node in source.tree.body if isinstance(node, ast.ClassDef)):
        for statement in owner.body:
            for own in _targets(statement) if isinstance(statement, ast.Assign | ast.AnnAssign) else ():
                if _is_number(getattr(getattr(module, owner.name), own)):
                    yield Constant(name, owner.name, own)


def _is_number(value: Any) -> bool:
    if isinstance(value, tuple):
        return bool(value) and all(map(_is_number, value))
    if isinstance(value, np.ndarray):
        return bool(np.issubdtype(value.dtype, np.floating))
    return isinstance(value, int | float) and not isinstance(value, bool)
