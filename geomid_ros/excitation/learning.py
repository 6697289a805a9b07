"""What a motion is expected to teach, by the criterion of its aim: beside a random motion of the same form, and beside
recording longer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.excitation.knowledge import ROWS_PER_SECOND, Belief
from geomid_ros.excitation.motion import ExcitingMotion
from geomid_ros.model.effects import effect_class
from geomid_ros.types import FloatArray

PREDICTION, FRICTION, PAYLOAD, LINK = "prediction", "friction", "payload", "link:"
_FRICTION = "dynamics/"  # attributes of a URDF that say friction
_WORTH = 0.02  # a difference that is worth a word


def weight_of(aim: str, knowledge: Belief, others: Sequence[ExcitingMotion]) -> FloatArray:
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


@dataclass(frozen=True, eq=False)
class Expected:
    """What is known at some time: ``error``, the root of the criterion; standard deviations of the ``links``'
    quantities ``(links, 10)`` and of the ``effects``' coefficients ``(effects,)``."""

    error: float
    links: FloatArray
    effects: FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class Learning:
    """What is known ``before``, after the ``designed`` motion, after a ``random`` feasible one that lasts as long, and
    after the designed one ``twice``, or a random one twice as long, ``random_twice``."""

    before: Expected
    designed: Expected
    random: Expected
    twice: Expected
    random_twice: Expected

    @property
    def gain(self) -> float:
        """By what share the designed motion lowers the expected error."""
        return 1.0 - self.designed.error / self.before.error

    @property
    def sentences(self) -> list[str]:
        """The comparison in words."""
        said = [f"{self.before.error:.3g} before, {self.designed.error:.3g} after this motion"]
        gain = 1.0 - self.designed.error / self.random.error
        nothing = "the design saves nothing here; its benefit is that the motion is checked"
        saved = f"{gain:.0%} saved" if gain > _WORTH else nothing
        said.append(f"a random feasible motion of the same length leaves {self.random.error:.3g}: {saved}")
        longer = self.random_twice.error / self.designed.error
        better = "recording longer helps more than the design" if longer < 1.0 else "the design is worth more than that"
        said.append(f"a random motion twice as long leaves {self.random_twice.error:.3g}: {better}")
        said.append(f"this motion recorded twice leaves {self.twice.error:.3g}")
        return said


def expected_learning(
    knowledge: Belief, weight: FloatArray, motion: ExcitingMotion, randoms: Sequence[ExcitingMotion]
) -> Learning:
    """Compare a designed ``motion`` with feasible ``randoms`` of its form, of which the middle one counts, by the
    criterion of a ``weight (D, D)``."""

    def expected(belief: Belief) -> Expected:
        return Expected(belief.error(weight), *belief.deviations())

    def after(information: FloatArray) -> Expected:
        return expected(knowledge.after(information))

    own, others = knowledge.information(motion), [knowledge.information(other) for other in randoms]
    middle = sorted(others, key=lambda other: knowledge.after(other).error(weight))[len(others) // 2]
    return Learning(
        before=expected(knowledge),
        designed=after(own),
        random=after(middle),
        twice=after(2.0 * own),
        random_twice=after(2.0 * middle),
    )
