"""Effects whose parameters have values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from geomid_ros.model.effects.parameters import Quantity


class ModelEffect(Protocol):
    """An effect with the values of its parameters: a finding, or what is read of it from a file."""

    @property
    def effect(self) -> str:
        """Its name."""

    @property
    def joint(self) -> str:
        """The joint, two as ``FIRST+SECOND``, or the topic of a wrench sensor; empty for the whole robot."""

    @property
    def link(self) -> str:
        """The link that carries a payload, else empty."""

    @property
    def parameters(self) -> Mapping[str, Quantity]:
        """The parameters by name."""


@dataclass(frozen=True)
class KnownEffect:
    """An effect as a file says it; see :class:`ModelEffect`."""

    effect: str
    joint: str
    link: str
    parameters: Mapping[str, Quantity]
