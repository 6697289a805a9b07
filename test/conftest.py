"""For all tests."""

import gc
import os

import pytest

from geomid_ros.geometry import compiled

# As the commands and the node do: threads of the linear algebra library would only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# What is imported and collected stays: to look for garbage in it, again and again, takes a twentieth of all the time.
gc.disable()


@pytest.fixture(params=["compiled", "numpy"])
def either(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the compiled functions, and without them."""
    if request.param == "numpy":
        monkeypatch.setattr(compiled, "native", None)
    elif compiled.native is None:
        pytest.skip("built without a compiler: python setup.py build_ext --inplace")


@pytest.fixture
def without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nobody looks at them; what a module shares is drawn nevertheless."""
    from commands.running import undrawn  # noqa: PLC0415 few tests need it

    undrawn(monkeypatch)


@pytest.fixture
def found_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same, and without what else is made of results."""
    from commands.running import found_only as apply  # noqa: PLC0415 few tests need it

    apply(monkeypatch)


def pytest_addoption(parser: pytest.Parser) -> None:
    """For ``make quick``."""
    parser.addoption("--one-case", action="store_true", help="run every parametrized test with its first case only")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what ``--one-case`` says."""
    if config.getoption("--one-case"):
        first = {item.nodeid.partition("[")[0]: item for item in reversed(items)}
        chosen = set(first.values())
        config.hook.pytest_deselected(items=[item for item in items if item not in chosen])
        items[:] = [item for item in items if item in chosen]


def pytest_collection_finish() -> None:
    """From here on there is garbage, which the tests make: little, and it is looked for seldom."""
    gc.freeze()
    gc.set_threshold(50_000)
    gc.enable()
