"""Gap between simulation and measurement: locate it, name the effect, and add it to the model."""
