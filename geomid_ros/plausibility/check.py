"""The check of a recording as a whole: takes samples as they come, and says what the recording seems to be."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.model.sensors import WrenchSensor
from geomid_ros.plausibility.efforts import MEASURED, EffortCheck
from geomid_ros.plausibility.hypotheses import Finding
from geomid_ros.plausibility.instants import FEWEST, Instants, Stretch
from geomid_ros.plausibility.wrenches import WrenchSensorCheck, can_be_judged
from geomid_ros.types import FloatArray

_RENEWED = 1.5


class RecordingCheck:
    """Keeps a few instants of what was recorded, and judges them when asked.

    One thread may call :meth:`add` while another asks.
    """

    def __init__(self, model: MeasurementModel, gains: FloatArray, sensors: Mapping[str, str]) -> None:
        """
        Args:
            model: of the robot.
            gains: ``(joints,)`` factors that the messages' efforts are multiplied by.
            sensors: the names of the wrench sensors in the configuration, by topic.
        """
        self._model = model
        self._gains = gains
        self._names = sensors
        self._sensors = [sensor for sensor in model.mounted if can_be_judged(sensor)]
        self._instants = Instants()
        self._stretch = Stretch()
        self._judged_at = 0.0
        self.remarks: list[str] = []
        """What to know of a recording that may be right, once it has been judged."""

    def add(self, samples: Samples) -> None:
        """Take samples, in the order of time of each recording."""
        self._instants.add(samples)
        self._stretch.add(samples)

    @property
    def due(self) -> bool:
        """Whether a third of what is known came after it was judged last: seldom, as time goes on."""
        return len(self._instants) >= FEWEST and self._instants.taken > _RENEWED * self._judged_at

    def findings(self) -> tuple[Finding, ...]:
        """What seems to be wrong with the recording as a whole."""
        samples, self._judged_at = self._instants.samples, self._instants.taken
        if samples is None:
            return ()
        efforts = []
        if self._efforts_alone:
            check = EffortCheck(self._model, samples, self._gains, self._stretch.samples)
            efforts, self.remarks = check.findings(), check.remarks
        return (*efforts, *filter(None, map(self._wrench, self._sensors)))

    @property
    def unmeasured(self) -> list[str]:
        """The joints whose efforts are missing at half of the instants or more: empty, not finite or all zero."""
        samples = self._instants.samples
        if samples is None or not self._model.layout.efforts:
            return []
        shares = np.mean(np.isfinite(samples.effort), axis=0)
        return [name for name, share in zip(self._model.robot.joint_names, shares, strict=True) if share < MEASURED]

    def _wrench(self, sensor: WrenchSensor) -> Finding | None:
        samples, dense = self._instants.samples, self._stretch.samples
        if samples is None or dense is None:
            return None
        name = self._names.get(sensor.topic, sensor.topic)
        return WrenchSensorCheck(self._model, sensor, name, samples, dense).finding()

    @property
    def _efforts_alone(self) -> bool:
        """Whether links and gravity alone decide on the efforts: not what the surroundings do to the robot."""
        external = len(self._model.sensors) > len(self._model.mounted)
        return bool(self._model.layout.efforts) and not self._model.robot.floating_base and not external
