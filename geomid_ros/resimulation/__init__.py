"""Resimulation of recordings in MuJoCo, from the written model files."""
