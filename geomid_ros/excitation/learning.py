"""What a motion is expected to teach, beside other ways to spend the time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.excitation.knowledge import Belief
from geomid_ros.excitation.motion import Motion
from geomid_ros.types import FloatArray

_WORTH = 0.02  # a difference that is worth a word


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
        if gain > _WORTH:
            said.append(f"a random feasible motion of the same length leaves {self.random.error:.3g}: {gain:.0%} saved")
        else:
            said.append(
                f"a random feasible motion of the same length leaves {self.random.error:.3g}: the design saves nothing "
                "here; its benefit is that the motion is checked"
            )
        longer = self.random_twice.error / self.designed.error
        better = "recording longer helps more than the design" if longer < 1.0 else "the design is worth more than that"
        said.append(f"a random motion twice as long leaves {self.random_twice.error:.3g}: {better}")
        said.append(f"this motion recorded twice leaves {self.twice.error:.3g}")
        return said


def expected_learning(
    knowledge: Belief, weight: FloatArray, motion: Motion, randoms: Sequence[Motion], aim: Belief | None = None
) -> Learning:
    """Compare a motion with ``randoms`` of its form, of which the middle one counts.

    Args:
        knowledge: before.
        weight: of the criterion ``(D, D)``.
        motion: the designed one.
        randoms: feasible ones.
        aim: knowledge by which the criterion counts, if it is another.
    """
    judge = aim or knowledge
    own = knowledge.information(motion)
    others = [knowledge.information(other) for other in randoms]
    middle = others[int(np.argsort([_error(judge.after(o), weight) for o in others])[len(others) // 2])]

    def expected(information: FloatArray) -> Expected:
        return Expected(_error(judge.after(information), weight), *knowledge.after(information).deviations())

    return Learning(
        before=Expected(_error(judge, weight), *knowledge.deviations()),
        designed=expected(own),
        random=expected(middle),
        twice=expected(2.0 * own),
        random_twice=expected(2.0 * middle),
    )


def _error(knowledge: Belief, weight: FloatArray) -> float:
    return float(np.sqrt(np.sum(weight * knowledge.posterior.covariance)))
