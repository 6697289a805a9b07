"""What gets on, for the console: data that come, the first estimate, links that become known."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from geomid_ros.estimation.estimate import QUANTITIES, Estimate, LinkEstimate
from geomid_ros.live.status import Status

_MASS = QUANTITIES[0]
_MOST_NAMES = 8


class News:
    """Compares the status of one second with that of the second before."""

    def __init__(self) -> None:
        self._before = Status(active=False)
        self._coming: dict[str, int] = {}  # topics, and for how many seconds in a row there are data on them
        self._told: set[str] | None = None  # links whose mass has been told; None before the first estimate

    def since(self, status: Status) -> Iterator[str]:
        """Sentences on what is new in the status of another second."""
        accepted = {topic: account.accepted for topic, account in status.since(self._before).accounts.items()}
        self._before = status
        self._coming = {topic: self._coming.get(topic, 0) + 1 for topic, count in accepted.items() if count > 0}
        yield from (
            f"{topic}: receiving {accepted[topic]} messages/s" for topic in self._coming if self._coming[topic] == 2
        )
        yield from self._estimated(status.estimate)

    def _estimated(self, estimate: Estimate | None) -> Iterator[str]:
        if estimate is None:
            self._told = None
            return
        told = {link.name: link for link in estimate.links if _MASS in link.identified}
        if self._told is None:
            self._told = set(told)
            yield _first(estimate, told.values())
        elif new := [link for name, link in told.items() if name not in self._told]:
            self._told.update(told)
            yield f"identified: {_list(map(_mass, new))}"


def _first(estimate: Estimate, told: Iterable[LinkEstimate]) -> str:
    known = _list(map(_mass, told))
    rest = _list(link.name for link in estimate.links if _MASS not in link.identified)
    sentence = f"first estimate, from {estimate.rows_accepted} rows"
    sentence += f"; identified: {known}" if known else "; no mass is individually identifiable yet"
    return sentence + (f"; not identified yet: {rest}" if known and rest else "")


def _mass(link: LinkEstimate) -> str:
    return f"{link.name} {link.mass:.3f} ± {link.std_mass:.3f} kg"


def _list(texts: Iterable[str]) -> str:
    names = [*texts]
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return ", ".join(names[:_MOST_NAMES]) + more
