"""Tests of the estimation floor."""
