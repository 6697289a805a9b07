"""The problem linearised at a total model: what depends on the model itself is computed there anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomid_ros.gap import candidates as library
from geomid_ros.gap.candidates import Candidate, Term
from geomid_ros.gap.evidence.curves import Curves
from geomid_ros.gap.evidence.design import Design, term_columns
from geomid_ros.gap.evidence.noise import Autoregression
from geomid_ros.gap.evidence.record import Records
from geomid_ros.gap.fitting.fit import JointFit
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import Situation
from geomid_ros.model.effects.effort_delay import EffortDelay
from geomid_ros.model.effects.effort_gain import EffortGain
from geomid_ros.model.effects.gravity_tilt import GravityTilt
from geomid_ros.model.effects.load_friction import LoadFriction
from geomid_ros.model.measurement import MeasurementModel, Rows
from geomid_ros.types import BoolArray, FloatArray

_STEP = 1e-6
_GAIN_ERRORS = (-0.7, 2.0)
_FRICTION_ERROR = 0.7  # of the noise: where dry friction is less sure than this nothing is learnt and nothing judged


@dataclass(frozen=True, eq=False)
class TotalModel:
    """``inertias (bodies, 10)`` of all bodies with their payloads, joint effects ``(joints, library)``, the base's
    ``tilt (2,)`` [rad], the efforts' ``delay`` [s], the errors of their gains ``(joints,)``, and the coefficients of
    friction by the load ``(joints,)``."""

    inertias: FloatArray
    effects: FloatArray
    tilt: FloatArray
    delay: float
    gains: FloatArray
    load_frictions: FloatArray

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
        load_frictions = np.zeros(len(model.robot.joints))
        for term in found.terms:
            if term.motion >= 0:
                effects[term.joint, term.motion] += found.value(term)
            elif isinstance(term.situation, GravityTilt):
                tilt[term.index] = found.value(term)
            elif isinstance(term.situation, EffortDelay):
                delay = found.value(term)
            elif isinstance(term.situation, EffortGain):
                gains[term.joint] = np.clip(found.value(term), *_GAIN_ERRORS)
            elif isinstance(term.situation, LoadFriction):
                load_frictions[term.joint] = abs(found.value(term))
        return TotalModel(inertias, effects, tilt, delay, gains, load_frictions)


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

    def __init__(
        self, model: MeasurementModel, records: Records, total: TotalModel, floor: FloatArray | None = None
    ) -> None:
        self.total = total
        self._floor = np.full(len(model.channels), np.inf) if floor is None else floor
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

    @cached_property
    def valid(self) -> BoolArray:
        """Which targets ``(N, C)`` are measured at instants that the model can be blamed for: not where a joint's dry
        friction is uncertain by more than a share of the noise, nor where that reaches other channels through the
        joint's acceleration."""
        valid = self.records.usable(self.model, self.rows.targets)
        if not self.model.efforts_usable or not np.any(self._dry_friction):
            return valid
        joints = self._dry_friction.shape[1]
        by_acceleration = np.abs(self.situation.by_acceleration)
        own = np.einsum("njj->nj", by_acceleration[:, :joints])
        shares = by_acceleration / np.maximum(own, 1e-12)[:, None]
        uncertain = np.max(shares * (self._dry_friction * self.records.unsettled)[:, None], axis=2)
        usable: BoolArray = valid & (uncertain < _FRICTION_ERROR * self._floor)
        return usable

    @cached_property
    def _dry_friction(self) -> FloatArray:
        """Size of the dry friction that the total model says ``(N, joints)``."""
        levels = np.abs(self.total.effects[:, library.DRY]).sum(axis=1)
        sizes: FloatArray = levels + self.total.load_frictions * np.abs(self.situation.load)
        return sizes

    def columns(
        self, candidates: Sequence[Candidate], base: Sequence[Term], curves: Curves | None = None
    ) -> dict[Term, dict[int, FloatArray]]:
        """Columns of all candidates, of what the model already has, and of free curves."""
        terms = dict.fromkeys([*base, *(t for c in candidates for t in c.terms if not t.curve)])
        free = curves.columns(self.records, self.situation) if curves is not None else {}
        columns = term_columns(self.records, list(terms), lambda: self.situation) | free
        for joint in np.flatnonzero(self.total.gains):
            for term, by_channel in columns.items():
                if joint in by_channel and not isinstance(term.situation, EffortGain):
                    by_channel[int(joint)] = by_channel[int(joint)] * (1.0 + self.total.gains[joint])
        return columns

    def design(self, columns: dict[Term, dict[int, FloatArray]], noise: Sequence[Autoregression]) -> Design:
        """Whitened products."""
        rows = self.rows
        return Design.make(rows.coefficients, rows.targets, self.valid, columns, noise, self.records)

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

    def variance(self, columns: dict[Term, dict[int, FloatArray]], found: JointFit) -> FloatArray:
        """Of the prediction ``(N, C)``, from the uncertainty of what was fitted."""
        coefficients = self.rows.coefficients
        again = [coefficients[:, :, 10 * carrier : 10 * carrier + 10] for carrier in found.bodies]
        own = np.zeros((*coefficients.shape[:2], len(found.terms)))
        for place, term in enumerate(found.terms):
            for channel, column in columns[term].items():
                own[:, channel, place] = column
        jacobian = np.concatenate([coefficients, *again, own], axis=2)
        variance: FloatArray = np.einsum("ncd,de,nce->nc", jacobian, found.covariance, jacobian, optimize=True)
        return variance
