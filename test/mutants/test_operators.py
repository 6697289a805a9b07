"""Planted faults: each changes one place of a program, and nothing that is no program."""

from dataclasses import replace

from benchmarks.mutants.operators import Mutant, mutants
from benchmarks.mutants.selection import Selection

SOURCE = '''
"""Words 1 > 2."""

from x import y

__all__ = ["f"]


@decorated(size=3)
def f(a: Literal[4], *b: int) -> dict[int, float]:
    """Words: not a - b."""
    if not a or b[a:] < 5:
        raise ValueError(f"{a + 1} of 6")
    g.h(a, strict=True)
    a.x, c = y(a), min(a, 7.5)
    return [np.clip(v, -c, c) for v in b if v is not None]
'''


def changed(source: str) -> dict[str, set[str]]:
    """All that may stand in the place of each text."""
    found: dict[str, set[str]] = {}
    for mutant in (mutant for place in mutants("f.py", source) for mutant in place):
        found.setdefault(mutant.old, set()).add(mutant.new)
    return found


def test_everything_that_is_program_is_changed_and_nothing_else() -> None:
    assert changed(SOURCE) == {
        "not a or b[a:] < 5": {"(not a and b[a:] < 5)", "(not (not a or b[a:] < 5))"},
        "not a": {"a"},
        "b[a:] < 5": {"(b[a:] <= 5)", "(b[a:] >= 5)"},
        "a:": {"a + 1:"},
        "5": {"(10)", "(6)", "(0)", "(-5)"},
        'raise ValueError(f"{a + 1} of 6")': {"pass"},
        "g.h(a, strict=True)": {"pass"},
        "min(a, 7.5)": {"(max(a, 7.5))", "a", "(7.5)"},
        "7.5": {"(15.0)", "(8.5)", "(0.0)", "(-7.5)"},
        "return [np.clip(v, -c, c) for v in b if v is not None]": {"return None"},
        "[np.clip(v, -c, c) for v in b if v is not None]": {"([np.clip(v, -c, c) for v in b])"},
        "np.clip(v, -c, c)": {"v"},
        "-c": {"c"},
        "v is not None": {"(v is None)"},
    }


def test_a_fault_behind_words_of_other_alphabets_is_where_it_is() -> None:
    ((less, _),) = mutants("f.py", 's = "±µ"; t = a < b')
    assert less.applied('s = "±µ"; t = a < b') == 's = "±µ"; t = (a <= b)'


def test_tests_that_run_the_line_come_first_and_others_of_their_files_after() -> None:
    selection = Selection()
    selection.seconds.update({"a::slow": 5.0, "a::quick": 1.0, "b::runs": 2.0, "b::other": 0.1, "c::no": 0.1})
    selection.lines["f.py", 3] = {"a::slow", "b::runs"}
    selection.files["f.py"] = {"a::slow", "b::runs", "c::no"}
    mutant = Mutant(path="f.py", lines=(2, 4), line=3, start=0, stop=1, old="a", new="b")
    order = ["b::runs", "a::slow", "b::other", "a::quick"]
    assert selection.tests(mutant, 100.0) == order
    assert selection.tests(mutant, 7.05) == order[:2]
    at_import = replace(mutant, lines=(9, 9))
    assert set(selection.tests(at_import, 100.0)) == set(selection.seconds)
