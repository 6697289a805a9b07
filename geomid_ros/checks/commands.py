"""Whether efforts that are computed from commands are those of the motors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.estimation.estimate import EffectEstimate, is_told
from geomid_ros.model.controller import Controller
from geomid_ros.model.effects import effect_class
from geomid_ros.model.samples import Samples

_FOLLOWS = 0.1
"""Share of an effort (RMS) that its controller may leave."""


def wrong_gains(controller: Controller, samples: Samples, joints: Sequence[str]) -> Finding | None:
    """That the efforts which messages report are those of other gains, if they are those of any.

    Args:
        controller: with the gains that efforts were computed with.
        samples: with commands and reported efforts, any of a recording.
        joints: names.
    """
    found = {}
    for joint, name in enumerate(joints):
        wanted, speed, forward, reported = samples.commands[:, :, joint].T
        errors = np.column_stack([wanted - samples.position[:, joint], speed - samples.velocity[:, joint]])
        given = np.array([controller.kp[joint], controller.kd[joint]])
        effort = reported - forward
        known = np.isfinite(effort)
        if np.count_nonzero(known) <= errors.shape[1] or not np.any(effort[known]):
            continue
        errors, effort = errors[known], effort[known]
        fitted = np.linalg.lstsq(errors, effort, rcond=None)[0]
        left = [float(np.linalg.norm(effort - errors @ gains) / np.linalg.norm(effort)) for gains in (given, fitted)]
        if left[1] < _FOLLOWS < left[0]:
            found[name] = f"{fitted[0]:.3g}:{fitted[1]:.3g} at '{name}', given is {given[0]:g}:{given[1]:g}"
    if not found:
        return None
    sentence = (
        f"the reported efforts are those of other gains: {'; '.join(found.values())}. Correct command.gains (--gains)"
    )
    return Finding(cause=Cause(kind="gains", sentence=sentence, places=tuple(found)))


def encoder_zeros(controller: Controller, effects: Sequence[EffectEstimate], joints: Sequence[str]) -> list[str]:
    """The zeros of encoders by which set-points and measured positions seem to differ, in a sentence, where offsets of
    efforts are identified: the offset over kp."""
    stiffness = dict(zip(joints, controller.kp.tolist(), strict=True))
    told = [
        f"{1e3 * offset / stiffness[own.joint]:+.1f} mrad (mm) at '{own.joint}'"
        for own in effects
        if (offset := effect_class(own.name).effort_shift({own.parameter: own.value})) and is_told(offset, own.std)
    ]
    if not told:
        return []
    return [f"offsets of efforts are as large as those of encoders whose zeros are off by {', '.join(told)}"]
