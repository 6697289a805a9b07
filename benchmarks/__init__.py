"""The paper reproduced, with other methods on the same rows: `make bench`."""
