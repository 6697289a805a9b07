"""Which named numbers matter: each one alone off (zero, infinite), three times and a third as large.

    python -m benchmarks.ablation [--only signals ...] [--variants 0 inf] [--cases TEXT ...] [--budget MINUTES]

A number is tried on the cases of its package that reach a line which reads it, until some have changed. A case changes
if a figure does by more than 1 %, or a verdict. A number that nobody notices at zero or infinity is not scaled, too.
Finished numbers are kept in the file and not run again; delete it after a change of the code.
Numbers that are read when a module is imported are evaluated anew in the modules that hold them.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.ablation.cases import cases
from benchmarks.ablation.constants import PACKAGES, VARIANTS, Constant, constants
from benchmarks.ablation.running import ENOUGH, Baseline, baseline, changed_by


def main() -> None:
    """Try what is not known yet within the budget, then print the table of all that is known."""
    arguments = _parsed()
    known: dict[str, Any] = json.loads(arguments.out.read_text()) if arguments.out.exists() else {}
    end = time.monotonic() + 60.0 * arguments.budget
    wanted = [_package(name) for name in arguments.only]
    chosen = {
        package: [c for c in constants(package) if any(c.label.startswith(name) for name in arguments.only)]
        for package in dict.fromkeys(wanted)
    }
    for package, own in chosen.items():
        left = [constant for constant in own if _variants(constant, known.get(constant.label), arguments.variants)]
        if left and not arguments.table:
            for label, entry in _tried(package, left, known, arguments, end):
                known[label] = entry
                arguments.out.parent.mkdir(parents=True, exist_ok=True)
                arguments.out.write_text(json.dumps(known, indent=1))
    for package, own in chosen.items():
        _print(package, [(constant.label, known[constant.label]) for constant in own if constant.label in known])


def _parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ablation", description=__doc__)
    parser.add_argument(
        "--only",
        nargs="+",
        default=list(PACKAGES),
        metavar="MODULE",
        help=f"of {', '.join(PACKAGES)}, e.g. signals.gates",
    )
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS), choices=VARIANTS, help="other values to try")
    parser.add_argument("--cases", nargs="+", default=[""], metavar="TEXT", help="only those with it in their names")
    parser.add_argument("--budget", type=float, default=600.0, help="minutes (%(default)g)")
    parser.add_argument("--out", type=Path, default=Path("out/ablation.json"), help="finished numbers (%(default)s)")
    parser.add_argument("--table", action="store_true", help="only print what is known")
    return parser.parse_args()


def _package(name: str) -> str:
    package = name.split(".", maxsplit=1)[0]
    if package not in PACKAGES:
        sys.exit(f"no package {package}; known are {', '.join(PACKAGES)}")
    return package


def _variants(constant: Constant, entry: dict[str, Any] | None, wanted: Collection[str]) -> dict[str, Any]:
    """The values that are still to be tried: none of a number that no case reaches or that nobody needs."""
    every = {name: value for name, value in constant.variants().items() if name in wanted}
    if entry is None:
        return every
    changed = entry["changed"]
    if not entry["reached"] or (changed.keys() >= {"0", "inf"} and not any(changed.values())):
        return {}
    return {name: value for name, value in every.items() if name not in changed}


def _tried(
    package: str, left: Sequence[Constant], known: dict[str, Any], arguments: argparse.Namespace, end: float
) -> Iterable[tuple[str, dict[str, Any]]]:
    """Entries of the file, by the labels of the numbers, until the time is over."""
    every = [case for case in cases(package) if any(text in case.name for text in arguments.cases)]
    usual: dict[str, Baseline] = {case.name: baseline(case) for case in every}
    print(f"{package}: {len(every)} cases, {sum(each.seconds for each in usual.values()):.1f} s each time", flush=True)
    for constant in left:
        if time.monotonic() > end:
            print(f"{package}: no time left for {constant.label} and what follows", flush=True)
            return
        reached = [case for case in every if usual[case.name].lines & constant.lines]
        entry = known.get(constant.label, {"value": str(constant.value), "reached": len(reached), "changed": {}})
        while variants := _variants(constant, entry, arguments.variants):
            name, other = next(iter(variants.items()))
            entry["changed"][name] = changed_by(constant, other, reached, usual)
        print(f"{constant.label}: {_verdict(entry)}", flush=True)
        yield constant.label, entry


def _verdict(entry: dict[str, Any]) -> str:
    """What the ablation says of a number, in a word or two."""
    if not entry["reached"]:
        return "not reached"
    noticing = {case for own in entry["changed"].values() for case in own}
    if not noticing:
        return "unnoticed"
    return f"only {noticing.pop()}" if len(noticing) == 1 else ""


def _print(package: str, known: Sequence[tuple[str, dict[str, Any]]]) -> None:
    table = Table(title=f"{package}: cases that change", box=box.SIMPLE_HEAD, title_justify="left")
    for heading in ("number", "value", "reached", *VARIANTS, "benches", "verdict"):
        table.add_column(heading, justify="left" if heading in ("number", "benches", "verdict") else "right")
    for label, entry in known:
        changed = entry["changed"]
        cells = [_cell(changed[name]) if name in changed else "-" for name in VARIANTS]
        benches = Counter(_bench(case) for own in changed.values() for case in own)
        table.add_row(
            label.removeprefix(f"{package}."), entry["value"][:24], str(entry["reached"]), *cells,
            ", ".join(benches), _verdict(entry),
        )  # fmt: skip
    Console(width=170).print(table)
    verdicts = Counter(_verdict(entry).split()[0] if _verdict(entry) else "matters" for _, entry in known)
    print(f"{package}: {len(known)} numbers; {', '.join(f'{count} {name}' for name, count in verdicts.items())}")
    print("A cell: cases in which a figure changes by more than 1 %, and of these (v) those in which a verdict does.\n")


def _cell(changed: dict[str, list[str]]) -> str:
    verdicts = sum(any(name.isupper() for name in names) for names in changed.values())
    count = f"{len(changed)}+" if len(changed) == ENOUGH else str(len(changed))
    return f"{count} ({verdicts}v)" if verdicts else count


def _bench(case: str) -> str:
    return case.split(" ", maxsplit=1)[0].removesuffix(",")


if __name__ == "__main__":
    main()
