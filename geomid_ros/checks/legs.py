"""Whether the efforts of legs carry the robot."""

from __future__ import annotations

import numpy as np

from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.model.contacts import Legs
from geomid_ros.model.samples import Samples

_USUAL = 0.5, 3.0  # shares of the URDF's weight: it may lack a payload


def carried_weight(legs: Legs, samples: Samples) -> Finding | None:
    """That by the efforts of the legs the feet do not carry the robot, if so; ``samples`` are any of a recording."""
    shares = legs.carried(samples)
    shares = shares[np.isfinite(shares)]
    share = float(np.mean(shares)) if len(shares) else 1.0
    if _USUAL[0] <= share <= _USUAL[1]:
        return None
    sentence = (
        f"by the efforts of their legs the feet carry {share:.2g} of the robot's weight on average, expected about 1: "
        "check that efforts are in N m with their sign (effort_gain, --gain), that all feet are named (contacts), and "
        "that the IMU's frame is not upside down"
    )
    return Finding(cause=Cause(kind="legs", sentence=sentence))
