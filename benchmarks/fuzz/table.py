"""The targets by name: one line registers one."""

from __future__ import annotations

import importlib
from pathlib import Path

from benchmarks.fuzz.target import Target

TARGETS = {
    "urdf": "benchmarks.fuzz.targets.urdf:UrdfTarget",
    "parameters": "benchmarks.fuzz.targets.parameters:ParametersTarget",
    "mcap": "benchmarks.fuzz.targets.mcap:McapTarget",
    "db3": "benchmarks.fuzz.targets.db3:DatabaseTarget",
    "messages": "benchmarks.fuzz.targets.messages:MessagesTarget",
    "model": "benchmarks.fuzz.targets.model:ModelTarget",
    "effects": "benchmarks.fuzz.targets.effects:EffectsTarget",
    "checkpoint": "benchmarks.fuzz.targets.checkpoint:CheckpointTarget",
}


def made(name: str, folder: Path) -> Target:
    """The target of a name, or of a ``module:Class``, with its folder. It is imported only now."""
    module, _, kind = TARGETS.get(name, name).partition(":")
    target: Target = getattr(importlib.import_module(module), kind)(folder)
    return target
