"""The blind bench: its cases, its judgement, its second simulator, and a small fixed part of it."""
