"""Efforts in another unit: of all joints, or of one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from geomid_ros.checks import words
from geomid_ros.checks.evidence import Evidence
from geomid_ros.checks.hypotheses import Hypothesis
from geomid_ros.checks.readings import Reading, World
from geomid_ros.checks.subject import Subject
from geomid_ros.types import FloatArray

REASON = 4.0
"""No URDF is wrong by more in its masses: a gain beyond it is a unit."""
_TOLD = 0.8  # squared correlation with what the URDF predicts, of a joint whose gain can be told
_ALIKE, _SHARE = 3.0, 0.6  # gains of one unit: so many within a factor of this
_UNITS = 10  # that efforts may well have
_MOST, _LEAST = 2.0, 0.03  # efforts as shares of the URDF's limits: those of right ones are between
_ABSURD = 30.0


def unit_hypotheses(subject: Subject, world: World, nominal: Evidence) -> Iterator[Hypothesis]:
    """Another unit of all joints together, and of each by itself."""
    count = len(subject.joints)
    slopes, told = world.slopes()
    factor, settled = _common_factor(subject, world, slopes, told, nominal)
    if not 1.0 / REASON <= factor <= REASON:
        cause = words.other_unit(subject.names, subject.gains * factor, factor, True)
        found = world.judge(Reading(np.arange(count), np.full(count, factor)))
        yield subject.hypothesis(cause, found, _UNITS, settled=settled)
    common = factor if settled else np.nan
    by_size = np.std(world.predicted, axis=0) / world.spread
    factors = np.where((told > 0.5) & (slopes > 0.0), 1.0 / np.maximum(slopes, 1e-30), by_size)
    for joint in range(count) if count > 1 else ():
        factor = float(factors[joint])
        if factor > 0.0 and not 1.0 / REASON <= factor <= REASON:
            gains = np.ones(count)
            gains[joint] = factor
            cause = words.other_unit([subject.names[joint]], [subject.gains[joint] * factor], factor, False)
            own = not 1.0 / REASON <= factor / common <= REASON
            absurd = bool(subject.loads[joint] > _ABSURD)
            found = world.judge(Reading(np.arange(count), gains))
            yield subject.hypothesis(cause, found, _UNITS * count, concerned=[joint], allowed=own, settled=absurd)


def _common_factor(
    subject: Subject, world: World, slopes: FloatArray, told: FloatArray, nominal: Evidence
) -> tuple[float, bool]:
    """The factor that makes all efforts those of the URDF, and whether it is sure without any evidence: where the
    links that were fitted are all as much too light or too heavy, or limits are exceeded."""
    fitted, follows = world.fitted_slopes(nominal)
    for ratios, sure in ((slopes, (told > _TOLD) & (slopes > 0.0)), (fitted, follows)):
        if np.count_nonzero(sure) >= 2:
            factor = 1.0 / float(np.median(ratios[sure]))
            return factor, bool(np.mean(np.abs(np.log(ratios[sure] * factor)) < np.log(_ALIKE)) >= _SHARE)
    predicted = np.maximum(np.std(world.predicted, axis=0), 1e-9)
    beyond = bool(np.median(subject.loads) > _MOST or np.max(subject.loads) < _LEAST)
    return float(np.median(predicted / world.spread)), beyond
