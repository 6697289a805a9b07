"""Evidence before anything is fitted: records, noise floor, repeats, columns."""
