"""What a set of hypotheses must say of each of them to be selected from."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, Protocol, Self, TypeVar

from geomid_ros.types import FloatArray

Term = TypeVar("Term", bound=Hashable)
"""Names a column of the products."""
_Term_co = TypeVar("_Term_co", bound=Hashable, covariant=True)


class Hypothesis(Protocol[_Term_co]):
    """Columns or a body that may explain a part of what is measured."""

    @property
    def terms(self) -> tuple[_Term_co, ...]:
        """Its columns; none of a body."""

    @property
    def payload(self) -> int | None:
        """The link, by its place among the identified ones, that carries it, of a body; None of columns."""

    @property
    def usual(self) -> tuple[float, ...]:
        """Prior standard deviations of its coefficients about what is known of them; 0 for a share of what is
        measured."""

    @property
    def odds(self) -> float:
        """Its prior odds, with whatever constant."""

    @property
    def cost(self) -> float:
        """Minus twice the logarithm of its prior odds, with its constant."""

    @property
    def positives(self) -> int:
        """How many of its coefficients, the first ones, cannot be negative."""

    @property
    def group(self) -> Hashable:
        """One of each group is selected at most."""

    @property
    def rescales(self) -> bool:
        """Whether it is a factor on what a channel measures, of which all together pass for a body."""

    @property
    def confusable_with_payload(self) -> bool:
        """Whether a body may stand in its place."""

    @property
    def relinearises(self) -> bool:
        """Whether all other columns depend on its size, so that a search with it is to be begun anew."""

    def excludes(self, other: Self) -> bool:
        """Whether both at once make no sense; all of a group are alike in this."""

    def includes(self, other: Self) -> bool:
        """Whether it is the same with another constant, or the other is a special case of it."""

    def is_out_of_range(self, coefficients: FloatArray) -> bool:
        """Whether nothing that works has it with these ``coefficients (k,)``."""


Chosen = TypeVar("Chosen", bound=Hypothesis[Any])
"""The hypotheses that a caller selects from."""
