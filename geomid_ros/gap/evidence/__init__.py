"""What the recordings say before anything is fitted: records, noise floor, repeats, columns."""
