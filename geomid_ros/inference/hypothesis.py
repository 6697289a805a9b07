"""Protocol of the hypotheses that a search selects from."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, Protocol, Self, TypeVar

from geomid_ros.types import FloatArray

Term = TypeVar("Term", bound=Hashable)
"""Identifies a column of the products."""
_Term_co = TypeVar("_Term_co", bound=Hashable, covariant=True)


class Hypothesis(Protocol[_Term_co]):
    """Columns, or a body (payload), that may explain a part of the measurement."""

    @property
    def terms(self) -> tuple[_Term_co, ...]:
        """Identifiers of its columns; empty for a body."""

    @property
    def payload(self) -> int | None:
        """Link that carries the body, as an index into the identified links; None for columns."""

    @property
    def prior_std(self) -> tuple[float, ...]:
        """Prior stds of its coefficients about their known values; 0: a default fraction of the measurement."""

    @property
    def odds(self) -> float:
        """Prior odds for any value of its constant."""

    @property
    def cost(self) -> float:
        """Minus twice the logarithm of the prior odds for its value of the constant."""

    @property
    def positives(self) -> int:
        """Number of leading coefficients that cannot be negative."""

    @property
    def group(self) -> Hashable:
        """Key of its group; at most one hypothesis of each group is selected."""

    @property
    def rescales(self) -> bool:
        """True if it is a factor on what a channel measures; factors at all channels together mimic a body."""

    @property
    def confusable_with_payload(self) -> bool:
        """True if a body may take its place."""

    @property
    def relinearises(self) -> bool:
        """True if all other columns depend on its size, so that a search that finds it must start again."""

    def excludes(self, other: Self) -> bool:
        """True if both at once make no sense. All members of a group answer alike."""

    def includes(self, other: Self) -> bool:
        """True if it is the same with another constant, or if the other is a special case of it."""

    def is_out_of_range(self, coefficients: FloatArray) -> bool:
        """True if no working robot has it with these ``coefficients (k,)``."""


Chosen = TypeVar("Chosen", bound=Hypothesis[Any])
"""Type of the hypotheses that a caller selects from."""
