"""From an estimate to its picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.samples import Samples
from geomid_ros.report.ellipsoids import BodyDrawing, Ellipsoid
from geomid_ros.report.picture import identification_figure
from geomid_ros.report.series_drawing import Series
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray


def draw_identification(session: Session, estimate: Estimate, samples: Samples, of_what: str) -> Figure:
    """Draw bodies, before and after, in a pose of ``samples``, and the channels over the samples' time.

    ``of_what`` says which data the samples are.
    """
    middle = samples.select(slice(len(samples) // 2, len(samples) // 2 + 1))
    return identification_figure(
        f"{session.robot.name}: identified link inertias",
        _bodies(session, estimate, middle),
        _series(session, estimate, samples),
        f"Measured against predicted on {of_what}; {estimate.rows_accepted} rows identified from.",
    )


def _bodies(session: Session, estimate: Estimate, pose: Samples) -> list[BodyDrawing]:
    robot = session.robot
    frames = robot.link_frames(pose)
    nominal = session.model.nominal_inertias.reshape(-1, 10)
    drawings = []
    for index, link in enumerate(estimate.links):
        rotation, origin = frames[link.name]
        parent = robot.parent_body(link.name)
        drawings.append(
            BodyDrawing(
                link.name,
                origin,
                frames[parent][1] if parent else None,
                _ellipsoid(nominal[index], rotation, origin),
                _ellipsoid(link.parameters, rotation, origin),
                link.from_data,
            )
        )
    return drawings


def _ellipsoid(parameters: FloatArray, rotation: FloatArray, origin: FloatArray) -> Ellipsoid:
    semi_axes, axes = pseudo_inertia.equivalent_ellipsoid(parameters)
    centre = origin + rotation @ pseudo_inertia.centre_of_mass(parameters)
    return Ellipsoid(centre, semi_axes, rotation @ axes, float(parameters[0]))


def _series(session: Session, estimate: Estimate, samples: Samples) -> Sequence[Series]:
    times = (samples.stamps - samples.stamps[0]) * 1e-9
    measured, nominal = session.model.predict(samples, session.nominal_parameters)
    _, predicted = session.model.predict(samples, estimate.parameters)
    return [
        Series(channel.name, channel.unit, times, measured[:, index], nominal[:, index], predicted[:, index])
        for index, channel in enumerate(session.model.channels)
        if np.any(np.isfinite(measured[:, index]))
    ]
