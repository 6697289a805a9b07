"""The problem linearised at a total model: what depends on the model itself is computed there anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.gap import library
from geomid_ros.gap.curves import Curves
from geomid_ros.gap.design import Design, term_columns
from geomid_ros.gap.fit import JointFit
from geomid_ros.gap.library import Candidate, Term
from geomid_ros.gap.noise import Autoregression
from geomid_ros.gap.record import Records
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import EffortDelay, EffortGain, GravityTilt, Situation
from geomid_ros.model.measurement import MeasurementModel, Rows
from geomid_ros.types import FloatArray

_STEP = 1e-6
_GAIN_ERRORS = (-0.7, 2.0)


@dataclass(frozen=True, eq=False)
class TotalModel:
    """``inertias (bodies, 10)`` of all bodies with their payloads, joint effects ``(joints, library)``, the base's
    ``tilt (2,)`` [rad], the efforts' ``delay`` [s], and the errors of their gains ``(joints,)``."""

    inertias: FloatArray
    effects: FloatArray
    tilt: FloatArray
    delay: float
    gains: FloatArray

    @staticmethod
    def of(model: MeasurementModel, found: JointFit) -> TotalModel:
        """The model that a joint fit says."""
        inertias = np.array([body.parameters for body in model.robot.bodies])
        links = pseudo_inertia.to_parameters(found.point.pseudo_inertias)
        for place, body in enumerate(model.identified):
            inertias[body] = links[place]
        for place, carrier in enumerate(found.bodies):
            inertias[model.identified[carrier]] += links[len(model.identified) + place]
        effects = np.zeros((len(model.robot.joints), len(library.MOTION_EFFECTS)))
        tilt, delay, gains = np.zeros(2), 0.0, np.zeros(len(model.robot.joints))
        for term in found.terms:
            if term.motion >= 0:
                effects[term.joint, term.motion] += found.value(term)
            elif isinstance(term.situation, GravityTilt):
                tilt[term.index] = found.value(term)
            elif isinstance(term.situation, EffortDelay):
                delay = found.value(term)
            elif isinstance(term.situation, EffortGain):
                gains[term.joint] = np.clip(found.value(term), *_GAIN_ERRORS)
        return TotalModel(inertias, effects, tilt, delay, gains)


def turned_gravity(gravity: FloatArray, tilt: FloatArray) -> FloatArray:
    """``R^T g`` for the rotation vector ``(tilt_x, tilt_y, 0)``."""
    angle = float(np.linalg.norm(tilt))
    if angle == 0.0:
        return gravity
    axis = np.append(tilt, 0.0) / angle
    # Rodrigues' formula for the opposite rotation.
    turned: FloatArray = (
        np.cos(angle) * gravity
        - np.sin(angle) * np.cross(axis, gravity)
        + (1.0 - np.cos(angle)) * (axis @ gravity) * axis
    )
    return turned


class Stage:
    """Records under a model linearised at ``total``.

    A tilt, delay or gain that was found is not added as its column: the gravity is turned, the efforts are moved, the
    rows scaled; and the target is changed so that the coefficients still mean the whole tilt, delay and gain.
    """

    def __init__(self, model: MeasurementModel, records: Records, total: TotalModel) -> None:
        self.total = total
        self.records = records.advanced(total.delay)
        gravity = model.robot.gravity
        self.model = model.with_gravity(turned_gravity(gravity, total.tilt)) if np.any(total.tilt) else model
        steps = [_STEP * unit for unit in np.eye(2)]
        self._by_tilt = np.array(
            [(turned_gravity(gravity, total.tilt + s) - turned_gravity(gravity, total.tilt - s)) for s in steps]
        ).T / (2.0 * _STEP)

    @cached_property
    def situation(self) -> Situation:
        """What the total model says."""
        return self.records.situation(self.model, self.total.inertias, self.total.effects, self._by_tilt)

    @cached_property
    def rows(self) -> Rows:
        """Rows of the inertias, with the targets changed."""
        rows = self.records.rows(self.model)
        targets = rows.targets.copy()
        if np.any(self.total.tilt):
            targets += GravityTilt().columns(self.situation, -1) @ self.total.tilt
        if self.total.delay != 0.0:
            targets += EffortDelay().columns(self.situation, -1)[:, :, 0] * self.total.delay
        coefficients = rows.coefficients.copy()
        for joint in np.flatnonzero(self.total.gains):
            targets[:, joint] += self.total.gains[joint] * self.situation.predicted[:, joint]
            coefficients[:, joint] *= 1.0 + self.total.gains[joint]
        return Rows(coefficients, targets)

    def columns(
        self, candidates: Sequence[Candidate], base: Sequence[Term], curves: Curves | None = None
    ) -> dict[Term, dict[int, FloatArray]]:
        """Columns of all candidates, of what the model already has, and of free curves."""
        terms = dict.fromkeys([*base, *(t for c in candidates for t in c.terms if not t.curve)])
        free = curves.columns(self.records, self.situation) if curves is not None else {}
        columns = term_columns(self.records, list(terms), self.situation) | free
        for joint in np.flatnonzero(self.total.gains):
            for term, by_channel in columns.items():
                if joint in by_channel and not isinstance(term.situation, EffortGain):
                    by_channel[int(joint)] = by_channel[int(joint)] * (1.0 + self.total.gains[joint])
        return columns

    def design(self, columns: dict[Term, dict[int, FloatArray]], noise: Sequence[Autoregression]) -> Design:
        """Whitened products."""
        rows = self.rows
        valid = self.records.usable(rows.targets)
        return Design.make(rows.coefficients, rows.targets, valid, columns, noise, self.records)

    def residual(self, columns: dict[Term, dict[int, FloatArray]], found: JointFit) -> FloatArray:
        """Measured less predicted ``(N, C)``; of a delayed channel at the moment at which it was true."""
        rows = self.rows
        links = pseudo_inertia.to_parameters(found.point.pseudo_inertias)
        count = len(self.model.identified)
        inertias = links[:count].copy()
        for place, carrier in enumerate(found.bodies):
            inertias[carrier] += links[count + place]
        residual: FloatArray = rows.targets - rows.coefficients @ inertias.ravel()
        for term in found.terms:
            for channel, column in columns[term].items():
                residual[:, channel] -= found.value(term) * column
        return residual
