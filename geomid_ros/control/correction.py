"""Feed-forward that adapts to a payload, in addition to a position controller, and the latch that switches it off.

Lee, Kwon and Park (2018), "A natural adaptive control law for robot manipulators", move the pseudo-inertia P down the
gradient ``Y^T s`` of the tracking error in the metric ``tr(P^-1 X P^-1 Y)``, which keeps it physically consistent. Here

- the feedback ``K s`` is read from measured efforts, so that neither gains nor the clock of the controller are needed.
  The present correction is subtracted, as in a Smith predictor: ``r = effort - Y p`` is left, whatever the delay;
- a step is the shortest that explains a fraction of r at all joints at once, within their noise: with rows A and r in
  units of the noise, and A whitened at P, it is ``fraction A^T (A A^T + 1)^-1 r``. The loop's gain per step is this
  fraction in every direction that efforts show, and less in others;
- it follows the geodesic ``P^1/2 exp(X) P^1/2``, which stays in the cone however long it is. So do the positive
  coefficients of friction, if they adapt, too: theirs is ``c exp(x)``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomid_ros.control.feedforward import MotorEfforts
from geomid_ros.errors import InputError
from geomid_ros.estimation.starting_point import DEFAULT_PRIOR_STD
from geomid_ros.estimation.tolerances import LARGEST_STEP
from geomid_ros.excitation.motion import Trajectory
from geomid_ros.geometry import spd
from geomid_ros.geometry.manifold import ONE_BODY, ParameterManifold, Point
from geomid_ros.geometry.pseudo_inertia import to_parameters
from geomid_ros.model.samples import REST_SPEED
from geomid_ros.types import FloatArray

MARGIN = 0.5
"""Gain times delay: an integrator with a delay has 61 degrees of phase margin left, and is unstable at pi / 2."""
SHORTEST = 0.01
"""Shortest delay that the gain is set for [s]: a faster loop follows unmodelled friction."""
LARGEST_COM_DISTANCE = 0.3
"""Physical limit: largest distance of a payload's centre of mass from the origin of its link [m]."""


def removed_fraction(step: float, delay: float) -> float:
    """Fraction of the residual that a step of so many seconds removes, at the gain ``MARGIN / delay`` [1/s]."""
    return -math.expm1(-MARGIN * step / max(delay, SHORTEST))


def shortest_change(manifold: ParameterManifold, point: Point, rows: FloatArray, residuals: FloatArray) -> FloatArray:
    """Shortest tangent vector ``(D,)`` that explains ``residuals (joints,)`` by ``rows (joints, D)``, both in units of
    the residuals' noise."""
    whitened = manifold.whiten(point, rows)
    weights = spd.solve_or_least_squares(whitened @ whitened.T + np.eye(len(rows)), residuals)
    return np.asarray(weights @ whitened)


def divergence(point: Point, reference: Point) -> float:
    """Bregman divergence ``tr(P_0^-1 P) - log det(P_0^-1 P) - 4`` of the log-determinant, from the ``reference``."""
    links = np.linalg.eigvalsh(spd.congruence(reference.inverse_root, point.pseudo_inertias))
    values = np.append(links, point.positives / reference.positives)
    return float(np.sum(values - np.log(values) - 1.0))


class Adaptation:
    """Inertia of a body, and ``K`` positive coefficients, bounded to changes that a payload may cause."""

    def __init__(self, identified: FloatArray, heaviest: float) -> None:
        """
        Args:
            identified: inertia of the body in the model, and the coefficients ``(10 + K,)``.
            heaviest: largest payload [kg].
        """
        self._manifold = ParameterManifold(1, len(identified) - spd.SIZE, np.zeros(0))
        self._scales = np.append(np.ones(spd.SIZE), np.full(self._manifold.positives, DEFAULT_PRIOR_STD))
        self._identified = self._manifold.point(identified)
        corners = LARGEST_COM_DISTANCE * np.concatenate([np.eye(3), -np.eye(3)])
        ends = np.append(corners, np.ones((6, 1)), axis=1)
        loads = to_parameters(heaviest * ends[:, :, None] * ends[:, None, :])
        body = ONE_BODY.point(identified[: spd.SIZE])
        self._bound = max(divergence(ONE_BODY.point(body.parameters + load), body) for load in loads)
        self._mean_load = np.mean(loads, axis=0)
        self.point = self._identified

    @property
    def body(self) -> FloatArray:
        """Inertia ``(10,)`` of the body."""
        return self.point.parameters[: spd.SIZE]

    @property
    def change(self) -> FloatArray:
        """Difference ``(10 + K,)`` from what was identified."""
        return self.point.parameters - self._identified.parameters

    def resume(self, body: FloatArray) -> None:
        """Go on with a ``body (10,)``, unless no payload makes it of the identified one."""
        point = self._manifold.point(np.append(body, self._identified.positives))
        if divergence(point, self._identified) < self._bound:
            self.point = point

    def shortest_change(self, rows: FloatArray, residuals: FloatArray) -> FloatArray:
        """Return :func:`shortest_change` from here, ``(10 + K,)``; a coefficient moves as far as it usually errs."""
        return self._scales * shortest_change(self._manifold, self.point, rows * self._scales, residuals)

    def step(self, tangent: FloatArray) -> None:
        """Follow a ``tangent (10 + K,)``, no farther than rows are nearly linear, unless it leads further out of the
        bound."""
        length = float(np.linalg.norm(tangent))
        end = self._manifold.exp(self.point, tangent * min(1.0, LARGEST_STEP / length) if length else tangent)
        distance = divergence(end, self._identified)
        if distance < self._bound or distance < divergence(self.point, self._identified):
            self.point = end

    def explains(self, rows: FloatArray, residuals: FloatArray) -> bool:
        """True if the ``residuals`` of ``rows (joints, 10 + K)`` may be those of the body with a payload.

        The shortest change that explains them is computed in the metric of the body with the heaviest payload, spread
        as far as it may lie. It must not remove more than this body, as a contact that pulls sideways or upwards does.
        """
        loaded = ONE_BODY.point(self.body + self._mean_load)
        change = spd.to_matrix(shortest_change(ONE_BODY, loaded, rows[:, : spd.SIZE], residuals))
        return bool(np.linalg.eigvalsh(change)[0] > -1.0)


LARGEST_SHARE = 0.3
"""Largest correction, as a fraction of the joint's effort limit."""
FASTEST = 5.0
"""Largest change of the correction, in effort limits per second."""
_NOISE = 0.01  # of the effort limit: standard deviation of efforts that no inertia of the body explains
LONGEST_FAULT = 0.1
"""Time [s] that a fault may last before the correction is switched off; meanwhile nothing is learned."""
_MEMORY = 1.0  # [s] in which a long delay, and a fault of LONGEST_FAULT, are forgotten


@dataclass(frozen=True, eq=False)
class Reading:
    """Measurements at a ``time`` [s]: ``position, velocity, effort (joints,)``."""

    time: float
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray

    @property
    def numbers(self) -> FloatArray:
        """All measurements ``(3, joints)``."""
        return np.array([self.position, self.velocity, self.effort])

    @property
    def is_complete(self) -> bool:
        """True if no number is missing."""
        return bool(np.isfinite(self.numbers).all())


class CommandedMotion:
    """Motion that a position controller is to follow: each trajectory replaces the one before once it starts."""

    def __init__(self, joints: Sequence[str]) -> None:
        self._joints = joints
        self._trajectories: list[tuple[float, Trajectory | None]] = []  # with their starts [s], as they were sent
        self.position = np.zeros(len(joints))
        """Last known position ``(joints,)``: the robot is at rest there while there is no trajectory."""

    def follow(self, trajectory: Trajectory | None, start: float, now: float) -> None:
        """Follow a trajectory from ``start`` [s] on, in place of all that were sent before; None to stop."""
        begun = now - LONGEST_FAULT  # a reading may be that old
        last = max((place for place, (begin, _) in enumerate(self._trajectories) if begin <= begun), default=0)
        self._trajectories = [*self._trajectories[last:], (start, trajectory)]

    def __call__(self, time: float) -> FloatArray:
        """Return positions, velocities and accelerations ``(3, joints)`` at a time [s]."""
        started = (each for each in reversed(self._trajectories) if each[0] <= time)
        start, trajectory = next(started, (time, None))
        if trajectory is None:
            return np.array([self.position, *np.zeros((2, len(self._joints)))])
        order = [trajectory.joints.index(joint) for joint in self._joints]
        motion = trajectory.states(np.array([time - start]))[:3, 0, order]
        if time - start > trajectory.duration:
            motion[1:] = 0.0
        return np.asarray(motion)


class FaultLatch:
    """Adds up the time of faults, and remembers why the correction is off."""

    def __init__(self) -> None:
        self._before = -np.inf
        self._is_wrong = False
        self._wrong = 0.0  # [s] of faults, less the forgotten time
        self.reason = ""
        """Sentence on why the correction is off; empty while it is on."""

    def record(self, now: float, faults: Sequence[str]) -> None:
        """Record the ``faults`` from ``now`` [s] on, in sentences: intermittent faults add up."""
        elapsed, self._before = max(0.0, now - self._before), now
        change = elapsed if self._is_wrong else -elapsed * LONGEST_FAULT / _MEMORY
        self._wrong, self._is_wrong = max(0.0, self._wrong + change), bool(faults)
        if faults and self._wrong >= LONGEST_FAULT:
            self.switch_off(faults[0])

    def switch_off(self, reason: str) -> None:
        """Switch off. The first ``reason`` is kept."""
        self.reason = self.reason or reason


class Correction:
    """Efforts that a changed inertia of one body adds to those of an identified model.

    The caller passes the time [s], of any one clock. Only one thread may call it at a time.
    """

    def __init__(
        self, efforts: MotorEfforts, joints: Sequence[str], body: str, heaviest: float, friction: bool = False
    ) -> None:
        """
        Args:
            efforts: efforts of the identified model, for motions of ``joints``.
            joints: names, in the order of all arrays.
            body: body that adapts.
            heaviest: largest payload [kg].
            friction: True to adapt the positive coefficients of the model's effects, too.

        Raises:
            InputError: a joint has no effort limit, or no effort depends on the body.
        """
        self._efforts, self._joints, self._limits = efforts, tuple(joints), efforts.limits
        if unlimited := [name for name, limit in zip(joints, self._limits, strict=True) if not np.isfinite(limit)]:
            raise InputError(f"joint '{unlimited[0]}' has no effort limit in the URDF; adaptation is bounded by it")
        parts = [efforts.of_body(body), *([efforts.of_coefficients()] if friction else [])]
        self._parts = [rows_of for rows_of, _ in parts]
        self._coefficients = [coefficient for _, coefficient, _ in efforts.coefficients] if friction else []
        self.adaptation = Adaptation(np.concatenate([identified for _, identified in parts]), heaviest)
        self.delay = 0.0
        """Delay of the loop [s] that the gain is set for: age of the data plus the time between them, the longest of
        about a second."""
        self.latch = FaultLatch()
        self._before: Reading | None = None
        self._faults: list[str] = []  # of the last reading
        self._received = self._sent = -np.inf
        self._last = np.zeros(len(joints))

    @property
    def coefficients(self) -> dict[str, float]:
        """Present values of the coefficients that adapt, by their names with joints and units."""
        names = [f"{c.effect.name} {c.parameter} of {c.place_name} [{c.unit}]" for c in self._coefficients]
        return dict(zip(names, self.adaptation.point.positives.tolist(), strict=True))

    def continue_from(self, other: Correction) -> None:
        """Continue from the last efforts of another correction, to change gradually."""
        self._last, self._sent = other._last, other._sent

    def learn(self, now: float, reading: Reading, commanded: FloatArray) -> None:
        """Adapt to a reading and the motion ``(3, joints)`` that was ``commanded`` at its time."""
        before = self._before or reading
        if not reading.is_complete:
            return
        self._before = reading
        step = reading.time - before.time
        if step < 0.0:
            self.latch.switch_off(f"the clock of joint states went back by {-step:.3g} s")
        if step <= 0.0:
            return
        self._received = now
        delay = max(0.0, now - reading.time) + step
        self._faults = faults = self._lateness(delay)
        if not faults:
            self.delay = max(delay, self.delay * (1.0 - step / _MEMORY))
        fraction = np.abs(reading.effort) / self._limits
        if np.max(fraction) >= 1.0 - _NOISE:
            faults.append(f"the effort of joint '{self._joints[int(np.argmax(fraction))]}' saturates")
        if np.array_equal(reading.numbers, before.numbers) and np.max(np.abs(commanded[1])) > REST_SPEED:
            faults.append("joint states repeat while the robot is to move")
        rows, residuals = self._missing(np.array([reading.position, *commanded[1:]]), reading.effort)
        if not self.adaptation.explains(rows, residuals):
            faults.append(
                "no payload explains the efforts: the robot touches something, or lags behind its trajectory's clock"
            )
        self.latch.record(now, faults)
        if not faults and not self.latch.reason:
            tangent = self.adaptation.shortest_change(rows, residuals)
            self.adaptation.step(removed_fraction(step, self.delay) * tangent)

    def _lateness(self, delay: float) -> list[str]:
        """Return the fault of a delay of the loop [s] in a sentence, if it is one: if the gain times this delay exceeds
        1. The loop is stable up to pi / 2."""
        if not self.delay or MARGIN * delay <= self.delay:
            return []
        return [f"joint states are {1e3 * delay:.0f} ms late, after {1e3 * self.delay:.0f} ms before"]

    def _rows_of(self, motion: FloatArray) -> FloatArray:
        """Rows ``(joints, 10 + K)`` of the body and the coefficients that adapt."""
        return np.concatenate([rows_of(motion) for rows_of in self._parts], axis=1)

    def _missing(self, motion: FloatArray, effort: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rows ``(joints, 10 + K)``, and the residual ``effort (joints,)`` that neither they nor the model explain,
        both in units of the noise."""
        rows, noise = self._rows_of(motion), _NOISE * self._limits
        residuals = effort - self._efforts(motion[:, None])[0] - rows @ self.adaptation.change
        return rows / noise[:, None], residuals / noise

    def __call__(self, now: float, commanded: FloatArray) -> FloatArray:
        """Efforts ``(joints,)`` to add to those of the identified model, for the motion ``commanded (3, joints)``."""
        if np.isfinite(self._received) and now - self._received > LONGEST_FAULT:
            self.latch.switch_off(f"no joint states for {1e3 * (now - self._received):.0f} ms")
        if self._before is not None:  # late data are late before they arrive
            self.latch.record(now, [*self._faults, *self._lateness(now - self._before.time)])
        elapsed, self._sent = now - self._sent, now
        if elapsed < 0.0:
            self.latch.switch_off(f"the clock went back by {-elapsed:.3g} s")
        wanted = self._rows_of(commanded) @ self.adaptation.change
        if not np.isfinite(wanted).all():
            self.latch.switch_off("the efforts to add are not finite; the motion that is commanded is wrong")
        if self.latch.reason:
            wanted = np.zeros(len(self._joints))
        bound, change = LARGEST_SHARE * self._limits, FASTEST * self._limits * max(0.0, min(elapsed, LONGEST_FAULT))
        self._last = np.clip(np.clip(wanted, -bound, bound), self._last - change, self._last + change)
        return self._last
