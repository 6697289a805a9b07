"""Links that are let go: which these are, and what that says of names in whose places they would be."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geomid_ros.gap.judgement import needed
from geomid_ros.gap.search import analysis
from geomid_ros.gap.search.beam_search import Search

from .small import PAYLOAD, PRIOR, Recording, at

SPRING = at("spring", 0)


@pytest.mark.parametrize(
    ("usual", "spread", "expected"),
    [(0.05, 0.15, set()), (0.05, 0.5, {0}), (0.2, 0.39, set()), (0.2, 0.41, {0}), (0.5, 0.9, set()), (0.5, 1.1, {0})],
)
def test_a_link_is_let_go_that_is_twice_as_wrong_as_usual(usual: float, spread: float, expected: set[int]) -> None:
    """And than drawings are: a link that was identified may have been changed."""
    search = Search(Recording(3, [SPRING]).design({}), replace(PRIOR, spread=usual), [SPRING])
    found: Any = SimpleNamespace(spreads=np.array([spread]))
    assert search.let_go(found) == expected


@dataclass(frozen=True, eq=False)
class Found:
    """A fit in short."""

    chosen: tuple[Any, ...] = ()
    score: float = 0.0
    let_go: frozenset[int] = field(default_factory=frozenset)


def searching(**methods: Any) -> Any:
    return SimpleNamespace(
        prior=PRIOR,
        let_go=lambda found: set(found.let_go),
        possible=lambda _: True,
        simplified=lambda found: found,
        without_absurd=lambda found: found,
        **methods,
    )


@pytest.mark.parametrize(
    ("score", "still", "taken"),
    [(-13.0, (), True), (-11.0, (), False), (-13.0, (1,), True), (-13.0, (0, 1), False), (-13.0, (2,), False)],
)
def test_names_beside_which_fewer_links_are_let_go_must_be_worth_one(
    score: float, still: tuple[int, ...], taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    held, instead = Found((SPRING,)), Found((SPRING,), score, frozenset(still))
    search = searching(fit=lambda chosen, start: instead if (chosen, start) == (held.chosen, held) else None)
    first = analysis.Analysis(
        **dict.fromkeys(("problem", "bare", "whole", "floor", "curves"), None),  # type: ignore[arg-type]
        search=search,
        names=Found(let_go=frozenset({0, 1})),  # type: ignore[arg-type]
    )
    monkeypatch.setattr(analysis, "_searched", lambda *_: SimpleNamespace(names=held))
    monkeypatch.setattr(analysis, "with_curves", lambda _, names: names)
    found = analysis._with_held_links(None, first)  # type: ignore[arg-type]
    assert (found.names is instead) is taken
    assert (found is first) is not taken


@pytest.mark.parametrize(
    ("name", "before", "after", "stays"),
    [
        (SPRING, (), (), False),
        (SPRING, (), (1,), True),
        (SPRING, (1,), (1,), False),
        (PAYLOAD, (), (1,), False),
    ],
    ids=["nothing is let go", "a link is", "it was before", "it carries the payload"],
)
def test_a_name_stays_without_which_a_link_is_let_go(
    name: Any, before: tuple[int, ...], after: tuple[int, ...], stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though unseen data are no worse without it."""
    names, smaller = Found((name,), 0.0, frozenset(before)), Found((), 50.0, frozenset(after))
    found: Any = SimpleNamespace(search=searching(without=lambda *_: smaller), names=names)
    monkeypatch.setattr(needed, "HeldOut", lambda *_: None)
    monkeypatch.setattr(needed, "_worse", lambda *_: 0.0)
    monkeypatch.setattr(needed, "without", lambda *_: smaller)
    monkeypatch.setattr(needed, "with_curves", lambda _, names: names)
    monkeypatch.setattr(needed, "replace", lambda _, **changed: SimpleNamespace(**changed))
    assert (needed.confirmed(None, None, found).names is names) is stays  # type: ignore[arg-type]
