"""Fuzzing of everything that comes from outside.

A target makes an input from random numbers, most often a valid one with something changed, and tries it. Only errors of
this package may come out, in little time and memory, and no value that a checksum covers may change unseen. Input
number N of a target is always the same, so whatever fails can be tried again alone.
"""
