"""Tests of floor 1, the signals: messages made from formulas in, samples compared with the formulas."""
