"""The paper reproduced, with other methods on the same rows: `make bench`."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the package's entry points do; small matrices gain nothing
