"""Rows of efforts over the links' parameters, columns of friction, and what the URDF may be wrong by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geomid_ros.checks.evidence import SPREAD
from geomid_ros.geometry.manifold import ONE_BODY, ParameterManifold
from geomid_ros.inference.prior import SPREAD_OF_PAYLOADS, usual_payload
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import SIGN, Samples
from geomid_ros.types import FloatArray


def gravity_rows(robot: Robot, samples: Samples) -> tuple[FloatArray, FloatArray]:
    """The rows of efforts over all links' parameters: without gravity ``(N, joints, D)``, and per unit of gravity along
    each axis of the base ``(3, N, joints, D)``."""
    at_rest = replace(
        samples,
        velocity=np.zeros_like(samples.velocity),
        acceleration=np.zeros_like(samples.acceleration),
        base_velocity=np.zeros_like(samples.base_velocity),
        base_acceleration=np.zeros_like(samples.base_acceleration),
    )
    by_gravity = np.array([effort_rows(robot, at_rest, axis) for axis in np.eye(3)])
    return effort_rows(robot, samples, np.zeros(3)), by_gravity


def effort_rows(robot: Robot, samples: Samples, gravity: FloatArray) -> FloatArray:
    """The rows ``(N, joints, D)`` of efforts over all links' parameters."""
    if gravity is not robot.gravity:
        robot = robot.with_gravity(gravity)
    rows = robot.joint_effort_rows(*robot.configuration(samples))
    return rows.reshape(len(samples), len(robot.joints), -1)


def friction_columns(samples: Samples) -> FloatArray:
    """What may be added at each joint ``(N, joints, 4)``: a constant, and per positive unit viscous friction, dry
    friction and rotor inertia."""
    columns = [np.ones(samples.velocity.shape), samples.velocity, samples.column(SIGN), samples.acceleration]
    return np.stack(columns, axis=2)


def prior_factor(robot: Robot) -> FloatArray:
    """A factor ``(D, D)`` of the covariance of what the URDF may be wrong by: every link's shape and mass, and a
    payload at each end of a chain."""
    bodies = np.array([body.parameters for body in robot.bodies])
    manifold = ParameterManifold(len(bodies), 0, np.zeros(0))
    blocks, _ = manifold.jacobian(manifold.point(bodies.ravel()))
    factor = np.zeros((bodies.size, bodies.size))
    for index, body in enumerate(robot.bodies):
        covariance = (SPREAD * blocks[index]) @ (SPREAD * blocks[index]).T
        if len(robot.subtree(body.name)) == 1:
            payload = payload_factor(bodies, index)
            covariance += payload @ payload.T
        values, vectors = np.linalg.eigh(covariance)
        factor[10 * index : 10 * index + 10, 10 * index : 10 * index + 10] = vectors * np.sqrt(np.maximum(values, 0.0))
    return factor


def payload_factor(bodies: FloatArray, carrier: int) -> FloatArray:
    """A factor ``(10, 10)`` of the covariance of what the link ``carrier`` may carry: robots carry what their URDF does
    not say."""
    blocks, _ = ONE_BODY.jacobian(ONE_BODY.point(usual_payload(bodies, carrier)))
    return np.asarray(SPREAD_OF_PAYLOADS * blocks[0])
