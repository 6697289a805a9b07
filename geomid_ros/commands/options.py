"""Options of commands: parameter types, and options built from dataclass declarations."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, Field, fields
from functools import reduce
from pathlib import Path
from typing import Any, TypeAlias

import click

from geomid_ros.errors import InputError
from geomid_ros.options import explained, named_once, names_in, numbers_in

Decorator: TypeAlias = Callable[[Callable[..., Any]], Callable[..., Any]]
_NONE = "'none' for none"


class Output(click.Path):
    """Output path; refuses an unwritable path before any work is done.

    A folder, or with ``within`` a file or folder to be created in its parent.
    """

    def __init__(self, *, within: bool = False, **options: Any) -> None:
        super().__init__(path_type=Path, **options)
        self._within = within

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from geomid_ros.files.disk import check_writable

        path = Path(super().convert(value, param, ctx))  # type: ignore[arg-type]  # it is one
        check_writable(path.parent if self._within else path)
        return path


class Names(click.ParamType):  # type: ignore[type-arg]  # older releases of click take none
    """Names separated by commas; with ``or_none`` the word 'none' stands for an empty list.

    An empty name is refused: it comes from an unset shell variable, and the intention is unknown.
    """

    name = "names"

    def __init__(self, *, or_none: bool = False) -> None:
        self.or_none = or_none

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> list[str]:
        names = names_in(value, or_none=self.or_none)
        if not all(names):
            none = f", or {_NONE}" if self.or_none else ""
            self.fail(
                f"there is an empty name in '{value}'. Write NAME,NAME,...{none}; or omit the option.", param, ctx
            )
        return names


def numbers(_context: click.Context, option: click.Parameter, text: str | None) -> list[float]:
    """Parse numbers separated by commas; an empty list for no text. Raises InputError."""
    if text is not None and not (numbers := numbers_in(text)):
        raise InputError(f"{option.opts[0]} is '{text}', expected numbers separated by commas")
    return numbers if text is not None else []


def share(_context: click.Context, _option: click.Parameter, text: str | None) -> float:
    """Parse a fraction such as ``5%`` or ``0.05``; 0 for no text."""
    given = text or "0"
    match numbers_in(given.removesuffix("%")):
        case [number] if 0.0 <= (share := number / (100.0 if given.endswith("%") else 1.0)) < 1.0:
            return share
    raise click.BadParameter(f"'{text}' is not a share; expected e.g. 5%")


def _packages(_context: click.Context, _option: click.Parameter, texts: tuple[str, ...]) -> dict[str, Path]:
    """Parse NAME=FOLDER into folders by package name."""
    pairs = []
    for text in texts:
        name, _, folder = text.partition("=")
        if not name or not folder:
            raise click.BadParameter(f"'{text}' is not of the form NAME=FOLDER")
        pairs.append((name, Path(folder)))
    return named_once("--package-path", pairs, "remove one")


OUT: dict[str, Any] = {"type": Output(file_okay=False), "show_default": True, "help": "Output folder."}
UNTRIED_OUT = OUT | {"type": click.Path(path_type=Path, file_okay=False)}
"""Output folder of commands that do not always write: they check it themselves."""
PATH = click.Path(path_type=Path)


# Command-line form of a type, unless the declaration overrides it.
_KINDS: dict[str, dict[str, Any]] = {
    "PathLike | None": {"type": PATH},
    "Config | None": {"type": PATH},
    "Paths": {"type": PATH, "multiple": True},
    "Texts": {"multiple": True},
    "Texts | None": {"type": Names()},
    "Gains": {"multiple": True},
    "Packages": {"multiple": True, "metavar": "NAME=FOLDER", "callback": _packages},
    "Sequence[float]": {"callback": numbers},
    "Sequence[float] | None": {"type": float, "nargs": 3},
    "float | None": {"type": float},
    "int | None": {"type": int},
    "bool": {"is_flag": True},
}


def options_of(kind: type, *, without: Collection[str] = ()) -> Decorator:
    """Return a decorator that adds the fields of a class with defaults as options, except those in ``without``."""
    texts = explained(kind)
    offered = texts.keys() - {"progress", *without}
    declared = [each for each in fields(kind) if each.default is not MISSING and each.name in offered]
    options = [_option(each, texts[each.name]) for each in reversed(declared)]  # decorators apply in reverse order
    return lambda command: reduce(lambda inner, option: option(inner), options, command)


def _option(field: Field[Any], text: str) -> Decorator:
    """Return the option declared by a field."""
    settings = _KINDS.get(str(field.type), {}) | _declared(field.metadata)
    flag = settings.pop("flag", f"--{field.name.replace('_', '-')}")
    names = [settings.pop("earlier")] if "earlier" in settings else []
    if field.default is True:
        flag = f"{flag}/--no-{field.name}"
    if field.default not in (None, ()):
        settings |= {"default": field.default, "show_default": True}
    return click.option(flag, *names, field.name, **settings, help=_help(text, settings))


def _declared(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """Return the form of an option from its declaration."""
    settings = {name: metadata[name] for name in ("flag", "earlier", "metavar") if name in metadata}
    if "choices" in metadata:
        settings["type"] = click.Choice(metadata["choices"])
    if "min" in metadata:
        limits = {name: metadata[name] for name in ("min", "max", "min_open", "max_open") if name in metadata}
        settings["type"] = (click.IntRange if isinstance(metadata["min"], int) else click.FloatRange)(**limits)
    if "or_none" in metadata:
        settings["type"] = Names(or_none=True)
    return settings


def _help(text: str, settings: Mapping[str, Any]) -> str:
    """Return the help of an option: its sentence, whether it may be repeated, and its default."""
    sentence, _, default = text.partition(" [default: ")
    sentence = sentence[0].upper() + sentence[1:].removesuffix(".")
    names = settings.get("type")
    if isinstance(names, Names):
        sentence += f", separated by commas{f'; {_NONE}' if names.or_none else ''}"
    repeated = "; may be repeated" if settings.get("multiple") else ""
    return f"{sentence}{repeated}.{f'  [default: {default}' if default else ''}"


report_option = click.option(
    "--report/--no-report",
    default=True,
    show_default=True,
    help="Write the page and the pictures, which are for people.",
)
