"""Export of results to the formats of other software."""
