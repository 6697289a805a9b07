"""Robot from a URDF: bodies to identify, joints to read, and rigid-body dynamics by pinocchio."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import takewhile

import numpy as np
import pinocchio as pin

from geomid_ros.errors import InputError, check_name, refusing, unknown_name
from geomid_ros.geometry import pseudo_inertia, spd
from geomid_ros.model import urdf_tree
from geomid_ros.model.samples import Samples
from geomid_ros.types import AnyArray, BoolArray, FloatArray, frozen

GRAVITY = np.array([0.0, 0.0, -9.81])
STANDARD_GRAVITY = float(np.linalg.norm(GRAVITY))
"""[m/s^2]"""
_DYNAMICS = {"damping": 2, "friction": 1}
"""Attributes, and the power of a mimic joint's factor in the effort of its master."""
_PARALLEL = 0.99  # scalar product of two axes
_MEETING = 2e-3  # [m] between axes that meet
_ROOT_JOINT = "floating base of geomid_ros"  # must not be the name of a joint of the URDF


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body to identify: a moving link and the links fixed to it.

    Attributes:
        name: URDF link in whose frame the parameters are expressed.
        merged: Links with a mass that are fixed to it; their inertias are included.
        locked: Those of them that move relative to it in the URDF, where a locked joint is not fixed.
        joint: Pinocchio's index of the joint that moves it; 0 if a mounted sensor fixes it to the world.
        parameters: ``(10,)`` in pinocchio's order.
        to_joint: Transform ``(10, 10)`` of parameters from the link's frame to the joint's frame.
    """

    name: str
    merged: tuple[str, ...]
    locked: tuple[str, ...]
    joint: int
    parameters: FloatArray
    to_joint: FloatArray


@dataclass(frozen=True)
class Joint:
    """A moving joint: ``q`` and ``v`` index pinocchio's configuration and velocity; ``unit`` is its effort's unit."""

    name: str
    q: int
    v: int
    continuous: bool
    unit: str


@dataclass(frozen=True)
class MimicJoint:
    """A mimic ``joint``: its position is ``factor`` times that of its master plus ``offset``. ``master`` is an index
    into :attr:`Robot.joints`."""

    joint: Joint
    master: int
    factor: float
    offset: float


class Robot:
    """Bodies, joints and rigid-body quantities of one robot.

    A mimic joint is not among the joints. The effort that moves it is part of its master's effort (principle of
    virtual work).
    """

    def __init__(
        self,
        urdf: str,
        *,
        floating_base: bool = False,
        cuts: Sequence[str] = (),
        locked_joints: Sequence[str] = (),
        gravity: FloatArray = GRAVITY,
        source: str = "robot description",
    ) -> None:
        """Build from URDF text.

        Args:
            urdf: URDF text.
            floating_base: True if the root link moves freely.
            cuts: Links at which a group of fixed links is divided (where a wrench sensor is mounted). The part distal
                to a cut is a separate body.
            locked_joints: Joints to treat as fixed at zero.
            gravity: ``(3,)`` in the base (world) frame [m/s^2].
            source: Name of the URDF in error messages.

        Raises:
            InputError: The URDF cannot be used; the message names ``source`` and the link or joint.
        """
        self.source = source
        self.urdf = urdf
        self.floating_base = floating_base
        self.gravity = frozen(gravity)
        self.tree = urdf_tree.parse(urdf, source)
        self._first_joint = 2 if floating_base else 1
        masters = urdf_tree.masters(self.tree, source)
        fixed = {*locked_joints, *(joint.name for joint in self.tree.joints if joint.type == "fixed")}
        self.locked_joints = {*locked_joints, *(name for name, (master, _, _) in masters.items() if master in fixed)}
        """Joints to lock, including mimic joints whose master does not move."""
        self._model = self._without_locked(_build(urdf_tree.without_shapes(urdf, source), floating_base, source))
        self._model.gravity.linear = self.gravity
        self._data = self._model.createData()
        self.name = str(self._model.name)
        """Robot name in the URDF."""
        moving = self._moving_joints()
        self.joints = tuple(joint for joint in moving if joint.name not in masters)
        self.joint_names = tuple(joint.name for joint in self.joints)
        """Names of the moving joints, in the order of all joint arrays."""
        self.mimic_joints = tuple(
            MimicJoint(joint, self.joint_names.index(master), factor, offset)
            for joint in moving
            if joint.name in masters
            for master, factor, offset in [masters[joint.name]]
        )
        self.inertia_repairs: dict[str, str] = {}
        """Description of each repair to an inconsistent URDF inertia, by link."""
        self.bodies = self._bodies(set(cuts))
        self.body_names = tuple(body.name for body in self.bodies)
        """Names of the bodies, in the order of the parameters."""
        if not self.bodies:
            raise InputError(
                f"{source}: no moving link has a mass; there is nothing to identify. 'geomid prior URDF --mass KG' "
                "computes inertials from the shapes and the robot's mass"
            )
        self._velocity_rows = [joint.v for joint in self.joints]
        self._neutral = pin.neutral(self._model)
        self._straight, self._turning = (
            np.array([(joint.q, joint.v) for joint in moving if joint.continuous == turns], dtype=np.int64)
            .reshape(-1, 2)
            .T
            for turns in (False, True)
        )
        self._offsets = np.zeros(self._model.nv)
        self._offsets[[f.joint.v for f in self.mimic_joints]] = [f.offset for f in self.mimic_joints]
        self._moved_by = np.array([body.joint - 1 for body in self.bodies])
        self._to_joints = np.array([body.to_joint for body in self.bodies])

    @cached_property
    def described_dynamics(self) -> dict[tuple[str, str], float]:
        """Values of the URDF's ``<dynamics>`` elements, by joint and attribute (``dynamics/damping``). Those of mimic
        joints are part of their masters', as their efforts are.

        Raises InputError if a value is not a number.
        """
        values = {
            (joint.get("name", ""), f"dynamics/{key}"): urdf_tree.read_numbers(
                joint, "dynamics", (key,), [0.0], f"{self.source}: joint '{joint.get('name')}'"
            )[0]
            for joint in urdf_tree.read_xml(self.urdf, self.source).findall("joint")
            for key in _DYNAMICS
        }
        for follower in self.mimic_joints:
            for key, power in _DYNAMICS.items():
                share = values.pop((follower.joint.name, f"dynamics/{key}")) * abs(follower.factor) ** power
                values[self.joint_names[follower.master], f"dynamics/{key}"] += share
        return values

    def _without_locked(self, model: pin.Model) -> pin.Model:
        indices = {model.names[index]: index for index in range(self._first_joint, model.njoints)}
        for name in sorted(self.locked_joints):
            check_name("joint to lock", name, indices)
        if not self.locked_joints:
            return model
        return pin.buildReducedModel(model, [indices[name] for name in sorted(self.locked_joints)], pin.neutral(model))

    def _moving_joints(self) -> tuple[Joint, ...]:
        types = {joint.name: joint.type for joint in self.tree.joints}
        joints = []
        for index in range(self._first_joint, self._model.njoints):
            model, name = self._model.joints[index], self._model.names[index]
            if model.nv != 1:
                raise InputError(f"{self.source}: joint '{name}' is {types[name]}; only joints of one axis can be read")
            unit = "N" if types[name] == "prismatic" else "N m"
            joints.append(Joint(name, model.idx_q, model.idx_v, model.nq == 2, unit))
        return tuple(joints)

    def _bodies(self, cuts: set[str]) -> tuple[Body, ...]:
        for link in sorted(cuts.difference(self.tree.links)):
            raise unknown_name("link", link, self.tree.links)
        fixed = {joint.child for joint in self.tree.joints if self._is_fixed(joint)}
        if not self.floating_base:
            fixed.add(self.tree.root)
        heads = (link for link in self.tree.links if link not in fixed or link in cuts)
        self._groups = {head: self._rigid_group(head, cuts) for head in heads}
        bodies = [self._body(head, group) for head, group in self._groups.items()]
        return tuple(sorted((body for body in bodies if body is not None), key=lambda body: body.joint))

    @property
    def massless_links(self) -> tuple[str, ...]:
        """Moving links that are physical parts, not just frames, but have no mass, nor have the links fixed to them."""
        weightless = {h: group for h, group in self._groups.items() if self.tree.inertials.keys().isdisjoint(group)}
        return tuple(h for h, group in weightless.items() if self.tree.physical_links & {*group} or self._has_extent(h))

    def _has_extent(self, link: str) -> bool:
        """True if a moving link supports a joint away from its joint's origin, so it is a physical part."""
        model = self._model
        child_joints = model.children[self._frame(link).parentJoint]
        return any(np.any(model.jointPlacements[joint].translation) for joint in child_joints)

    def _frame(self, link: str) -> pin.Frame:
        """Return pinocchio's frame of a link."""
        return self._model.frames[self._model.getFrameId(link, pin.BODY)]

    def _is_fixed(self, joint: urdf_tree.UrdfJoint) -> bool:
        return joint.type == "fixed" or joint.name in self.locked_joints

    def _rigid_group(self, link: str, cuts: set[str]) -> list[str]:
        group = [link]
        for member in group:
            group += [j.child for j in self.tree.children(member) if self._is_fixed(j) and j.child not in cuts]
        return group

    def _body(self, head: str, group: list[str]) -> Body | None:
        frame = self._frame(head)
        massive = [link for link in group if link in self.tree.inertials]
        if not massive:
            return None
        parameters = np.zeros(10)
        for link in massive:
            parameters += _transform(frame.placement.actInv(self._frame(link).placement)) @ self.tree.inertials[link]
        parameters = self._checked_parameters(head, massive, parameters)
        above = {link: takewhile(lambda joint: joint.child != head, self.tree.joints_above(link)) for link in massive}
        return Body(
            head,
            tuple(link for link in massive if link != head),
            tuple(link for link, joints in above.items() if any(joint.type != "fixed" for joint in joints)),
            frame.parentJoint,
            frozen(parameters),
            frozen(_transform(frame.placement)),
        )

    def _checked_parameters(self, head: str, massive: list[str], parameters: FloatArray) -> FloatArray:
        """Return the parameters, repaired if their moments are inconsistent; refuse a mass that is not positive."""
        if pseudo_inertia.is_body(parameters):
            return parameters
        merged = "" if massive == [head] else f" (with {', '.join(massive)})"
        mass = parameters[0]
        if mass <= 0.0:
            raise InputError(
                f"{self.source}: link '{head}'{merged} has a mass of {mass:.3g} kg; it must be positive; correct the"
                " <inertial> in the URDF"
            )
        repaired = pseudo_inertia.nearest_body(parameters)
        change = np.max(np.abs(repaired - parameters)[4:])
        self.inertia_repairs[head] = (
            f"the URDF's inertia of link '{head}'{merged} is not physically consistent; its mass and centre of mass "
            f"are kept, its moments are raised by up to {change:.2g} kg m^2 (a radius of gyration of at "
            f"least {1e3 * pseudo_inertia.least_gyration(mass):.2g} mm)"
        )
        return repaired

    def as_links(self, inertias: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Parameters ``(10,)`` of links, in whose description no joint is locked, from ``inertias`` of bodies by name.

        Links that are :attr:`~Body.locked` to a body were not identified by themselves: they keep their inertials,
        which are subtracted from the body. If the rest is no possible body, all parts change as the body has: they are
        transported parallel along the geodesic from the URDF's body to it, so that they are possible and add up to it.
        """
        links = dict(inertias)
        for body in self.bodies:
            if body.name in inertias and body.locked:
                links |= self._divided(body, links.pop(body.name))
        return links

    def _divided(self, body: Body, whole: FloatArray) -> dict[str, FloatArray]:
        placed = {link: self.fixed_placement(link, body.name) for link in (body.name, *body.merged)}
        parts = {
            link: spd.congruence(place, pseudo_inertia.from_parameters(pseudo_inertia.nearest_body(inertial)))
            for link, place in placed.items()
            if (inertial := self.tree.inertials.get(link, np.zeros(10)))[0] > 0.0
        }
        total, locked = pseudo_inertia.from_parameters(whole), [link for link in body.locked if link in parts]
        rest = pseudo_inertia.to_parameters(total - sum(parts[link] for link in locked))
        if pseudo_inertia.is_body(rest):
            return {body.name: rest}
        factor = spd.transport_factor(np.sum([*parts.values()], axis=0), total)
        own = [part for link, part in parts.items() if link not in locked]
        moved = {body.name: np.sum(own, axis=0)} if own else {}
        moved |= {link: parts[link] for link in locked}
        return {
            link: pseudo_inertia.to_parameters(spd.congruence(np.linalg.inv(placed[link]) @ factor, part))
            for link, part in moved.items()
        }

    def included_links(self, bodies: Collection[str]) -> list[str]:
        """Links that are part of these ``bodies`` in a description, too: fixed to them, not locked."""
        chosen = (body for body in self.bodies if body.name in bodies)
        return [link for body in chosen for link in body.merged if link not in body.locked]

    @property
    def effort_limits(self) -> FloatArray:
        """Effort limits of the joints in the URDF ``(joints,)`` [N m, N]; infinite where there is none."""
        limits = np.asarray(self._model.effortLimit)[self._velocity_rows]
        return np.where(limits > 0.0, limits, np.inf)

    @property
    def speed_limits(self) -> FloatArray:
        """Speed limits of the joints in the URDF ``(joints,)`` [rad/s, m/s]; infinite where there is none."""
        limits = np.asarray(self._model.velocityLimit)[self._velocity_rows]
        return np.where(limits > 0.0, limits, np.inf)

    @property
    def position_limits(self) -> FloatArray:
        """Position limits (low, high) in the URDF ``(joints, 2)`` [rad, m]; infinite where there is none."""
        q = [joint.q for joint in self.joints]
        limits = np.column_stack([self._model.lowerPositionLimit[q], self._model.upperPositionLimit[q]])
        endless = np.array([joint.continuous for joint in self.joints]) | (limits[:, 0] >= limits[:, 1])
        return np.where(endless[:, None], (-np.inf, np.inf), limits)

    def is_divided_at(self, link: str) -> bool:
        """True if a body begins at ``link``: it moves relative to its parent, or it is one of the cuts."""
        return link in self._groups

    def subtree(self, frame: str) -> list[int]:
        """Return the indices of the bodies in the subtree of the link ``frame``, itself included."""
        links = set(self.tree.subtree(frame))
        return [index for index, body in enumerate(self.bodies) if body.name in links]

    def chain(self, joint: int) -> list[int]:
        """Return the indices of all other joints proximal or distal to ``joint`` on its chain."""
        model, indices = self._model, [self._model.getJointId(name) for name in self.joint_names]
        related = {*model.supports[indices[joint]], *model.subtrees[indices[joint]]}
        return [other for other, index in enumerate(indices) if index in related and other != joint]

    def configuration(self, samples: Samples) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return pinocchio's q ``(N, nq)``, v and a ``(N, nv)`` of samples."""
        q, v, a = self.moved(np.array([samples.position, samples.velocity, samples.acceleration]))
        if self.floating_base:
            q[:, :7], v[:, :6], a[:, :6] = samples.base_pose, samples.base_velocity, samples.base_acceleration
        return q, v, a

    def moved(self, motion: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return pinocchio's q ``(N, nq)``, v and a ``(N, nv)`` from joint positions, velocities and accelerations
        ``(3, N, joints)``. A floating base is at rest at the world's origin."""
        positions, v, a = motion @ self.coupling.T
        positions += self._offsets
        q = np.empty((motion.shape[1], self._model.nq))
        q[:] = self._neutral
        straight, turning = self._straight, self._turning
        q[:, straight[0]] = positions[:, straight[1]]
        if turning.size:
            angles = positions[:, turning[1]]
            q[:, turning[0]], q[:, turning[0] + 1] = np.cos(angles), np.sin(angles)
        return q, v, a

    @property
    def pinocchio_model(self) -> pin.Model:
        """Copy of pinocchio's model."""
        return self._model.copy()

    def pinocchio_positions(self, position: FloatArray) -> FloatArray:
        """Return pinocchio's q ``(N, nq)`` at positions ``(N, joints)``, mimic joints included."""
        zeros = np.zeros_like(position)
        return self.moved(np.array([position, zeros, zeros]))[0]

    def joint_effort_rows(self, q: FloatArray, v: FloatArray, a: FloatArray, *, base: bool = False) -> FloatArray:
        """Compute regressors of the joint efforts for N samples, ``(N, joints, bodies, 10)``, in the link frames.

        With ``base``, six rows follow, ``(N, joints + 6, bodies, 10)``: the regressor of the wrench on a floating base,
        in the axes and about the origin of the root link.
        """
        pairs = self.rows_of_pairs(q, v, a, base=base)
        regressors = np.zeros((len(q), len(self.joints) + (6 if base else 0), len(self.bodies), 10))
        rows, bodies = (of_pairs[: len(pairs)] for of_pairs in self._row_body_pairs[:2])
        regressors[:, rows, bodies] = pairs.transpose(1, 0, 2)
        return regressors

    def rows_of_pairs(self, q: FloatArray, v: FloatArray, a: FloatArray, *, base: bool = False) -> FloatArray:
        """Compute the parts ``(pairs, N, 10)`` of :meth:`joint_effort_rows` that are not zero: for each pair of a joint
        and a body that it moves, in the order of ``np.nonzero(supports)``; then those of the base's rows."""
        # Only pinocchio's call is per sample; looping over the remaining steps would take twice as long.
        full = np.empty((len(q), self._model.nv, 10 * (self._model.njoints - 1)))
        for rows, *state in zip(full, q, v, a, strict=True):
            # For a robot with one joint, pinocchio drops a dimension.
            rows[:] = pin.computeJointTorqueRegressor(self._model, self._data, *state).reshape(rows.shape)
        rows = np.concatenate([self._joint_rows(full), full[:, :6]], axis=1) if base else self._joint_rows(full)
        selected = slice(None if base else np.count_nonzero(self.supports))
        at, _, moved_by, to_joints = (of_pairs[selected] for of_pairs in self._row_body_pairs)
        pairs = rows.reshape(len(q), rows.shape[1], -1, 10)[:, at, moved_by].transpose(1, 0, 2)
        return np.asarray(pairs @ to_joints)

    @cached_property
    def _row_body_pairs(self) -> tuple[AnyArray, ...]:
        """All pairs of a row and a body that affects it, joint rows before base rows: arrays of the row, the body,
        the index of the joint that moves the body, minus 1, and the transform to that joint's frame."""
        rows, bodies = np.nonzero(np.concatenate([self.supports, np.tile(self._moved_by >= 0, (6, 1))]))
        return rows, bodies, self._moved_by[bodies], self._to_joints[bodies]

    @cached_property
    def supports(self) -> BoolArray:
        """True where a joint, or one of its mimic joints, moves a body ``(joints, bodies)``."""
        carries = np.zeros((len(self.joints), len(self.bodies)), dtype=np.bool_)
        moving = dict(zip(self.joint_names, range(len(self.joints)), strict=True))
        for name, row in (moving | {follower.joint.name: follower.master for follower in self.mimic_joints}).items():
            joint = self._model.getJointId(name)
            carries[row] |= [joint in self._model.supports[body.joint] for body in self.bodies]
        return carries

    def body_effort_rows(self, q: FloatArray, v: FloatArray, a: FloatArray, body: int) -> FloatArray:
        """Compute the regressor ``(joints, 10)`` of the joint efforts for one moving ``body``, at one instant."""
        model, data, moving_body = self._model, self._data, self.bodies[body]
        pin.forwardKinematics(model, data, q, v, a)
        pin.computeJointJacobians(model, data)
        jacobian = pin.getJointJacobian(model, data, moving_body.joint, pin.LOCAL)
        against_gravity = data.a[moving_body.joint] - data.oMi[moving_body.joint].actInv(model.gravity)
        regressor = pin.bodyRegressor(data.v[moving_body.joint], against_gravity)
        return np.asarray(self.coupling.T @ jacobian.reshape(6, model.nv).T @ regressor @ moving_body.to_joint)

    def joint_efforts(
        self, q: FloatArray, v: FloatArray, a: FloatArray, inertias: FloatArray | None = None
    ) -> FloatArray:
        """Compute joint efforts ``(N, joints)`` by the recursive Newton-Euler algorithm, with ``inertias (all bodies,
        10)``, or the URDF's if None."""
        if inertias is None:
            return self.efforts_of(self._model, self._data, q, v, a)
        model = self.with_inertias(inertias, range(len(inertias)))
        return self.efforts_of(model, model.createData(), q, v, a)

    def efforts_of(self, model: pin.Model, data: pin.Data, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Compute joint efforts ``(N, joints)`` with the inertias of a ``model`` from :meth:`with_inertias`."""
        efforts = [pin.rnea(model, data, *state) for state in zip(q, v, a, strict=True)]
        return np.array(efforts).reshape(len(q), model.nv) @ self.coupling

    def efforts_by_gravity(self, model: pin.Model, data: pin.Data, q: FloatArray, directions: FloatArray) -> FloatArray:
        """Compute the change of joint efforts ``(N, joints, k)`` per unit of gravity in ``directions (3, k)`` of the
        base frame, with the inertias of a ``model`` from :meth:`with_inertias`; its own gravity is lost."""
        static = np.empty((directions.shape[1], len(q), model.nv))
        for efforts, direction in zip(static, directions.T, strict=True):
            model.gravity.linear = direction
            for row, configuration in zip(efforts, q, strict=True):
                row[:] = pin.computeGeneralizedGravity(model, data, configuration)
        return np.asarray(self.coupling.T @ static.transpose(1, 2, 0))

    @cached_property
    def coupling(self) -> FloatArray:
        """Derivative ``(nv, joints)`` of pinocchio's velocities by the joint velocities; mimic joints add entries."""
        return frozen(self._joint_rows(np.eye(self._model.nv)).T)

    def _joint_rows(self, rows: FloatArray) -> FloatArray:
        """Reduce rows ``(..., nv, k)`` of all velocities to rows ``(..., joints, k)``, mimic joints folded in."""
        if self._velocity_rows == [*range(rows.shape[-2])]:
            return rows
        joint_rows = rows[..., self._velocity_rows, :]
        for follower in self.mimic_joints:
            joint_rows[..., follower.master, :] += follower.factor * rows[..., follower.joint.v, :]
        return joint_rows

    def update_motion(self, q: FloatArray, v: FloatArray, a: FloatArray) -> None:
        """Compute the kinematics that :meth:`placement` and :meth:`wrench_rows` read, at one instant."""
        pin.forwardKinematics(self._model, self._data, q, v, a)

    def wrench_rows(self, bodies: Iterable[int], frame: str) -> FloatArray:
        """Compute the regressor ``(6, bodies, 10)`` of the wrench that moves ``bodies`` against gravity, (25) and (26).

        Force and torque are in the axes and about the origin of ``frame``. Call :meth:`update_motion` first. Entries of
        bodies that are not listed are zero.
        """
        rows = np.zeros((6, len(self.bodies), 10))
        to_frame = self.placement(frame).inverse()
        for index in bodies:
            body = self.bodies[index]
            in_world = self._data.oMi[body.joint]
            acceleration = self._data.a[body.joint] - in_world.actInv(self._model.gravity)
            regressor = pin.bodyRegressor(self._data.v[body.joint], acceleration)
            rows[:, index] = (to_frame * in_world).toDualActionMatrix() @ regressor @ body.to_joint
        return rows

    def placement(self, frame: str) -> pin.SE3:
        """Return the placement of a link's frame in the world, after :meth:`update_motion`; identity for the world."""
        if frame not in self.tree.links:
            return pin.SE3.Identity()
        link_frame = self._frame(frame)
        return self._data.oMi[link_frame.parentJoint] * link_frame.placement

    def body_of(self, link: str) -> str | None:
        """Return the body that a link, with or without mass, is part of or fixed to; None if there is none."""
        bodies = {member: name for name in self.body_names for member in self._groups[name]}
        proximal = (joint.parent for joint in takewhile(self._is_fixed, self.tree.joints_above(link)))
        return next((bodies[member] for member in (link, *proximal) if member in bodies), None)

    def carrier(self, frame: str) -> str:
        """Return the body that a link is fixed to. Raises InputError if the link does not exist or does not move."""
        check_name("link", frame, self.tree.links)
        body = self.body_of(frame)
        if body is None:
            raise InputError(f"{self.source}: link '{frame}' is not part of a moving body with mass")
        return body

    def fixed_placement(self, link: str, frame: str) -> FloatArray:
        """Return the homogeneous transform ``(4, 4)`` from a link's coordinates to ``frame``, which is fixed to it."""
        return np.asarray(self._frame(frame).placement.actInv(self._frame(link).placement).homogeneous)

    def link_frames(self, pose: Samples) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Return rotation ``(3, 3)`` and origin ``(3,)`` of every link's frame in the world, at the sample ``pose``."""
        (q,), (v,), (a,) = self.configuration(pose)
        self.update_motion(q, v, a)
        placements = {link: self.placement(link) for link in self.tree.links}
        return {link: (np.array(m.rotation), np.array(m.translation)) for link, m in placements.items()}

    def parallel_joints(self, joint: int) -> list[int]:
        """Return the proximal joints whose axes are parallel to that of ``joint`` when all joints are at zero."""
        child = next(j.child for j in self.tree.joints if j.name == self.joint_names[joint])
        axes = self.frame_jacobian(pin.neutral(self._model), child)[3:]
        parallel = np.abs(axes[:, joint] @ axes) > _PARALLEL
        return [other for other in np.flatnonzero(parallel).tolist() if other != joint]

    def axes_meet(self, first: int, second: int) -> bool:
        """True if the axes of two joints intersect when all joints are at zero."""
        pin.computeJointJacobians(self._model, self._data, pin.neutral(self._model))
        (v, w), (other_v, other_w) = (np.split(self._data.J[:, self.joints[j].v], 2) for j in (first, second))
        sine = np.linalg.norm(np.cross(w, other_w))
        crossing = abs(w @ other_w) < _PARALLEL
        return bool(crossing and abs(w @ other_v + other_w @ v) < _MEETING * sine)

    def parent_body(self, link: str) -> str | None:
        """Return the nearest body proximal to ``link``; the root link if there is none, None for the root itself."""
        above = [joint.parent for joint in self.tree.joints_above(link)]
        return next((parent for parent in above if parent in self.body_names), above[-1] if above else None)

    def frame_jacobian(self, q: FloatArray, frame: str) -> FloatArray:
        """Compute the Jacobian ``(6, joints)`` of a link's frame, in that frame's axes (linear, angular)."""
        index = self._model.getFrameId(frame, pin.BODY)
        jacobian = pin.computeFrameJacobian(self._model, self._data, q, index, pin.LOCAL)
        return self._joint_rows(jacobian.reshape(6, self._model.nv).T).T

    def contact_jacobians(self, q: FloatArray, frame: str, radius: float) -> FloatArray:
        """Compute Jacobians ``(N, 6, 6 + joints)`` of the lowest point of a ball around a link's origin: linear and
        angular in the world's axes, by the velocity of a floating base in the base frame, then by the joints'."""
        index = self._model.getFrameId(frame, pin.BODY)
        full = np.empty((len(q), 6, self._model.nv))
        for jacobian, state in zip(full, q, strict=True):
            jacobian[:] = pin.computeFrameJacobian(self._model, self._data, state, index, pin.LOCAL_WORLD_ALIGNED)
        down = radius * self.gravity / np.linalg.norm(self.gravity)
        full[:, :3] -= pin.skew(down) @ full[:, 3:]
        return np.concatenate([full[:, :, :6], self._joint_rows(full.transpose(0, 2, 1)).transpose(0, 2, 1)], axis=2)

    @property
    def weight(self) -> float:
        """Weight of all bodies according to the URDF [N]; links that are fixed to the world are not bodies."""
        return float(sum(body.parameters[0] for body in self.bodies) * np.linalg.norm(self.gravity))

    def base_placement(self, frame: str) -> FloatArray:
        """Return the homogeneous transform ``(4, 4)`` from a link's coordinates to the root's, to which it is fixed.

        Raises InputError if the link does not exist or moves relative to the root.
        """
        check_name("link", frame, self.tree.links)
        if not all(map(self._is_fixed, self.tree.joints_above(frame))):
            raise InputError(f"{self.source}: link '{frame}' moves relative to the base; choose a link fixed to it")
        return self.fixed_placement(frame, self.tree.root)

    def with_gravity(self, gravity: FloatArray) -> Robot:
        """Return a copy of the robot under another ``gravity (3,)`` in the base (world) frame [m/s^2]."""
        robot: Robot = copy(self)
        robot.gravity = frozen(gravity)
        robot._model = self._model.copy()
        robot._model.gravity.linear = robot.gravity
        robot._data = robot._model.createData()
        return robot

    def with_inertias(self, inertias: FloatArray, bodies: Iterable[int]) -> pin.Model:
        """Return a copy of pinocchio's model with ``inertias (all bodies, 10)`` of the listed bodies only."""
        model = self._model.copy()
        joints = np.zeros((model.njoints, 10))
        for index in bodies:
            joints[self.bodies[index].joint] += self.bodies[index].to_joint @ inertias[index]
        for index in range(model.njoints):
            massive = joints[index, 0] > 0.0
            model.inertias[index] = pin.Inertia.FromDynamicParameters(joints[index]) if massive else pin.Inertia.Zero()
        return model


def _build(urdf: str, floating_base: bool, source: str) -> pin.Model:
    with refusing(f"{source}: pinocchio cannot build a robot from this URDF", ValueError, RuntimeError):
        if floating_base:
            return pin.buildModelFromXML(urdf, pin.JointModelFreeFlyer(), _ROOT_JOINT)
        return pin.buildModelFromXML(urdf)


def _transform(placement: pin.SE3) -> FloatArray:
    return pseudo_inertia.parameter_transform(placement.rotation, placement.translation)
