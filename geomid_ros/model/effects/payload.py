from __future__ import annotations

from geomid_ros.geometry.pseudo_inertia import INERTIA_NAMES
from geomid_ros.model.effects.effect import Effect
from geomid_ros.model.effects.parameters import COM_ENTRIES, ParameterForm

_URDF, _MJCF = "link/inertial", "body/inertial"


class CarriedBody(Effect):
    """A body that a link carries; it is fitted as the bodies are, on its own pseudo-inertia."""

    name = "payload"
    label = "a payload"
    meaning = "a rigid body fixed to the link, in its frame; its inertia is about its centre of mass"
    parameters = (
        ParameterForm("mass", ("kg", "kg"), above=0.0, urdf=_URDF, mjcf=_MJCF),
        *(ParameterForm(name, ("m", "m"), urdf=_URDF, mjcf=_MJCF) for name in COM_ENTRIES),
        *(ParameterForm(name, ("kg m^2", "kg m^2"), optional=True, urdf=_URDF, mjcf=_MJCF) for name in INERTIA_NAMES),
    )
    said_first = 4
    settled_by = "the same motion with and without the payload, or a wrench sensor that carries the link"
    place = "link"
    like_a_payload = True
    adds_up = False

    @property
    def parts(self) -> tuple[Effect, ...]:
        """None: its body has no coefficients."""
        return ()
