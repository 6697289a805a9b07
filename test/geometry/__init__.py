"""Theorems of floor 0. A package, so that its modules may share ``bodies``."""
