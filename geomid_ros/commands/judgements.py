"""Prints whether a result can be used, and what became of the messages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from rich.console import Console
from rich.markup import escape

from geomid_ros.signals.ledger import Account

_MOST_REASONS = 5


def print_verdict(console: Console, reasons: Iterable[str], warnings: Iterable[str]) -> None:
    """Print why a result cannot be used, then what else to know."""
    for word, sentences in (("DOUBTFUL", reasons), ("Warning", warnings)):
        for sentence in sentences:
            console.print(f"[bold]{word}:[/bold] {escape(sentence)}", highlight=False)


def print_messages(console: Console, topics: Mapping[str, Account]) -> None:
    """Print of each topic how many messages were used, and why others were not."""
    for topic, account in topics.items():
        refused = account.rejected + account.dropped
        reasons = "".join(f"; {count} {reason}" for reason, count in refused.most_common(_MOST_REASONS))
        noted = "".join(f"; noted: {remark} ({count})" for remark, count in account.noted.most_common(_MOST_REASONS))
        line = f"{topic}: {account.accepted} of {account.received} messages used{reasons}{noted}"
        console.print(escape(line), highlight=False)
