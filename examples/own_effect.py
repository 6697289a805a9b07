"""Identify an effect of your own: the drag of a fluid that the robot moves in.

Run it from anywhere: ``python examples/own_effect.py``. It writes into ``geomid_own``.
"""

from pathlib import Path

import numpy as np

import geomid_ros

BAGS = Path(__file__).parents[1] / "bags"


# All that is known of an effect is in its class: what it is called, its parameters with their units and limits, and
# its effort per unit of the coefficient. This one is a function of one joint's motion; geomid_ros.model.effects has the
# base classes of others (two joints, the whole robot, a sensor).
@geomid_ros.register
class QuadraticDrag(geomid_ros.JointEffect):
    """Drag: effort ``c v |v|``."""

    name = "quadratic_drag"
    label = "drag of a fluid"
    meaning = "effort coefficient v |v|"
    # Units at a revolute and at a prismatic joint. With ``above=0.0`` the coefficient could not be negative.
    parameters = (geomid_ros.ParameterForm("coefficient", ("N m s^2/rad^2", "N s^2/m^2")),)
    settled_by = "runs of this joint at several constant speeds, up to its fastest"

    def column(self, motion: geomid_ros.JointMotion) -> np.ndarray:
        """Velocities are in rad/s (or m/s)."""
        return motion.velocity * np.abs(motion.velocity)


# From here on it has a name like any other: in identify and find_gap, in files, pictures and tables.
usual = ["viscous_friction", "coulomb_friction", "rotor_inertia", "effort_offset"]
found = geomid_ros.identify(BAGS / "arm7", BAGS / "arm7.urdf", effects=[*usual, "quadratic_drag"])

# This arm moves in air: within a few standard deviations there is no drag.
for effect in found.effects:
    if effect.name == "quadratic_drag":
        print(f"{effect.joint}: drag {effect.value:+.4f} ± {effect.std:.4f} {effect.unit}")

print("\nWritten:", *found.save("geomid_own"))
