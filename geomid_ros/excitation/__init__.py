"""Motions that tell what a robot weighs."""
