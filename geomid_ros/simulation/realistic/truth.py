"""What is true of a realistic robot beside its links and what is hidden."""

from __future__ import annotations

from typing import Any

import numpy as np

from geomid_ros.simulation.realistic.robot import RealisticRobot
from geomid_ros.simulation.truth import effect_document


def realistic_document(robot: RealisticRobot) -> dict[str, Any]:
    """Hidden ``effects`` and ``standing`` ones; the numbers of ``friction``, ``motors``, ``warm_up`` and ``sensors``;
    ``noise``: standard deviations, those of rounding where an encoder makes it.

    Numbers are in the order of the truth's ``joints`` and in the units that the classes of these names describe.
    """
    rounding = robot.sensors.encoder / np.sqrt(12.0)
    noise = {
        "position": rounding,
        "velocity": np.sqrt(2.0) * rounding / robot.sensors.window,
        "effort": robot.sensors.effort_noise,
        "wrench": robot.sensors.wrench_noise,
    }
    parts = {name: vars(getattr(robot, name)) for name in ("friction", "motors", "warm_up", "sensors")}
    parts["noise"] = noise
    numbers = {name: {key: np.asarray(value).tolist() for key, value in part.items()} for name, part in parts.items()}
    effects = {
        kind: [effect_document(effect) for effect in chosen]
        for kind, chosen in (("effects", robot.hidden), ("standing", robot.standing))
    }
    return {**effects, **numbers}
