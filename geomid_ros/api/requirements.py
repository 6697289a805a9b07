"""What a user requires of a model on a recording: ``rms<2*floor``, ``joint2.rms<1.5``, ``total.mass<24``.

A requirement is ``[PLACE.]QUANTITY COMPARISON BOUND``, and without a place it is one of every place:

- ``rms``, of a channel: RMS of what the model leaves of the recording [N m, N];
- ``mass``, of a link, or of all links together, ``total``: [kg];
- ``from_data``, of a link: share of the prior's variance that the data removed, 0 to 1.

A comparison is ``<``, ``<=``, ``>`` or ``>=``. A bound is a number, ``floor``, ``urdf``, or a number times one of them:
``2*floor``. The floor of an rms is that of the fitted data when the model was identified; ``urdf`` is the same quantity
of the URDF, with sensors corrected as the model says.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from geomid_ros.errors import InputError, unknown_name

TOTAL = "total"
QUANTITIES = {"rms": ("floor", "urdf"), "mass": ("urdf",), "from_data": ()}
"""The references that a bound of each quantity may be a multiple of."""

_COMPARISONS: dict[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_NUMBER = r"\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+(?:[eE][-+]?\d+)?"
_FORM = re.compile(
    rf"\s*(?:(?P<place>.+)\.)?(?P<quantity>[a-z_]+)\s*(?P<comparison><=|>=|<|>)\s*"
    rf"(?:(?P<number>{_NUMBER})(?:\s*\*\s*(?P<times>[a-z]+))?|(?P<reference>[a-z]+))\s*"
)
_LONGEST = 500  # characters
_HOW = "expected [PLACE.]QUANTITY<BOUND, e.g. 'rms<2*floor', 'joint2.rms<1.5', 'total.mass<1.1*urdf', 'from_data>=0.1'"

Values = Mapping[str, Mapping[str, float]]
"""Numbers by place, and there by ``value`` and the references."""


@dataclass(frozen=True)
class Requirement:
    """That a ``quantity`` at a ``place`` (empty: at all) compares so with ``factor`` times the ``reference``, which is
    empty for a plain number. ``text`` is what the user wrote."""

    text: str
    place: str
    quantity: str
    comparison: str
    factor: float
    reference: str

    @staticmethod
    def parse(text: str) -> Requirement:
        """Parse a requirement.

        Raises:
            InputError: it has another form; the message says what is possible.
        """
        match = _FORM.fullmatch(text) if len(text) <= _LONGEST else None
        if match is None:
            raise InputError(f"requirement '{text}': {_HOW}")
        quantity, reference = match["quantity"], match["times"] or match["reference"] or ""
        if quantity not in QUANTITIES:
            raise InputError(f"requirement '{text}': {unknown_name('quantity', quantity, QUANTITIES)}")
        if reference and reference not in QUANTITIES[quantity]:
            multiples = f" or a multiple of {' or '.join(QUANTITIES[quantity])}" if QUANTITIES[quantity] else ""
            raise InputError(
                f"requirement '{text}': {quantity} is compared with a number{multiples}, not with '{reference}'"
            )
        factor = float(match["number"] or 1.0)
        return Requirement(text, match["place"] or "", quantity, match["comparison"], factor, reference)

    def checked(self, values: Mapping[str, Values]) -> Iterator[Outcome]:
        """Compare.

        Args:
            values: by quantity, the numbers at every place.

        Raises:
            InputError: there is no such place.
        """
        places = values[self.quantity]
        if self.place and self.place not in places:
            raise InputError(f"requirement '{self.text}': {unknown_name('place', self.place, places)}")
        for place in [self.place] if self.place else _known(places):
            value = places[place]["value"]
            bound = self.factor * (places[place][self.reference] if self.reference else 1.0)
            if math.isnan(bound):
                raise InputError(f"requirement '{self.text}': the model does not say the {self.reference} of '{place}'")
            passed = _COMPARISONS[self.comparison](value, bound)  # never what is not measured, NaN
            yield Outcome(self.text, f"{place}.{self.quantity}", value, f"{self.comparison} {bound:.4g}", passed)


def _known(places: Values) -> list[str]:
    """The places that a requirement without one is of: those with a number, one by one."""
    return [place for place, numbers in places.items() if place != TOTAL and not math.isnan(numbers["value"])]


@dataclass(frozen=True)
class Outcome:
    """Whether what is required is so: the ``requirement``, ``what`` was compared, its ``value``, and with which
    ``bound``."""

    requirement: str
    what: str
    value: float
    bound: str
    passed: bool
