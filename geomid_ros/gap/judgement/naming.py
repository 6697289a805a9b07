"""From coefficients to what a user reads: parameters with units, sentences, and what would settle an ambiguity."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from geomid_ros.gap.candidates import Candidate
from geomid_ros.gap.fitting.fit import JointFit
from geomid_ros.gap.result import Quantity
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import PARAMETERS, PHYSICAL_EFFECTS
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.types import FloatArray

_STEP = 1e-4


def parameters(
    model: MeasurementModel, found: JointFit, candidate: Candidate, unsure: float = 0.0, usual_load: float = 0.0
) -> dict[str, Quantity]:
    """A candidate's parameters and their standard deviations; ``unsure``: that of the logarithm of what was scanned;
    ``usual_load`` [N m or N]: standard deviation of what the joint's gear transmits."""
    if candidate.payload >= 0:
        return _payload(found, candidate)
    values = np.array([found.value(term) for term in candidate.terms])
    places = [found.place(term) for term in candidate.terms]
    covariance = found.covariance[np.ix_(places, places)]
    if candidate.effect == "wrench_offset":
        return _wrench_offset(model, candidate, values, covariance)
    transformed, jacobian = _meaning(candidate, values)
    stds = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian), 0.0))
    sliding = candidate.joint >= 0 and model.robot.joints[candidate.joint].unit == "N"
    forms = PARAMETERS[candidate.effect]
    result = {
        name: Quantity(float(value), float(std), form.units[sliding])
        for (name, form), value, std in zip(forms.items(), transformed, stds, strict=False)
    }
    if candidate.effect == "stribeck_friction":
        speed = candidate.scanned
        result["speed"] = Quantity(speed, unsure * speed, forms["speed"].units[sliding])
    if candidate.effect == "backlash":
        # Against the drag the usual load crosses the gap in the time that was scanned.
        drag, share = usual_load * candidate.scanned / values[0], float(np.hypot(unsure, stds[0] / values[0]))
        result["drag"] = Quantity(drag, drag * share, forms["drag"].units[sliding])
    return result


def _meaning(candidate: Candidate, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Parameters and their derivatives by the coefficients."""
    if candidate.effect == "spring":
        stiffness, offset = values
        derivative = [[1.0, 0.0], [offset / stiffness**2, -1.0 / stiffness]]
        return np.array([stiffness, -offset / stiffness]), np.array(derivative)
    if candidate.effect == "joint_elasticity":
        return 1.0 / values, np.array([[-1.0 / values[0] ** 2]])
    if candidate.effect == "effort_gain":
        return 1.0 + values, np.eye(1)
    return values, np.eye(len(values))


def _payload(found: JointFit, candidate: Candidate) -> dict[str, Quantity]:
    place = found.manifold.links - len(found.bodies) + found.bodies.index(candidate.payload)
    rows = found.manifold.link(place)
    values = _of_body(pseudo_inertia.to_parameters(found.point.pseudo_inertias[place]))
    derivative = np.array([_moved(found, rows, k, place) for k in range(10)]).T
    covariance = derivative @ found.inverse[rows, rows] @ derivative.T
    stds = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return {
        name: Quantity(float(value), float(std), form.units[0])
        for (name, form), value, std in zip(PARAMETERS["payload"].items(), values, stds, strict=True)
    }


def _moved(found: JointFit, rows: slice, direction: int, place: int) -> FloatArray:
    tangent = np.zeros(found.manifold.dimension)
    tangent[rows.start + direction] = _STEP
    ends = [found.manifold.exp(found.point, sign * tangent).pseudo_inertias[place] for sign in (1.0, -1.0)]
    ahead, behind = (_of_body(pseudo_inertia.to_parameters(end)) for end in ends)
    result: FloatArray = (ahead - behind) / (2.0 * _STEP)
    return result


def _of_body(body: FloatArray) -> FloatArray:
    """Mass, centre of mass, and inertia about it."""
    rows, columns = pseudo_inertia.INERTIA_ENTRIES
    central = pseudo_inertia.central_inertia(body)
    return np.concatenate([body[:1], pseudo_inertia.centre_of_mass(body), central[rows, columns]])


def _wrench_offset(
    model: MeasurementModel, candidate: Candidate, values: FloatArray, covariance: FloatArray
) -> dict[str, Quantity]:
    result = {}
    for term, value, variance in zip(candidate.terms, values, np.diag(covariance), strict=True):
        channel = model.channels[term.channel]
        result[channel.name.rsplit("/", 1)[1]] = Quantity(float(value), float(np.sqrt(variance)), channel.unit)
    return result


def place_name(model: MeasurementModel, candidate: Candidate) -> str:
    """The joint that a finding names: empty for the whole robot, the topic of a wrench sensor."""
    if candidate.effect == "wrench_offset":
        channel = model.channels[candidate.terms[0].channel].name.rsplit("/", 1)[0]
        return next(s.topic for s in model.mounted if s.topic.strip("/") == channel)
    return model.robot.joint_names[candidate.joint] if candidate.joint >= 0 else ""


def link_name(model: MeasurementModel, candidate: Candidate) -> str:
    """The link that carries a payload, or empty."""
    return model.body_names[candidate.payload] if candidate.payload >= 0 else ""


def sentence(effect: str, joint: str, link: str, found: Mapping[str, Quantity], confidence: str) -> str:
    """A finding in words, with 95 % intervals."""
    where = f" at link '{link}'" if link else f" at '{joint}'" if joint else ""
    shown = list(found.items())[:4] if effect == "payload" else list(found.items())
    values = ", ".join(
        f"{name} {q.value:.4g} ± {1.96 * q.std:.2g}{'' if q.unit == '-' else ' ' + q.unit}" for name, q in shown
    )
    sure = {"confident": "", "tentative": "Perhaps ", "ambiguous": "One of several: "}[confidence]
    text = f"{PHYSICAL_EFFECTS[effect].label}{where}: {values} (95 % interval)."
    return sure + text if sure else text[0].upper() + text[1:]


def settled_by(effect: str, joint: str, rivals: Collection[tuple[str, str]]) -> str:
    """The recording that would tell an effect from its rivals, (name, joint) each."""
    others = [other for name, other in rivals if name == "payload"]
    if effect == "payload" and others:
        return f"a motion that turns {', '.join(repr(name) for name in (joint, *others))} through their ranges"
    return PHYSICAL_EFFECTS[effect].settled_by
