"""For all tests."""

import os

# As the commands and the node do: threads of the linear algebra library would only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
