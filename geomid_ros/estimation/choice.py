"""Which effects beside the default ones the rows ask for, and which shape the default ones have.

An effect that stands at a place in one of several shapes (the speed over which dry friction changes its sign) has the
shape of the highest evidence. Optional effects are selected as the gap workflow selects names: one by one by their
evidence, and those go again that are worth nothing where blocks of time disagree on their size
(:mod:`geomid_ros.inference`).

What a model lacks repeats in rows that follow one another: a channel whose blocks of time disagree has fewer rows that
count, for links and effects alike. Their number is estimated beside what was chosen, in turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.estimation.problem import Problem
from geomid_ros.inference.design import ChannelFolds, Design
from geomid_ros.inference.fit import fit, independent
from geomid_ros.inference.prior import CERTAINTY, Prior
from geomid_ros.inference.probability import supported
from geomid_ros.inference.selection import Selection
from geomid_ros.model.effects import joints_of
from geomid_ros.model.measurement import Coefficient, Mechanism
from geomid_ros.types import FloatArray, IntArray

_ODDS = 0.3
"""Prior odds of an optional effect at a place."""
_OF_PAIR = 0.03
"""Of these, where it is one of two joints: most joints have motors of their own."""
_WRIST = 3  # joints, the last ones, of which one motor may turn two
_ROUNDS = 3
_FREE = 1e3  # prior standard deviation of what is always there, in sizes of its channel


def choose(problem: Problem, earlier: IntArray | None = None) -> IntArray:
    """The parameters that the rows ask for, by their columns: all that are not optional, each in its best shape, and
    the optional ones that are believed.

    Args:
        problem: with all coefficients.
        earlier: what was chosen for fewer of the same rows, to go on from.
    """
    rows = _Rows(problem)
    if not (rows.has_choice and rows.enough):
        return rows.standing
    kept = rows.standing if earlier is None else earlier
    shapes = tuple(c for c in kept.tolist() if c >= rows.first and rows.mechanism(c) in rows.always)
    options = [option for option in rows.options if option.column in kept]
    design, seen = rows.design, list[tuple[tuple[int, ...], set[int]]]()
    for _ in range(_ROUNDS):
        design = independent(rows.design, rows.selection(design, shapes).fit(options))
        shapes = _shaped(rows, design, shapes, options)
        selection = rows.selection(design, shapes)
        _, found, _ = supported(selection, selection.settle(selection.fit(options)))
        options = list(found.chosen)
        if (chosen := (shapes, {option.column for option in options})) in seen:
            break
        seen.append(chosen)
    return np.sort(np.array([*range(rows.first), *shapes, *(option.column for option in options)]))


@dataclass(frozen=True, eq=False)
class _Option:
    """A coefficient that may be left out, the parameter in this ``column``, with prior ``odds``."""

    column: int
    coefficient: Coefficient
    odds: float

    payload = None
    rescales = confusable_with_payload = relinearises = False
    usual = (0.0,)

    @property
    def terms(self) -> tuple[int, ...]:
        """Its column."""
        return (self.column,)

    @property
    def cost(self) -> float:
        """Minus twice the logarithm of the prior odds."""
        return -2.0 * float(np.log(self.odds))

    @property
    def positives(self) -> int:
        """1 if it cannot be negative."""
        return int(self.coefficient.positive)

    @property
    def group(self) -> Mechanism:
        """What there is once, in whatever shape."""
        return self.coefficient.mechanism

    def excludes(self, other: _Option) -> bool:
        """Another shape of the same."""
        return self.group == other.group

    def includes(self, other: _Option) -> bool:
        """The same."""
        return self.group == other.group

    def is_out_of_range(self, coefficients: FloatArray) -> bool:
        """Whether it cannot have this value."""
        form = self.coefficient.effect.own[self.coefficient.index]
        return not form.above < coefficients[0] < form.below


def _shaped(rows: _Rows, design: Design, shapes: tuple[int, ...], options: Sequence[_Option]) -> tuple[int, ...]:
    """The columns of what is always there, each mechanism in the shape of the highest evidence, one after the other."""
    best = rows.selection(design, shapes).fit(options)
    for place, column in enumerate(shapes):
        for other in rows.columns:
            if other != column and rows.mechanism(other) == rows.mechanism(column):
                trial = (*shapes[:place], other, *shapes[place + 1 :])
                found = fit(design, rows.prior(trial), options, best, best.spreads)
                if found.score < best.score:
                    best, shapes = found, trial
    return shapes


@dataclass(frozen=True, eq=False)
class _Rows:
    """The settled rows of a ``problem`` with all its coefficients."""

    problem: Problem

    @property
    def first(self) -> int:
        """The parameter that is the first of the coefficients."""
        return self.problem.model.dimension - len(self.problem.model.coefficients)

    @property
    def columns(self) -> range:
        """The columns of the coefficients."""
        return range(self.first, self.problem.model.dimension)

    def coefficient(self, column: int) -> Coefficient:
        """The coefficient of a column."""
        return self.problem.model.coefficients[column - self.first]

    def mechanism(self, column: int) -> Mechanism:
        """What there is once, whatever constants it has."""
        return self.coefficient(column).mechanism

    @cached_property
    def standing(self) -> IntArray:
        """The columns of all that may not be left out, in its usual shape."""
        own = [c for c in self.columns if not self.coefficient(c).optional]
        return np.array([*range(self.first), *own])

    @cached_property
    def always(self) -> set[Mechanism]:
        """What is never left out."""
        return {self.mechanism(column) for column in self.standing.tolist() if column >= self.first}

    @cached_property
    def options(self) -> list[_Option]:
        """What may be left out."""
        beyond = len(self.problem.model.robot.joints) - _WRIST
        own = [c for c in self.columns if self.mechanism(c) not in self.always]
        own = [c for c in own if len(joints := joints_of(self.coefficient(c).place)) < 2 or min(joints) >= beyond]
        shapes: dict[Mechanism, int] = {}
        for c in own:
            shapes[self.mechanism(c)] = shapes.get(self.mechanism(c), 0) + 1
        found = []
        for c in own:
            coefficient = self.coefficient(c)
            odds = _ODDS * (_OF_PAIR if len(joints_of(coefficient.place)) > 1 else 1.0)
            found.append(_Option(c, coefficient, odds / shapes[coefficient.mechanism]))
        return found

    @property
    def has_choice(self) -> bool:
        """Whether anything may be left out, or have another shape."""
        return len(self.standing) < self.problem.model.dimension

    @property
    def enough(self) -> bool:
        """Whether some channel has more independent rows than unknowns without a choice: fewer ask for nothing."""
        columns = [len(np.intersect1d(channel.columns, self.standing)) for channel in self.problem.model.channels]
        return bool(np.any(self.design.counts > columns))

    @cached_property
    def design(self) -> Design:
        """Of all columns; only the share of the rows that is independent counts."""
        problem, size = self.problem, self.problem.model.dimension
        own = zip(problem.model.channels, problem.summary.parts(), strict=False)
        folds = [(channel, np.array([part.factor.T @ part.factor for part in parts])) for channel, parts in own]
        used = np.any([np.any(products, axis=(1, 2)) for _, products in folds], axis=0)
        channels = [
            ChannelFolds(
                problem.independent * products[used],
                np.append(channel.columns, size),
                size,
                problem.independent * count,
                {int(column): int(column) for column in channel.columns if column >= self.first},
            )
            for (channel, products), count in zip(folds, problem.counts, strict=False)
        ]
        return Design.of(channels, self.first)

    def selection(self, design: Design, shapes: Sequence[int]) -> Selection[_Option, int]:
        """Among the options, beside what is always there, in these ``shapes``, by their columns."""
        return Selection(design, self.prior(shapes), self.options)

    def prior(self, shapes: Sequence[int]) -> Prior[int]:
        """Of the links, and of what is always there, in these ``shapes``."""
        return Prior(
            inertias=self.problem.prior[: self.first],
            spread=self.problem.usual,
            terms=tuple(shapes),
            values=np.zeros(len(shapes)),
            spreads=_FREE * self.design.scales(shapes),
            certainty=CERTAINTY,
            rows=self._known,
        )

    def _known(self, terms: Sequence[int]) -> FloatArray:
        """Weighed masses, and what else the problem knows of the parameters."""
        known, columns = self.problem.known, [*range(self.first), *terms]
        off = known.rows[:, : self.first] @ self.problem.prior[: self.first] - known.targets
        return np.column_stack([known.rows[:, columns], off])
