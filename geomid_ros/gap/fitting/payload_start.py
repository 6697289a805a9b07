"""What is thought of a payload before it is fitted, and where its fit begins."""

from __future__ import annotations

import numpy as np

from geomid_ros.gap.fitting.profile_objective import ProfileObjective
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import Point
from geomid_ros.types import FloatArray

SPREAD = 3.0
"""Of a payload about the usual one, a geodesic distance: next to nothing is known."""
_MASS = 0.2  # of the mean link's mass
_SIZE = 0.1  # [m]
_CENTRINGS = 5


def usual(links: FloatArray, carrier: int) -> FloatArray:
    """Parameters ``(10,)`` of the body that a payload of one of the ``links (n, 10)`` usually is."""
    return _ball(_MASS * float(np.mean(links[:, 0])), links[carrier, 1:4] / links[carrier, 0])


def _ball(mass: float, centre: FloatArray) -> FloatArray:
    """Parameters ``(10,)`` of a body of a payload's usual size."""
    pseudo = mass * np.diag([_SIZE**2] * 3 + [1.0])
    pseudo[:3, :3] += mass * np.outer(centre, centre)
    pseudo[:3, 3] = pseudo[3, :3] = mass * centre
    result: FloatArray = pseudo_inertia.to_parameters(pseudo)
    return result


def centred(objective: ProfileObjective, point: Point, payloads: int) -> Point:
    """With the last bodies where least squares that knows no cone wants their masses and centres.

    From elsewhere a body gets there by growing thin, and then hardly moves any more.
    """
    manifold = objective.manifold
    places = slice(manifold.inertial.stop - 10 * payloads, manifold.inertial.stop)
    evaluation = objective.evaluate(point)
    for _ in range(_CENTRINGS):
        hessian = evaluation.information + np.diag(objective.weights)
        step = -np.linalg.solve(hessian, evaluation.gradient)
        parameters = point.parameters.copy()
        wanted = parameters + manifold.whiten(point, np.eye(manifold.dimension)) @ step
        bodies = wanted[places].reshape(-1, 10)
        if np.any(bodies[:, 0] <= 0.0):
            break
        parameters[places] = np.concatenate([_ball(body[0], body[1:4] / body[0]) for body in bodies])
        candidate = manifold.point(parameters)
        trial = objective.evaluate(candidate)
        if trial.value >= evaluation.value:
            break
        point, evaluation = candidate, trial
    return point
