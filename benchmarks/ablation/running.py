"""Cases in processes of their own: which lines they reach, and what changes when a number does."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from types import FrameType
from typing import Any, TypeAlias

import numpy as np

from benchmarks.ablation.constants import PACKAGES, ROOT, Constant, Line

Figures: TypeAlias = dict[str, float | str]
"""Numbers, and verdicts in words."""

VISIBLE = 0.01  # a number that changes by this share is said to change
ENOUGH = 4  # cases that notice another value; more are not looked for
_SLOWER = 10.0  # times the usual seconds, and at least half as many: then a case is given up
_FOLDERS = tuple(f"{ROOT / package}/" for package in PACKAGES)
_NO_ANSWER = "no answer"


@dataclass(frozen=True, eq=False)
class Case:
    """A robot of a bench; its data are read already."""

    bench: str
    robot: str
    run: Callable[[], Figures]

    @property
    def name(self) -> str:
        """Bench and robot."""
        return f"{self.bench} {self.robot}"


@dataclass(frozen=True, eq=False)
class Baseline:
    """What a case says as the package is, how long that takes [s], and which lines it reaches."""

    figures: Figures
    seconds: float
    lines: frozenset[Line]


def baseline(case: Case) -> Baseline:
    """Run a case twice; figures that differ between both do not count."""
    ((figures, seconds),) = _answers([case], None, [np.inf])
    with_lines = Case(case.bench, case.robot, lambda: _traced(case.run))
    ((again, _),) = _answers([with_lines], None, [np.inf])
    lines = frozenset(again.pop("lines"))
    changed = changes(figures, again)
    return Baseline({name: value for name, value in figures.items() if name not in changed}, seconds, lines)


def changed_by(
    constant: Constant, value: Any, cases: Sequence[Case], known: dict[str, Baseline]
) -> dict[str, list[str]]:
    """The figures that another value changes, by case, of the first :data:`ENOUGH` cases in which any does."""
    found: dict[str, list[str]] = {}
    patience = [_SLOWER * (0.5 + known[case.name].seconds) for case in cases]
    for case, (figures, _) in zip(cases, _answers(cases, (constant, value), patience), strict=False):
        if differing := changes(known[case.name].figures, figures):
            found[case.name] = differing
            if len(found) == ENOUGH:
                break
    return found


def changes(before: Figures, after: Figures) -> list[str]:
    """Names of figures that differ, verdicts in capitals."""
    return [
        name if isinstance(value, float) and isinstance(after.get(name), float) else name.upper()
        for name, value in before.items()
        if not _alike(value, after.get(name))
    ]


def _alike(before: float | str, after: float | str | None) -> bool:
    if isinstance(before, float) and isinstance(after, float):
        return bool(np.isclose(before, after, rtol=VISIBLE, atol=1e-12, equal_nan=True))
    return before == after


def _answers(
    cases: Sequence[Case], change: tuple[Constant, Any] | None, patience: Sequence[float]
) -> Iterator[tuple[Any, float]]:
    """Figures and seconds of each case, in a process in which a number is changed; another one where that hangs."""
    context = get_context("fork")
    done = 0
    while done < len(cases):
        receiver, sender = context.Pipe(duplex=False)
        process = context.Process(target=_work, args=(cases[done:], change, sender), daemon=True)
        process.start()
        sender.close()
        try:
            while done < len(cases) and receiver.poll(None if patience[done] == np.inf else patience[done]):
                answer = receiver.recv()
                done += 1
                yield answer
        except EOFError:
            pass  # it died
        finally:
            process.kill()
            process.join()
            receiver.close()
        if done < len(cases):
            done += 1
            yield {"error": _NO_ANSWER}, np.inf


def _work(cases: Sequence[Case], change: tuple[Constant, Any] | None, sender: Connection) -> None:
    np.seterr(all="ignore")
    failed = ""
    if change is not None:
        constant, value = change
        try:
            constant.change(value)
        except ArithmeticError as error:  # of a number that is computed from it
            failed = type(error).__name__
    for case in cases:
        begin = time.process_time()
        try:
            figures = {"error": failed} if failed else case.run()
        except Exception as error:  # noqa: BLE001 any: it is what this value leads to
            figures = {"error": type(error).__name__}
        sender.send((figures, time.process_time() - begin))


def _traced(run: Callable[[], Figures]) -> Any:
    """The figures, and the lines of the packages that were reached on the way."""
    lines: set[Line] = set()

    def of_line(frame: FrameType, event: str, _: Any) -> Any:
        if event == "line":
            lines.add((frame.f_code.co_filename, frame.f_lineno))
        return of_line

    def of_call(frame: FrameType, *_: object) -> Any:
        return of_line if frame.f_code.co_filename.startswith(_FOLDERS) else None

    threading.settrace(of_call)
    sys.settrace(of_call)
    try:
        figures: dict[str, Any] = dict(run())
    finally:
        sys.settrace(None)
        threading.settrace(None)  # type: ignore[arg-type]
    figures["lines"] = lines
    return figures
