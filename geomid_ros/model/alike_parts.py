"""Alike parts: links of different limbs whose inertia and geometry in the URDF are equal up to a mirror."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import pinocchio as pin

from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.geometry.manifold import ONE_BODY
from geomid_ros.model.robot import Body, Robot
from geomid_ros.types import FloatArray, frozen

ALIKE_PRIOR_STD = 0.04
"""Default prior std (geodesic) of a part about the parts that are alike: a fifth of a link's about its CAD file. Links
of a URDF that are farther apart than this are not alike."""
_REVOLUTE = "JointModelR"  # prefix of the names of pinocchio's revolute joints, about any axis
_MIRRORS = np.array(list(product((1.0, -1.0), repeat=3)))


@dataclass(frozen=True, eq=False)
class AlikeParts:
    """``names`` of links that are alike, their indices ``members (n,)`` among the identified bodies, and the ``signs
    (n, 10)`` of their tangent coordinates under the mirror between the first link and each one; ``motors``: True if
    the URDF gives an effort limit for their joints, which is the same for all."""

    names: tuple[str, ...]
    members: tuple[int, ...]
    signs: FloatArray
    motors: bool


def alike_parts(robot: Robot, identified: Sequence[int]) -> tuple[AlikeParts, ...]:
    """Find groups of two or more alike links among the ``identified`` bodies of a robot."""
    model, bodies = robot.pinocchio_model, [robot.bodies[index] for index in identified]
    groups: list[list[tuple[int, FloatArray]]] = []
    for link, body in enumerate(bodies):
        for group in groups:
            mirror = _mirror(model, bodies[group[0][0]], body)
            if mirror is not None and not any(_is_one_limb(model, bodies[other], body) for other, _ in group):
                group.append((link, mirror))
                break
        else:
            groups.append([(link, _MIRRORS[0])])
    return tuple(_parts(model, bodies, group) for group in groups if len(group) > 1)


def _parts(model: pin.Model, bodies: Sequence[Body], group: Sequence[tuple[int, FloatArray]]) -> AlikeParts:
    members = tuple(link for link, _ in group)
    mirrors = np.array([np.append(mirror, 1.0) for _, mirror in group])
    _, effort, _ = _motor(model, bodies[members[0]].joint)
    return AlikeParts(
        names=tuple(bodies[link].name for link in members),
        members=members,
        signs=frozen(mirrors[:, spd.ROWS] * mirrors[:, spd.COLUMNS]),
        motors=effort > 0.0,
    )


def alike_sentences(groups: Sequence[AlikeParts]) -> Iterator[str]:
    """Yield a sentence that lists the alike links, if there are any."""
    named = [", ".join(group.names) + " (motors of one type)" * group.motors for group in groups]
    if named:
        listing = "; ".join(named)
        yield f"identical in the URDF; their errors are assumed to be correlated (disable: --alike none): {listing}"


def _is_one_limb(model: pin.Model, first: Body, second: Body) -> bool:
    """True if one of two bodies supports the other, or both move with the same joint."""
    return first.joint in model.supports[second.joint] or second.joint in model.supports[first.joint]


def _mirror(model: pin.Model, first: Body, second: Body) -> FloatArray | None:
    """Find the axis signs ``(3,)`` of the mirror that maps a body to another; None if they are not alike.

    If several do, as for a round body, choose the one that maps the one joint's origin nearest to the other's.
    """
    joints = [body.joint for body in (first, second)]
    if 0 in joints or len({_motor(model, joint) for joint in joints}) > 1:
        return None
    first_origin, second_origin = (model.jointPlacements[joint].translation for joint in joints)
    nearest = np.argsort(np.linalg.norm(_MIRRORS * first_origin - second_origin, axis=1), kind="stable")
    return next((mirror for mirror in _MIRRORS[nearest] if _are_alike(model, first, second, mirror)), None)


def _motor(model: pin.Model, joint: int) -> tuple[str, float, float]:
    """Return type (revolute or not, regardless of axis), effort limit and speed limit of a joint in the URDF."""
    own = model.joints[joint]
    return own.shortname()[: len(_REVOLUTE)], float(model.effortLimit[own.idx_v]), float(model.velocityLimit[own.idx_v])


def _are_alike(model: pin.Model, first: Body, second: Body, mirror: FloatArray) -> bool:
    """True if a mirror maps one body to another: its inertia, and the origins of its child joints."""
    signs = np.append(mirror, 1.0)
    matrices = pseudo_inertia.from_parameters(np.array([first.parameters, second.parameters]))
    matrices[0] *= np.outer(signs, signs)
    points = (ONE_BODY.point(pseudo_inertia.to_parameters(matrix)) for matrix in matrices)
    if ONE_BODY.distance(*points) > ALIKE_PRIOR_STD:
        return False
    origins = [
        [model.jointPlacements[child].translation for child in model.children[body.joint]] for body in (first, second)
    ]
    if len(origins[0]) != len(origins[1]):
        return False
    return all(
        np.linalg.norm(mirror * a - b) <= ALIKE_PRIOR_STD * np.linalg.norm(b) for a, b in zip(*origins, strict=True)
    )
