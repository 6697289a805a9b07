"""Numbers that are no rules: what a robot can do, how far arithmetic is trusted, and bounds against abuse."""

from __future__ import annotations

from math import tau

# Physical limits.
LARGEST_NUMBER = 1e9  # In SI units: no robot measures more
FASTEST = tau  # [rad/s, m/s] No limit of a speed above is believed, as many URDFs have placeholders
FINEST = 1e-6  # [rad, m] No position is measured better
SHORTEST_CONTACT = 33e-3  # [s] A collision of 40 ms is larger than a quarter of its height for so long
LONGEST_SAME = 0.05  # [s] An effort that moves a joint is hardly the same for longer
LONGEST_DELAY = 1.0  # [s] Of efforts
ACCELEROMETER_BIAS = 0.03  # [m/s^2] Standard deviation of what it shows otherwise from one start to the next
CLEAR = 4.0  # What is clearly larger is so many times as large: a step, or a change, beside usual ones

# Tolerances of arithmetic.
PERIOD_ROUNDING = 10_000  # [ns] An inferred period of the grid is rounded to this; none is shorter
UNLIKE_ONE = 1e-2  # of a quaternion's length
LARGEST_NOISE_GAIN = 2.0  # of the interpolation by cubics
MEAN_STEPS = 4  # iterations to the mean of poses, at most
MEAN_TOLERANCE = 1e-12  # at which they end

# Bounds against abuse: the sender decides how much comes.
PATIENCE = 1000  # messages of all topics: after so many a suspicious one passes, though fewer of its own have come
MOST_WAITING = 10_000  # messages that are kept until the period is known, or while a publisher is silent; joints' names
HORIZON = 60_000_000_000  # [ns] A topic this far behind the others is not waited for
MOST_KINDS = 50  # layouts of messages that are remembered, and reasons of a topic
LONGEST_REASON = 200  # [characters]
MOST_BYTES = 100_000_000  # of messages or rows that wait or are remembered
BYTES_BESIDE_NUMBERS = 400  # of a remembered block
