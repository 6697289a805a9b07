"""Plausibility checks: is a recording of this robot? Signs, units, order of joints, gravity, wrench sensors."""
