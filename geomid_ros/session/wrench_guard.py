"""Wrench sensors are checked by their first rows; the rows of those that are wrong do not count."""

from __future__ import annotations

import numpy as np

from geomid_ros.checks.wrenches import FirstForces
from geomid_ros.model.measurement import Rows
from geomid_ros.monitoring.change_detection import sensor_channels
from geomid_ros.session.session import Session

_MOST_HELD = 100_000_000  # bytes of rows that can be taken back


class WrenchGuard:
    """Judges the mounted sensors of a session once, by the rows that its identifier took first."""

    def __init__(self, session: Session) -> None:
        """Begin with the next rows."""
        self._session = session
        self._sensors = sensor_channels(session.model)
        self._check = FirstForces(session.model, session.nominal_parameters)
        self._keep_revocable()

    @property
    def ended(self) -> bool:
        """Whether the sensors have been judged."""
        return self._check.ended

    @property
    def sentences(self) -> dict[str, str]:
        """What is wrong with each sensor that is not as declared, by its topic."""
        return {topic: f"{topic}: {problem} Its rows are left out" for topic, problem in self._check.problems.items()}

    def take(self, rows: Rows) -> bool:
        """Check the sensors by rows that were taken, and leave out those of sensors that are wrong.

        Returns:
            Whether any were.
        """
        if self.ended:
            return False
        self._check.add(rows)
        for topic in self._check.problems:
            self._session.identifier.leave_out(f"wrench doubtful: {topic}", self._sensors[topic], 0)
        self._keep_revocable()
        return bool(self._check.problems)

    def without_doubtful(self, rows: Rows) -> Rows:
        """Rows without those of sensors that are wrong."""
        doubtful = [place for topic in self._check.problems for place in self._sensors[topic]]
        if not doubtful:
            return rows
        targets = rows.targets.copy()
        targets[:, doubtful] = np.nan
        return Rows(rows.coefficients, targets)

    def _keep_revocable(self) -> None:
        """Keep rows revocable while they may still be found to be bad."""
        model = self._session.model
        forgets = np.isfinite(self._session.configuration.buffer.forgetting_time)
        instant = 8 * (model.dimension + 1) * len(model.channels)
        doubted = model.mounted and not (forgets and self.ended)
        self._session.identifier.hold(_MOST_HELD // instant if doubted else 0)
