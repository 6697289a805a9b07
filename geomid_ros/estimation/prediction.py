"""How sure predictions of an estimate are."""

from __future__ import annotations

import numpy as np

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray


def effort_deviations(model: MeasurementModel, samples: Samples, estimate: Estimate) -> FloatArray:
    """Standard deviations of the efforts that an estimate predicts, as its parameters are unsure together.

    What sensors and the robot do beside the model, ``estimate.sigmas``, is not in them.

    Args:
        model: That the estimate is of.
        samples: N samples.
        estimate: With the parameters and their posterior.

    Returns:
        ``(N, joints)``, NaN for joints whose effort is not measured.
    """
    first = 10 * len(model.identified)
    columns = np.append(np.arange(first), first + np.flatnonzero(estimate.parameters[first:]))  # zero: left out
    deviations = np.full(samples.effort.shape, np.nan)
    efforts = list(model.layout.efforts)
    if efforts:
        rows = model.rows(samples).coefficients[:, efforts][:, :, columns]
        variances = np.sum((rows @ estimate.posterior.parameter_covariance) * rows, axis=2)
        deviations[:] = np.sqrt(np.maximum(variances, 0.0))
    return deviations
