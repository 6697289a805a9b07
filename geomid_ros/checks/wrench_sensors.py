"""Check of a mounted wrench sensor: axes, units, sign and time of its wrench.

The weight of a sensor's load rotates with the sensor, whatever its mass. So the axes, the ratio of force to torque and
the time are checked first, by the residual of links of any mass, of either sign. Only then the fitted mass shows the
common sign and unit. The first forces of a stream are checked against the URDF alone: a payload changes neither the
direction nor, by as much as a unit, the size.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from geomid_ros.checks.candidates import MASS_FACTOR, TILT, is_probable
from geomid_ros.checks.causes import Cause, RecordingFault, format_settings
from geomid_ros.checks.evidence import FRICTION, LARGEST_RESIDUAL, Unknowns, evidence, follows, prior_factor
from geomid_ros.checks.sample_reservoir import FEWEST, STEP
from geomid_ros.model.channels import AXES, WrenchSensor
from geomid_ros.model.measurement_model import MeasurementModel, Rows
from geomid_ros.model.samples import Samples
from geomid_ros.model.se3 import best_rotation, rotation_angle
from geomid_ros.types import FloatArray

_OTHER_UNIT = 50.0  # no tool's mass is wrong by such a factor
_FLOOR = np.finfo(float).tiny


@dataclass(frozen=True, eq=False)
class _Fit:
    """Fit of links of any mass to a wrench: log evidence per sample, ``sigmas (2,)`` of the residuals of force and
    torque, as fractions of their RMS, and the slope of the links' forces over the URDF's."""

    log: float
    sigmas: FloatArray
    slope: float


class WrenchSensorCheck:
    """Compares possible readings of one sensor's wrench."""

    def __init__(
        self, model: MeasurementModel, sensor: WrenchSensor, name: str, samples: Samples, dense: Samples
    ) -> None:
        """
        Args:
            model: of the robot.
            sensor: a mounted one that measures all six axes.
            name: of the sensor in the configuration.
            samples: a few samples of the recording.
            dense: its last samples in motion, one per 20 ms, to find a delay.
        """
        self._model, self._sensor, self._name = model, sensor, name
        bare = MeasurementModel(model.robot, (), model.sensors)
        self._channels = list(model.layout.wrenches[sensor.topic])
        self._prior = bare.nominal_parameters
        self._factor = prior_factor(model.robot)
        rows = bare.rows(samples)
        self._regressor = rows.coefficients[:, self._channels]
        self._wrench = rows.targets[:, self._channels]
        self._rotations = self._orientations(samples)
        self._bare, self._dense = bare, dense

    def _orientations(self, samples: Samples) -> FloatArray:
        """Rotations ``(N, 3, 3)`` from the sensor's axes to the base's."""
        robot, rotations = self._model.robot, []
        for q, v, a in zip(*robot.configuration(samples), strict=True):
            robot.update_motion(q, v, a)
            rotations.append(np.array(robot.placement(self._sensor.frame).rotation))
        return np.array(rotations)

    def findings(self) -> list[RecordingFault]:
        """Return what is wrong with the sensor; nothing if nothing is, or the data are not informative."""
        if len(self._wrench) < FEWEST or not np.all(np.std(self._wrench, axis=0) > 0.0):
            return []
        nominal = self._fit(self._regressor, self._wrench)
        tried = [(self._fit(self._regressor, wrench), nominal, cause) for wrench, cause in self._geometries()]
        tried += self._delayed()
        best, reference, cause = max(tried, key=lambda one: one[0].log - one[1].log)
        remaining = nominal.sigmas * best.sigmas / reference.sigmas
        if is_probable(best.log - reference.log, len(tried)) and np.all(remaining < LARGEST_RESIDUAL):
            return [RecordingFault(cause=cause)]
        return self._sign_or_unit(nominal.slope) if nominal.sigmas[0] < LARGEST_RESIDUAL else []

    def _sign_or_unit(self, slope: float) -> list[RecordingFault]:
        if slope < 0.0:
            settings = {f"wrench.{self._name}.sign": -self._sensor.sign}
            minus = "a minus before the role" if self._sensor.sign > 0.0 else "no minus before the role"
            flaw = f"its sign is reversed: write {format_settings(settings)} (on the command line, {minus})"
            return [RecordingFault(cause=self._cause(flaw, settings))]
        if (unit := _is_other_unit(slope)) or slope < 1.0 / MASS_FACTOR:
            flaw = f"its load would weigh {slope:.3g} times as much as in the URDF: check that it is in N and N m"
            return [RecordingFault(cause=self._cause(flaw), sure=unit)]
        return []

    def _cause(self, flaw: str, settings: Mapping[str, float] | None = None) -> Cause:
        topic, sentence = self._sensor.topic, f"the wrench sensor {self._sensor.topic}: {flaw}"
        return Cause(kind="wrench", sentence=sentence, settings=settings or {}, places=(topic,))

    def _geometries(self) -> Iterator[tuple[FloatArray, Cause]]:
        """Other wrenches ``(N, 6)`` that the messages may mean."""
        halves = self._wrench.reshape(-1, 2, 3)
        forces = [w[:, :3] - np.mean(w[:, :3], axis=0) for w in (self._regressor @ self._prior, self._wrench)]
        for sign in (1.0, -1.0):
            rotation = best_rotation(sign * forces[0].T @ forces[1])[0]
            if rotation_angle(rotation) > TILT:  # less may be a wrong zero of a joint
                flaw = f"its axes are rotated: {_described(rotation, self._sensor.frame)}; set the right frame"
                yield (halves @ rotation.T).reshape(-1, 6), self._cause(flaw)
        in_sensor = np.einsum("nji,nkj->nki", self._rotations, halves).reshape(-1, 6)
        yield in_sensor, self._cause(f"its wrench is in the axes of the base, not of '{self._sensor.frame}'")
        for factor, unit in ((1e-3, "N mm"), (1e3, "kN m")):
            scaled = self._wrench * np.array([1.0] * 3 + [factor] * 3)
            yield scaled, self._cause(f"its torques are in {unit}, its forces in N; they must be in N and N m")

    def _delayed(self) -> Iterator[tuple[_Fit, _Fit, Cause]]:
        """Fits at and without the delay at which the wrench is most like the URDF links' forces, on the dense
        stretch."""
        dense = self._dense
        times = dense.seconds
        if len(dense) < FEWEST:
            return
        rows = self._bare.rows(dense)
        regressor, wrench = rows.coefficients[:, self._channels], rows.targets[:, self._channels]
        delay = _best_delay(times, (regressor @ self._prior)[:, :3], wrench[:, :3])
        inside = (times + delay >= times[0]) & (times + delay <= times[-1])
        shifted = _interpolated(times[inside] + delay, times, wrench)
        flaw = f"its messages are {abs(delay):.2f} s {'late' if delay > 0.0 else 'early'} against the joints'"
        cause = self._cause(f"{flaw}: correct their stamps")
        yield self._fit(regressor[inside], shifted), self._fit(regressor, wrench), cause

    def _fit(self, regressor: FloatArray, wrench: FloatArray) -> _Fit:
        """Fit links of any mass, and a constant for each axis."""
        regressor, wrench = regressor - np.mean(regressor, axis=0), wrench - np.mean(wrench, axis=0)
        nominal = (regressor @ self._prior)[:, :3]
        square = max(float(np.sum(nominal**2)), _FLOOR)
        heavier = max(float(np.sqrt(np.sum(wrench[:, :3] ** 2) / square)), 1.0)
        # Each of a channel's three axes counts as a sample.
        target = wrench.reshape(-1, 2, 3).swapaxes(1, 2).reshape(-1, 2)
        by_body = regressor.reshape(-1, *self._factor.shape[:2]).transpose(1, 0, 2) @ (heavier * self._factor)
        by_errors = by_body.transpose(1, 0, 2).reshape(regressor.shape)
        by_axis = by_errors.reshape(len(wrench), 2, 3, -1).swapaxes(1, 2)
        columns = by_axis.reshape(len(target), 2, -1)
        sizes = np.maximum(np.sqrt(np.mean(target**2, axis=0)), _FLOOR)
        none = np.zeros((len(target), 2, FRICTION))
        fitted = evidence(target / sizes, Unknowns.of(columns, none), np.ones((2, FRICTION)), units=sizes)
        forces = (columns @ fitted.link_errors).reshape(-1, 3, 2)[:, :, 0]
        return _Fit(fitted.log_evidence / len(wrench), fitted.sigmas, float(np.sum(forces * nominal)) / square)


def _is_other_unit(ratio: float) -> bool:
    """True if no tool's mass differs from the URDF's by such a factor: it is another unit."""
    return not 1.0 / _OTHER_UNIT < ratio < _OTHER_UNIT


def _best_delay(times: FloatArray, expected: FloatArray, measured: FloatArray) -> float:
    """Delay [s] of measured forces ``(N, 3)`` behind the expected ones."""
    step = 1e-9 * STEP
    grid = np.arange(times[0], times[-1], step)
    if len(grid) < FEWEST:
        return 0.0
    both = [_interpolated(grid, times, forces) for forces in (expected, measured)]
    shifts = np.arange(-(len(grid) // 2), len(grid) // 2 + 1)
    correlations = [_correlation(both[0][max(-s, 0) :], both[1][max(s, 0) :]) for s in shifts]
    return float(shifts[int(np.argmax(correlations))] * step)


def _interpolated(instants: FloatArray, times: FloatArray, values: FloatArray) -> FloatArray:
    """Interpolate values ``(N, k)`` at ``times (N,)`` linearly, to ``(n, k)`` at ``instants (n,)``."""
    return np.array([np.interp(instants, times, column) for column in values.T]).T


def _correlation(a: FloatArray, b: FloatArray) -> float:
    count = min(len(a), len(b))
    a, b = a[:count] - np.mean(a[:count], axis=0), b[:count] - np.mean(b[:count], axis=0)
    return float(np.sum(a * b) / np.sqrt(max(float(np.sum(a * a) * np.sum(b * b)), _FLOOR)))


def _described(rotation: FloatArray, frame: str) -> str:
    """Describe a rotation by about right angles by the names of axes, any other by its angle."""
    turns = np.round(rotation)
    if np.array_equal(turns, np.eye(3)) or np.any(np.sum(np.abs(turns), axis=1) != 1.0):
        return f"against those of '{frame}' by about {np.degrees(rotation_angle(rotation)):.0f} degrees"
    named = ", ".join(("-" if min(row) < 0.0 else "") + "xyz"[int(np.argmax(np.abs(row)))] for row in turns)
    return f"x, y, z of '{frame}' are its {named}"


def can_be_checked(sensor: WrenchSensor) -> bool:
    """True if the weight outboard of a sensor decides on it: it is mounted and measures all axes."""
    return sensor.role == "mounted" and tuple(sensor.axes) == AXES


class FirstForces:
    """Compares the mounted sensors' first forces with those of the URDF: sign, axes and unit.

    One thread may call :meth:`add` while another asks.
    """

    def __init__(self, model: MeasurementModel, nominal: FloatArray) -> None:
        """
        Args:
            model: has the sensors.
            nominal: ``(D,)`` the URDF's parameters.
        """
        self._nominal = nominal
        self._forces = {
            sensor.topic: [model.layout.wrenches[sensor.topic][sensor.axes.index(axis)] for axis in AXES[:3]]
            for sensor in model.mounted
            if set(AXES[:3]) <= set(sensor.axes)
        }
        self._count = 0
        self._products = {topic: np.zeros((6, 6)) for topic in self._forces}
        self.problems: dict[str, str] = {}
        """Problem of each sensor that is not as declared, by its topic."""

    @property
    def ended(self) -> bool:
        """True if the sensors have been checked, or there are none to check."""
        return self._count >= 2 * FEWEST or not self._forces

    def add(self, rows: Rows) -> None:
        """Add rows of samples in motion, until there are enough."""
        if self.ended:
            return
        self._count += len(rows.targets)
        for topic, places in self._forces.items():
            expected = rows.coefficients[:, places] @ self._nominal
            both = np.concatenate([rows.targets[:, places], expected], axis=1)
            both = both[np.all(np.isfinite(both), axis=1)]
            self._products[topic] += both.T @ both
        if self.ended:
            problems = {topic: _problem(products) for topic, products in self._products.items()}
            self.problems = {topic: problem for topic, problem in problems.items() if problem}


def _problem(products: FloatArray) -> str:
    """Describe what is wrong with a sensor, from the summed products ``(6, 6)`` of measured and expected forces."""
    measured, expected = np.trace(products[:3, :3]), np.trace(products[3:, 3:])
    if not measured > 0.0 or not expected > 0.0:
        return ""
    scale = float(np.sqrt(measured * expected))
    agreement = np.asarray(np.trace(products[:3, 3:]) / scale)
    if follows(-agreement):
        return "the forces are opposite to those expected from the URDF: check the sign"
    if agreement < LARGEST_RESIDUAL and follows(np.asarray(best_rotation(products[3:, :3])[1] / scale)):
        return "the forces are rotated against those expected from the URDF: check the frame"
    ratio = float(np.sqrt(measured / expected))
    if follows(agreement) and _is_other_unit(ratio):
        return f"the forces are {ratio:.2g} times those expected from the URDF: check the unit"
    return ""
