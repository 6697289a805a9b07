"""Tolerances of arithmetic in this room: rounding, the ends of iterations, bounds of steps. None is a rule."""

ROUNDING = 1e-9
"""Singular values of rows of unit size, relative to the largest, that may be rounding."""
ROUNDING_OF_PRODUCTS = 1e-12
"""The same of sums of products, and of what is added up without scaling."""
LEAST_GRADIENT = 1e-14
"""Of the sum of the weights; rounding allows no less."""
ROUNDS = 50
"""Of a fixed point, at most."""
SETTLED = 1e-2
"""Change of logarithms of variances and weights, and of standardised coordinates, at which a fixed point has settled:
far less than what they are uncertain by."""
LARGEST_STEP = 0.5
"""In tangent coordinates, in which rows are nearly linear."""
LEAST_DEVIATION = 1e-4
"""Of tangent coordinates between robots."""
