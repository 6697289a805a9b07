"""The real node under load: rates, losses, latencies, memory, leaks, and how it ends; everything over DDS."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "test"))  # whose stages and processes are used here
