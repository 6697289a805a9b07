"""Transforms of recordings that may have happened throughout: a table of candidates for what is wrong.

Each row yields candidates that undo one kind of transform, of the efforts or of the motion. Of each row those are
judged whose mended efforts resemble most, at a few instants, what the URDF predicts: the number of fits does not grow
with that of joints.
"""

from __future__ import annotations

import numpy as np

from geomid_ros.checks.candidates import PROBABLE, Candidate, probabilities
from geomid_ros.checks.efforts import OF_EFFORTS
from geomid_ros.checks.evidence import LEAST_SIGMA
from geomid_ros.checks.instants import FEWEST
from geomid_ros.checks.motions import OF_MOTION, positions
from geomid_ros.checks.subject import Subject

_BEST = 3
_AS_IT_MOVES = (*OF_EFFORTS, positions)  # unless its angles cannot be any


def transforms(subject: Subject) -> tuple[list[Candidate], int]:
    """All candidates that are worth judging on a subject, and how many they are chosen from."""
    few = subject.part(slice(None, None, -(-len(subject.samples) // (2 * FEWEST))))
    # Of what is nearly explained no more could be told by reading the motion otherwise.
    more = float(np.sum(np.log(subject.nominal.sigmas / LEAST_SIGMA)))
    rows = (*_AS_IT_MOVES, *OF_MOTION) if probabilities([more], 1)[0] > PROBABLE else _AS_IT_MOVES
    chosen, count = list[Candidate](), 0
    for row in rows:
        ranked = sorted(row(subject, few), key=lambda candidate: -candidate.resemblance(few))
        chosen += [c for place, c in enumerate(ranked) if place < _BEST or c.settled or c.read is None]
        count += len(ranked)
    return chosen, count
