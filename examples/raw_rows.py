"""The paper's estimator on rows of your own, ``A Phi = b``, without a robot, a bag or ROS.

Run it from anywhere: ``python examples/raw_rows.py``.
"""

import numpy as np

import geomid_ros

rng = np.random.default_rng(1)

# Two links. Ten numbers each, about the link frame's origin: m, hx, hy, hz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz.
prior = np.array([[2.0, 0.0, 0.0, 0.2, 0.04, 0.0, 0.04, 0.0, 0.0, 0.01]] * 2)
truth = prior * np.array([[1.2], [0.8]])

# Rows from your own sensors and equations; here they are drawn, and measured with noise. There are fewer rows than
# unknowns: what they do not tell stays as near to the prior as it can, and every body is one that can exist.
rows = rng.normal(size=(12, prior.size))
sigma = 0.01
targets = rows @ truth.ravel() + rng.normal(scale=sigma, size=len(rows))

# gamma is the weight of the prior, as a share of the sum of the rows' weights.
found = geomid_ros.solve_rows(rows, targets, sigma, prior, gamma=1e-4)

print("converged:", found.solution.converged, " rows set aside:", int(found.set_aside.sum()))
print("masses [kg], prior:", prior[:, 0], " truth:", truth[:, 0], " found:", found.parameters[:, 0].round(3))
left = np.sqrt(np.mean((rows @ found.parameters.ravel() - targets) ** 2))
print(f"RMS of what the rows leave unexplained: {left:.4f}, noise {sigma}")
