"""What a user may say, as the rooms below want it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from geomid_ros.files.bags.bag import bags_in
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.sensors import WrenchSensor
from geomid_ros.session.configuration import Configuration

PathLike: TypeAlias = str | Path
"""The path of a file or a folder."""
Paths: TypeAlias = PathLike | Sequence[PathLike]
"""One path or several."""
Texts: TypeAlias = str | Sequence[str]
"""One text or several."""
Config: TypeAlias = PathLike | Mapping[str, Any] | Configuration
"""A parameter file (YAML), or parameters by their full names, as in ``{"filter.cutoff": 8.0}``."""


def paths(given: Paths) -> list[Path]:
    """One path or several, as a list."""
    return [Path(path) for path in ([given] if isinstance(given, str | Path) else given)]


def bag_paths(given: Paths) -> list[Path]:
    """Bags, as a list; for a folder of bags, those in it."""
    return [bag for path in paths(given) for bag in bags_in(path)]


def texts(given: Texts) -> list[str]:
    """One text or several, as a list."""
    return [given] if isinstance(given, str) else list(given)


def description(urdf: PathLike) -> tuple[str, str]:
    """The text of a URDF, and where it is from.

    Args:
        urdf: path of the file, or the text itself.

    Raises:
        InputError: the file cannot be read.
    """
    if isinstance(urdf, str) and urdf.lstrip().startswith("<"):
        return urdf, "robot description"
    return read_urdf(Path(urdf)), str(urdf)


def configuration(
    config: Config | None, *, model: PathLike | None, floating_base: bool, wrench: Texts, **values: Any
) -> Configuration:
    """The configuration of ``config`` with what other arguments say, which win.

    Args:
        config: see :data:`Config`; None for the defaults.
        model: an estimate.json to start from.
        floating_base: whether the base moves.
        wrench: sensors, as ``TOPIC:FRAME:ROLE[:AXES]``; none leaves those of ``config``.
        values: further parameters by name.

    Raises:
        InputError: a parameter is unknown or has a wrong value.
    """
    if model is not None:
        values["model"] = str(model)
    if floating_base:
        values["floating_base"] = True
    result = _base(config)
    if wrench:
        result = result.with_sensors([WrenchSensor.parse(text) for text in texts(wrench)])
    return result.with_values(Configuration(values, "options").given)


def _base(config: Config | None) -> Configuration:
    if isinstance(config, Configuration):
        return config
    if config is None or isinstance(config, Mapping):
        return Configuration(config, "options" if config is None else "config")
    return Configuration.read(Path(config))
