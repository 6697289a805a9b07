"""Where simulation and measurement disagree: locate, name, and what the model is with the effect added."""
