"""Which named numbers matter: each one alone off, infinite, three times and a third as large, on a subset of the
benches."""
