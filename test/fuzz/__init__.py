"""A short run of the fuzzer, and proof that it finds what it is there for."""
