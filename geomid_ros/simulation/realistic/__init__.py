"""A robot as robots are."""
