"""The picture of the architecture is that of the code."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from .reading import ROOT, text_of

MODULES = re.findall(r'font-weight="bold"[^>]*>([\w/]+)<', text_of("docs/pages/figures/architecture.svg"))


def test_it_is_the_generator_s() -> None:
    generator = ROOT / "docs/generators/architecture.py"
    subprocess.run([sys.executable, str(generator), "--check"], check=True)


@pytest.mark.parametrize("module", MODULES)
def test_a_message_passes_modules_that_exist(module: str) -> None:
    assert (ROOT / "geomid_ros" / f"{module}.py").is_file()
