"""Joints that no message names, as of grippers: which of them may count as locked."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from geomid_ros.model.robot import Robot

_LIGHT = 0.1  # of the mass that moves: where so little stands does not matter


def lockable(robot: Robot, heard: Collection[str], frames: Iterable[str] = ()) -> tuple[str, ...]:
    """The robot's joints that no message names, if all of them may count as fixed at zero.

    They may if nothing that is measured depends on where they stand: they carry no joint that messages name and no
    wrench sensor, and of the mass that moves at most a tenth. A name that is none of the robot's may be that of a joint
    which seems to be missing: then nothing is locked.

    Args:
        robot: none of these joints is locked in it.
        heard: names of joints in messages.
        frames: of wrench sensors.
    """
    absent = [joint for joint in robot.joint_names if joint not in heard]
    strange = set(heard).difference(joint.name for joint in robot.tree.joints)
    if len(absent) == len(robot.joint_names) or strange:
        return ()
    follow = {f.joint.name: robot.joint_names[f.master] for f in robot.followers}
    child = {joint.name: joint.child for joint in robot.tree.joints}
    locked = [joint for joint in (*robot.joint_names, *follow) if follow.get(joint, joint) in absent]
    moved_by = [joint for joint in (*robot.joint_names, *follow) if joint not in locked]
    behind = {link for joint in locked for link in robot.tree.subtree(child[joint])}
    if behind & {*frames, *(child[joint] for joint in moved_by)}:
        return ()
    moving = {link for joint in moved_by for link in robot.tree.subtree(child[joint])}
    moving = set(robot.tree.links) if robot.floating_base else moving
    masses = {link: float(parameters[0]) for link, parameters in robot.tree.inertials.items() if link in moving}
    light = sum(masses[link] for link in behind & masses.keys()) <= _LIGHT * sum(masses.values())
    return tuple(absent) if light else ()
