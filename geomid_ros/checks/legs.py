"""Whether the efforts of legs carry the robot."""

from __future__ import annotations

import numpy as np

from geomid_ros.checks.causes import Cause, Finding
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.model.contacts import DIRECTIONS, Contact, Legs
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples

_BORNE = 0.1  # share of the weight: an arm whose inertias are wrong seems to carry less
_USUAL = 0.5, 3.0  # shares of the URDF's weight: it may lack a payload


def unnamed_feet(robot: Robot, legs: Legs, samples: Samples) -> Finding | None:
    """That limbs which no contact names carry the robot, too, if so; ``samples`` are any of a recording."""
    bearing = {}
    for tip in _unnamed_tips(robot, legs):
        shares = Legs(robot, [Contact(tip)]).carried(samples)
        if np.any(known := np.isfinite(shares)):
            bearing[tip] = float(np.mean(shares[known]))
    named = [f"{100.0 * share:.0f} % at '{tip}'" for tip, share in bearing.items() if share > _BORNE]
    if not named:
        return None
    sentence = (
        f"limbs that no contact names seem to carry a part of the robot's weight: {', '.join(named)}. Name their feet "
        "(--contacts)"
    )
    return Finding(cause=Cause(kind="legs", sentence=sentence))


def _unnamed_tips(robot: Robot, legs: Legs) -> list[str]:
    """The ends of other limbs of three joints or more: of the links that carry none, the farthest from the last
    joint."""
    named, tips = {robot.joint_names[joint] for joints in legs.joints for joint in joints}, dict[str, str]()
    for link in robot.tree.links:
        moving = [joint.name for joint in robot.tree.joints_above(link) if joint.name in robot.joint_names]
        if robot.tree.children(link) or len(moving) < DIRECTIONS or named.intersection(moving):
            continue
        last = tips.get(moving[0], link)
        tips[moving[0]] = max(link, last, key=lambda tip: _reach(robot, tip))
    return list(tips.values())


def _reach(robot: Robot, link: str) -> float:
    """How far a link is from the joint that moves it [m]."""
    moved = next(joint.child for joint in robot.tree.joints_above(link) if joint.name in robot.joint_names)
    return float(np.linalg.norm(robot.fixed_placement(link, moved)[:3, 3]))


def never_lifted(model: MeasurementModel, estimate: Estimate) -> list[str]:
    """That legs stand all of the time, in a sentence, if so: their own efforts then tell nothing."""
    if model.legs is None:
        return []
    names = model.robot.joint_names
    still = [
        contact.frame
        for contact, joints in zip(model.legs.contacts, model.legs.joints, strict=True)
        if not np.any(np.isfinite([estimate.rms[estimate.channels.index(names[joint])] for joint in joints]))
    ]
    if not still:
        return []
    sentence = (
        f"{', '.join(still)} never left the ground: of these legs only what the base feels is identified. Lift each "
        "leg and move it in the air for two seconds or more"
    )
    return [sentence]


def carried_weight(legs: Legs, samples: Samples) -> Finding | None:
    """That by the efforts of the legs the feet do not carry the robot, if so; ``samples`` are any of a recording."""
    shares = legs.carried(samples)
    shares = shares[np.isfinite(shares)]
    share = float(np.mean(shares)) if len(shares) else 1.0
    if _USUAL[0] <= share <= _USUAL[1]:
        return None
    sentence = (
        f"by the efforts of their legs the feet carry {share:.2g} of the robot's weight on average, expected about 1: "
        "check that efforts are in N m with their sign (effort_gain, --gain), that all feet are named (contacts), and "
        "that the IMU's frame is not upside down"
    )
    return Finding(cause=Cause(kind="legs", sentence=sentence))
