"""Tests of floor 1, the model: against pinocchio built and asked apart from the code under test."""
