"""What a URDF and an MJCF say by themselves: friction that neither can say, in those kinds that both can."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomid_ros.gap.candidates import EffectTerm, NamesFit
from geomid_ros.gap.evidence.linearised_problem import LinearisedProblem
from geomid_ros.model.effects import MotionEffect, ParameterForm, joints_of
from geomid_ros.model.effects.effect import LoadEffect


def folded(problem: LinearisedProblem, found: NamesFit) -> dict[tuple[str, str], float]:
    """By how much a joint's attributes, as ``dynamics/damping``, differ in a file that says nothing else of friction.

    Linear friction that was found beside a quadratic one is wrong without it. So the file has the least-squares fit of
    what it can say to all that was found, over the motion that was fitted; all else is as it was found.
    """
    terms = [term for term in found.terms if isinstance(term, EffectTerm) and _is_of_one_joint(term)]
    corrections: dict[tuple[str, str], float] = {}
    for joint, name in enumerate(problem.model.robot.joint_names):
        own = [term for term in terms if joints_of(term.place) == (joint,)]
        said, unsaid = [t for t in own if _form(t).urdf], [t for t in own if _is_unsaid(t)]
        if said and unsaid:
            changes = _changes(problem, found, joint, said, unsaid)
            corrections |= {(name, _form(term).urdf): change for term, change in zip(said, changes, strict=True)}
    return corrections


def _changes(
    problem: LinearisedProblem, found: NamesFit, joint: int, said: Sequence[EffectTerm], unsaid: Sequence[EffectTerm]
) -> list[float]:
    from scipy.optimize import nnls  # noqa: PLC0415 seldom needed

    columns = problem.columns((), [*said, *unsaid])
    values = np.array([found.value(term) for term in (*said, *unsaid)])
    stacked = np.stack([columns[term].get(joint, np.zeros(len(problem.records.samples))) for term in columns], axis=1)
    least, _ = nnls(stacked[:, : len(said)], stacked @ values)
    changes: list[float] = (least - values[: len(said)]).tolist()
    return changes


def _is_of_one_joint(term: EffectTerm) -> bool:
    return isinstance(term.effect, MotionEffect | LoadEffect) and len(joints_of(term.place)) == 1


def _form(term: EffectTerm) -> ParameterForm:
    return term.effect.own[term.index]


def _is_unsaid(term: EffectTerm) -> bool:
    """Whether neither file says it, and it is no error of the sensor."""
    form = _form(term)
    return not (form.urdf or form.mjcf or term.effect.effort_shift({form.name: 1.0}))
