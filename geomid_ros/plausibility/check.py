"""The check of a recording as a whole: takes samples as they come, and says what the recording seems to be."""

from __future__ import annotations

from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.plausibility.efforts import EffortCheck
from geomid_ros.plausibility.hypotheses import Finding
from geomid_ros.plausibility.instants import Instants
from geomid_ros.types import FloatArray


class RecordingCheck:
    """Keeps a few instants of what was recorded, and judges them when asked.

    One thread may call :meth:`add` while another asks.
    """

    def __init__(self, model: MeasurementModel, gains: FloatArray) -> None:
        """
        Args:
            model: of the robot.
            gains: ``(joints,)`` factors that the messages' efforts are multiplied by.
        """
        self._model = model
        self._gains = gains
        self._instants = Instants()

    def add(self, samples: Samples) -> None:
        """Take samples, in the order of time of each recording."""
        self._instants.add(samples)

    def findings(self) -> tuple[Finding, ...]:
        """What seems to be wrong with the recording as a whole, the surest first."""
        samples = self._instants.samples
        if samples is None:
            return ()
        efforts = EffortCheck(self._model, samples, self._gains).findings() if self._judged_by_efforts else []
        return tuple(efforts)

    @property
    def _judged_by_efforts(self) -> bool:
        """Whether links and gravity alone decide on the efforts: not what the surroundings do to the robot."""
        external = len(self._model.sensors) > len(self._model.mounted)
        return bool(self._model.layout.efforts) and not self._model.robot.floating_base and not external
