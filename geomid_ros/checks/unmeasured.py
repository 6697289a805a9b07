"""Efforts that are not measured: the same number for long, or what a model says."""

from __future__ import annotations

import numpy as np

from geomid_ros.checks import words
from geomid_ros.checks.hypotheses import Cause
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

_SAME = 1e-9  # of an effort's range
_FEWEST = 5  # instants in a row
_ASKED = 1.0  # standard deviations: by so much an effort that is measured would have changed meanwhile
_STILL, _SELDOM = 0.01, 0.1  # of it, that nothing changes by; share of the others that a coarse sensor exceeds
_MODEL = 0.05  # of an effort's standard deviation: real friction alone is more


def frozen(names: list[str], samples: Samples, measured: FloatArray, rigid: FloatArray) -> list[Cause]:
    """The efforts that stay the same for a while in which gravity and motion ask for others.

    Args:
        names: of C joints.
        samples: N instants.
        measured: ``(N, C)`` the efforts.
        rigid: ``(N, C)`` what the links take.
    """
    found = []
    for channel, name in enumerate(names):
        effort, changes = measured[:, channel], np.abs(np.diff(rigid[:, channel]))
        same = np.abs(np.diff(effort)) <= _SAME * np.ptp(effort)
        begins = np.flatnonzero(np.diff(same.astype(np.int8), prepend=0) == 1)
        ends = np.flatnonzero(np.diff(same.astype(np.int8), append=0) == -1) + 1
        for begin, end in zip(begins, ends, strict=True):
            others = np.delete(same & (changes > _STILL * np.std(effort)), np.arange(begin, end))
            asked = float(np.ptp(rigid[begin : end + 1, channel]))
            enough = end - begin >= _FEWEST and np.mean(others) < _SELDOM
            if enough and asked > _ASKED * np.std(effort):
                times = [float(samples.stamps[place] - samples.stamps[0]) * 1e-9 for place in (begin, end)]
                found.append(words.frozen_effort(name, times[0], times[1], asked))
                break
    return found


def is_model(measured: FloatArray, predicted: FloatArray) -> bool:
    """Whether efforts are what the URDF predicts: without friction, without any error ``(N, C)``."""
    left = np.sqrt(np.mean((measured - predicted) ** 2, axis=0))
    return bool(np.all(left < _MODEL * np.std(measured, axis=0)))
