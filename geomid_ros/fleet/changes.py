"""What of a robot has changed between two estimates."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

_LARGEST_CHANCE = 1e-4  # of any of the numbers, if none has changed


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """The links and effects whose numbers differ by more than their standard deviations explain, in words, the surest
    first.

    What both estimates took from the same prior counts as uncertain twice: little data tell no change.

    Args:
        before, after: documents of ``estimate.json`` of one robot.
    """
    pairs = [*_masses(before, after), *_centres(before, after), *_effects(before, after)]
    scores = [(abs(new - old) / math.hypot(*stds), words) for old, new, stds, words in pairs if math.hypot(*stds) > 0.0]
    least = math.sqrt(2.0) * _inverse_erfc(_LARGEST_CHANCE / max(len(scores), 1))
    return [words for score, words in sorted(scores, reverse=True) if score > least]


def _inverse_erfc(chance: float) -> float:
    from scipy.special import erfcinv  # noqa: PLC0415 of this function alone

    return float(erfcinv(chance))


_Pair = tuple[float, float, tuple[float, float], str]


def _links(
    before: Mapping[str, Any], after: Mapping[str, Any]
) -> Iterator[tuple[Mapping[str, Any], Mapping[str, Any]]]:
    old = {link["name"]: link for link in before["links"]}
    return ((old[link["name"]], link) for link in after["links"] if link["name"] in old)


def _masses(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[_Pair]:
    for old, new in _links(before, after):
        stds = old["std"]["mass"], new["std"]["mass"]
        yield old["mass"], new["mass"], stds, f"{new['name']}: {old['mass']:.3g} kg → {new['mass']:.3g} kg"


def _centres(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[_Pair]:
    for old, new in _links(before, after):
        for axis, then, now, *stds in zip(
            "xyz", old["com"], new["com"], old["std"]["com"], new["std"]["com"], strict=True
        ):
            words = f"{new['name']}: centre of mass, {axis} {1e3 * then:.3g} mm → {1e3 * now:.3g} mm"
            yield then, now, (stds[0], stds[1]), words


def _effects(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[_Pair]:
    old = {(effect["name"], effect["joint"]): effect for effect in before["effects"]}
    for new in after["effects"]:
        then = old.get((new["name"], new["joint"]))
        if then is not None and "value" in new and then.get("std") and new.get("std"):
            name = new["name"].replace("_", " ")
            words = f"{name} of {new['joint']}: {then['value']:.3g} → {new['value']:.3g} {new.get('unit', '')}".rstrip()
            yield then["value"], new["value"], (then["std"], new["std"]), words
