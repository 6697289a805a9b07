"""Tolerances of arithmetic in this package: rounding, ends of iterations, bounds of steps and searches.

None is a decision rule.
"""

ROUNDING = 1e-9
"""Singular values of unit-size rows, relative to the largest, that may be rounding errors."""
ROUNDING_OF_PRODUCTS = 1e-12
"""Rounding of sums of products, and of sums without scaling, relative to the largest."""
LEAST_GRADIENT = 1e-14
"""Least relative gradient, as a fraction of the sum of the weights; rounding allows no less."""
ROUNDS = 50
"""Largest number of rounds of a fixed point."""
SETTLED = 1e-2
"""Change of logarithms of variances and weights, and of standardised coordinates, at which a fixed point has settled:
far below their uncertainty."""
LEAST_DECREASE = 1e-3
"""Decrease of half a score, or of a score, below which a search for its minimum ends."""
LARGEST_STEP = 0.5
"""Largest step in tangent coordinates, within which rows are nearly linear."""
LEAST_DEVIATION = 1e-4
"""Least standard deviation of tangent coordinates between robots."""
SHORTLIST = 4
"""Number of effects that the score test prefers and of which the best is chosen exactly. The test alone does not know
which coefficients become negative, nor how the noise falls."""
