from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomid_ros.model.effects.effect import Effect, JointEffect
from geomid_ros.model.effects.parameters import EFFORT, ParameterForm
from geomid_ros.model.effects.situation import JointMotion
from geomid_ros.types import FloatArray

SMOOTHINGS = (0.003, 0.01, 0.02, 0.05, 0.1, 0.2)
"""[rad/s or m/s] over which dry friction may change its sign smoothly."""
CREEPS = tuple(float(speed) for speed in 0.002 * 2.0 ** np.arange(8))
"""[rad/s or m/s] below which it may grow with speed, or there is none."""
SIGN_FORMS = (
    ParameterForm("smoothing", ("rad/s", "m/s"), above=0.0, optional=True),
    ParameterForm("creep", ("rad/s", "m/s"), above=0.0, optional=True),
)
"""The same as parameters, of which one is given at most."""


_RAMP = 1.25  # a ramp is most like the hyperbolic tangent of a speed so many times smaller


@dataclass(frozen=True)
class CoulombFriction(JointEffect):
    """Dry friction: effort ``c s(v)``, the sign s of the velocity smoothed over the speed e [rad/s or m/s].

    ``s = tanh(v / e)`` with the ``smoothing`` e, or, if there is a ``creep`` e, the ramp ``v / e`` cut off at 1: a
    contact that gives lets a joint creep. So does MuJoCo's ``frictionloss``, whose e is ``level (1 - d) / d A / B``
    with its impedance d, damping B of ``solref`` and inverse inertia A of the joint.

    Within e of standstill friction depends on the load and on the past; the smooth sign keeps the equation linear in c
    and lets such instants count little.
    """

    smoothing: float = 0.02
    creep: float = 0.0

    name = "coulomb_friction"
    label = "Coulomb friction"
    meaning = "effort level sign(v), its sign tanh(v/smoothing), smoothing 0.02 by default, or v/creep up to 1"
    parameters = (
        ParameterForm("level", EFFORT, above=0.0, urdf="dynamics/friction", mjcf="joint/frictionloss"),
        *SIGN_FORMS,
    )
    said_first = 1
    usual_constants = tuple(form.name for form in SIGN_FORMS)
    settled_by = "slow motion of this joint, back and forth at several constant speeds"
    is_dry_friction = True

    @classmethod
    def variants(cls) -> tuple[Effect, ...]:
        """One for each of :data:`SMOOTHINGS`."""
        return tuple(cls(smoothing) for smoothing in SMOOTHINGS)

    def near(self, ratio: float) -> tuple[Effect, ...]:
        """Itself and others of either kind, a ``ratio`` from one to the next."""
        tanh, ramp = (self.creep / _RAMP, self.creep) if self.creep else (self.smoothing, _RAMP * self.smoothing)
        powers = ratio ** np.arange(-2.0, 3.0)
        others = (*(type(self)(float(tanh * p)) for p in powers), *(type(self)(creep=float(ramp * p)) for p in powers))
        return self, *(other for other in others if other != self)

    @classmethod
    def trials(cls) -> tuple[Effect, ...]:
        """The same, and one for each of :data:`CREEPS`: the shape of dry friction is not known before."""
        return (*cls.variants(), *(cls(creep=creep) for creep in CREEPS))

    def column(self, motion: JointMotion) -> FloatArray:
        if self.creep:
            return np.asarray(np.clip(motion.velocity / self.creep, -1.0, 1.0))
        return np.tanh(motion.velocity / self.smoothing)

    @classmethod
    def dry_friction(cls, coefficient: float, load: FloatArray) -> FloatArray:
        """Its level."""
        return np.full(load.shape, abs(coefficient))
