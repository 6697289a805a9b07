"""Training data on their way to the identifier, and their checks; wrench sensors are checked by their first rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from geomid_ros.checks.causes import Cause, RecordingFault
from geomid_ros.checks.wrench_sensors import FirstForces
from geomid_ros.errors import InputError
from geomid_ros.model.measurement_model import Rows
from geomid_ros.model.moving_base import Legs
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.monitoring.change_detection import sensor_channels
from geomid_ros.session.session import Session
from geomid_ros.signals.settings import MOST_WAITING_BYTES


def check_measured(session: Session, train: Iterable[Samples], bags: Sequence[Path]) -> None:
    """Refuse data without samples, or without a measurement that the model predicts.

    Raises:
        InputError: it names the ``bags`` that the data are from.
    """
    fitted = TrainingData(session)
    for samples in train:
        fitted.add(samples)
    fitted.check(bags)


class TrainingData:
    """Passes on the samples to fit, and checks that they can be fitted."""

    def __init__(self, session: Session, fit: Callable[[Samples], object] = lambda _: None) -> None:
        """
        Args:
            session: the session that fits them.
            fit: called with the samples.
        """
        self._session = session
        self._fit = fit
        self._any = self._measured = False
        self._standing: Samples | None = None  # the first samples with a foot on the ground
        self._low, self._high = np.inf, -np.inf  # range of positions, by joint

    def add(self, samples: Samples) -> None:
        """Pass on samples, if there are any."""
        if not len(samples):
            return
        self._any = True
        targets = (self._session.model.rows(piece).targets for piece in samples.in_pieces())
        self._measured = self._measured or any(not np.all(np.isnan(each)) for each in targets)
        if self._standing is None and np.any(samples.standing):
            self._standing = samples
        self._low = np.minimum(self._low, np.min(samples.position, axis=0))
        self._high = np.maximum(self._high, np.max(samples.position, axis=0))
        self._fit(samples)

    def check(self, bags: Sequence[Path]) -> None:
        """Refuse the data like :func:`check_measured`."""
        files = ", ".join(map(str, bags))
        if not self._any:
            raise InputError(f"{files}: too short, no data left to identify from")
        legs = self._session.model.legs
        if legs is not None and self._standing is None:
            feet = ", ".join(contact.frame for contact in legs.contacts)
            raise InputError(
                f"{files}: leg efforts show no ground contact at feet {feet}. If the robot stands, check that efforts "
                "are in N m (--gain); if it hangs or lies on a stand, leave out --imu and --contacts"
            )
        if legs is not None and self._standing is not None and not self._measured:
            raise InputError(f"{files}: {_no_ground_forces(self._session.model.robot, legs, self._standing)}")
        if not self._measured:
            channels = ", ".join(channel.name for channel in self._session.model.channels)
            raise InputError(
                f"{files}: no effort is measured (empty, NaN or zero throughout), and no wrench is declared with "
                f"--wrench. At least one of these channels is needed: {channels}. Let the driver publish efforts, or "
                "record a wrench sensor"
            )

    def standstill_findings(self) -> tuple[RecordingFault, ...]:
        """One finding if the robot does not move in the data to fit, else none."""
        largest = float(np.max(self._high - self._low, initial=0.0))
        if self._session.robot.floating_base or largest >= self._session.configuration["still_distance"]:
            return ()
        sentence = (
            f"the robot is at rest: no joint moves by more than {largest:.2g} (rad, m), which contains almost no "
            "information"
        )
        return (RecordingFault(cause=Cause(kind="still", sentence=f"{sentence}; record a motion of all joints")),)


def _no_ground_forces(robot: Robot, legs: Legs, standing: Samples) -> str:
    """Sentence on why the efforts never determine the forces of the ground; a foot stands in some of the samples."""
    measured = np.any(np.isfinite(standing.effort), axis=0)
    missing = [robot.joint_names[joint] for joints in legs.joints for joint in joints if not measured[joint]]
    if missing:
        return (
            f"no efforts are measured at {', '.join(missing)}, so that ground reaction forces are unknown. Let the "
            "driver publish the efforts of all joints, or compute them from set-points: --command TOPIC with --gains "
            "KP:KD"
        )
    feet = zip(legs.contacts, legs.standing(standing), strict=True)
    blind = [contact.frame for contact, (_, rows, onto_base) in feet if len(rows) and np.all(np.isnan(onto_base))]
    return (
        f"ground reaction forces on {', '.join(blind) or 'the feet'} are not identifiable from the efforts in any "
        "sample: the joints do not move these links in three directions. Name the links that touch the ground "
        "(--contacts), not those at a knee; if they are the feet, the legs are always stretched: bend them"
    )


class Training:
    """Gives samples to a session's identifier. Checks its mounted wrench sensors once, by the first rows that it took,
    and leaves out the rows of those that are not as declared."""

    def __init__(self, session: Session, watched: bool = False) -> None:
        """Begin with the session's next samples. ``watched``: rows may be left out because of a payload, too."""
        self._session, self._watched = session, watched
        self._sensors = sensor_channels(session.model)
        self._check = FirstForces(session.model, session.model.nominal_parameters)
        self._keep_revocable()

    def add(self, samples: Samples) -> None:
        """Add samples."""
        for piece in samples.in_pieces():
            _, rows, _ = self._session.identifier.add(piece)
            self.check(rows)

    def end(self) -> None:
        """Add findings on the sensors that are not as declared to the session's review."""
        reported = {place for finding in self._session.review.findings for place in finding.cause.places}
        self._session.review.findings += tuple(
            RecordingFault(cause=Cause(kind="wrench", sentence=sentence, places=(topic,)))
            for topic, sentence in self.sentences.items()
            if topic not in reported
        )

    @property
    def sentences(self) -> dict[str, str]:
        """Fault of each sensor that is not as declared, by its topic."""
        return {topic: f"{topic}: {problem} Its rows are left out" for topic, problem in self._check.problems.items()}

    def check(self, rows: Rows) -> bool:
        """Check the sensors by rows that were taken, and leave out the rows of faulty sensors.

        Returns:
            True if any were left out.
        """
        if self._check.ended:
            return False
        self._check.add(rows)
        for topic in self._check.problems:
            self._session.identifier.leave_out(f"wrench doubtful: {topic}", self._sensors[topic], 0)
        self._keep_revocable()
        return bool(self._check.problems)

    def without_doubtful(self, rows: Rows) -> Rows:
        """Rows without those of faulty sensors."""
        targets = rows.targets.copy()
        targets[:, [place for topic in self._check.problems for place in self._sensors[topic]]] = np.nan
        return Rows(rows.coefficients, targets)

    def _keep_revocable(self) -> None:
        """Keep rows revocable while their sensors may still prove to be faulty, or a payload to have been carried."""
        model = self._session.model
        forgets = np.isfinite(self._session.configuration.buffer.forgetting_time)
        bytes_per_sample = 8 * (model.dimension + 1) * len(model.channels)
        revocable = self._watched or (model.mounted and not (forgets and self._check.ended))
        self._session.identifier.buffer_last(MOST_WAITING_BYTES // bytes_per_sample if revocable else 0)
