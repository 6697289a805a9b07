"""What a motion is for: a weight on the errors of the parameters, whose expected square it makes small."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.excitation.knowledge import ROWS_PER_SECOND, Belief
from geomid_ros.excitation.motion import Motion
from geomid_ros.model.effects import effect_class
from geomid_ros.types import FloatArray

PREDICTION, FRICTION, PAYLOAD, LINK = "prediction", "friction", "payload", "link:"
_FRICTION = "dynamics/"  # attributes of a URDF that say friction


def weight_of(aim: str, knowledge: Belief, others: Sequence[Motion]) -> FloatArray:
    """The weight ``(D, D)`` W of an aim: the criterion is the trace of W times the covariance of the estimate.

    - ``prediction`` (I-optimal): mean squared error of the efforts, in units of the noise, on ``others``;
    - ``friction``: squared relative errors of the coefficients that a URDF's <dynamics> can say;
    - ``link:NAME``: squared error of a link's inertia, as a geodesic distance;
    - ``payload``: the same of the last link that moves.

    Raises InputError for another aim, or an unknown link.
    """
    size, manifold = knowledge.model.dimension, knowledge.posterior.manifold
    if aim == PREDICTION:
        rows = ROWS_PER_SECOND * len(knowledge.sigmas)
        found = [knowledge.information(motion) / (rows * motion.form.duration) for motion in others]
        return np.asarray(np.mean(found, axis=0))
    weight = np.zeros((size, size))
    if aim == FRICTION:
        places = [place for place, own in enumerate(_are_friction(knowledge), manifold.inertial.stop) if own]
        if not places:
            raise InputError("--for friction: none of the identified effects is friction; add one to 'effects'")
    elif aim == PAYLOAD or aim.startswith(LINK):
        links = knowledge.posterior.links
        name = links[-1] if aim == PAYLOAD else aim.removeprefix(LINK)
        if name not in links:
            raise unknown_name("link to identify", name, links)
        places = [*range(size)[manifold.link(links.index(name))]]
    else:
        raise unknown_name("aim", aim, (PREDICTION, FRICTION, PAYLOAD, f"{LINK}NAME"))
    weight[places, places] = 1.0
    return weight


def meaning_of(aim: str) -> str:
    """Of what the root of that criterion is the error."""
    if aim == PREDICTION:
        return "of efforts predicted for other motions, in units of the noise"
    if aim == FRICTION:
        return "of the friction coefficients, relative to them, all together"
    return f"of the inertia of {'the last link' if aim == PAYLOAD else aim.removeprefix(LINK)}, as a geodesic distance"


def _are_friction(knowledge: Belief) -> list[bool]:
    return [
        any(form.urdf.startswith(_FRICTION) for form in effect_class(effect.name).parameters)
        for effect in knowledge.posterior.effects
    ]
