"""Small faults planted in the package, and whether the tests notice them."""
