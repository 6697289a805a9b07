"""Simulations of written models: the model with the gap workflow's findings, and any model under recorded commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.disk import write_text
from geomid_ros.files.models.effects_file import combined, write_sidecar
from geomid_ros.files.models.estimate_file import by_channel
from geomid_ros.files.models.mjcf import mjcf, mjcf_shapes
from geomid_ros.files.models.readers import URDF, with_same_files
from geomid_ros.files.models.written_model import (
    EFFECTS_FILE,
    ModelFiles,
    WrittenModel,
    with_shifted_parameters,
    write_model,
    written_model,
)
from geomid_ros.gap.result import Finding, GapResult
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import IdentifiedEffect, KnownEffect
from geomid_ros.model.samples import Samples
from geomid_ros.resimulation.resimulate import (
    NotSimulatedError,
    ResidualNoise,
    Resimulated,
    Tracking,
    resimulate,
    resimulate_closed_loop,
    tracking,
)
from geomid_ros.session.gap import GapReader, Identified
from geomid_ros.session.recordings import Bags
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import JOINT_STATES, message_type
from geomid_ros.types import FloatArray, IntArray

_NO_MUJOCO = "MuJoCo is not installed (pip install mujoco)"


def write_found(
    folder: Path, session: Session, result: GapResult, reader: str = URDF, identified: Identified | None = None
) -> list[Path]:
    """Write the session's model, or what was ``identified`` without one, with the findings into ``folder``; the sidecar
    is that of one ``reader``.

    Returns:
        The files: estimate.json, identified.urdf, identified.xml (MJCF) and effects.yaml.
    """
    refitted = session.loaded.refitted(session.model, result.coefficients, result.beside)
    noise = {"floor": by_channel(result.channels, result.corrected_floor), "cutoff": result.cutoff}
    effects = [*(e for e in refitted.effects if not e.is_payload), *result.added]
    after = dict(zip(session.model.body_names, result.inertias, strict=True))
    fitted = _fitted_models(session, identified, result, after)
    shapes = mjcf_shapes(session.urdf, Path(session.source))
    files = {"folded": result.folded, "fitted": fitted, "reader": reader, "shapes": shapes}
    written = _write(folder, session, result.inertias, effects, noise=noise, **files)
    if identified is not None and (file := fitted.get(with_same_files(reader))) is not None:
        known = combined(effects)
        write_sidecar(folder / EFFECTS_FILE, session.robot.name, known, [_in_file(file, each) for each in known])
    return written


def _in_file(file: WrittenModel, effect: KnownEffect) -> KnownEffect:
    """Effect with the values that a ``file`` has of it, if any."""
    own = next((e for e in file.effects if (e.effect, e.location) == (effect.effect, effect.location)), effect)
    return replace(effect, parameters={name: own.parameters.get(name, q) for name, q in effect.parameters.items()})


def _changed(
    file: WrittenModel,
    before: Mapping[str, FloatArray],
    after: Mapping[str, FloatArray],
    sure: Sequence[Finding],
    folded: Mapping[tuple[str, str], float] = MappingProxyType({}),
) -> WrittenModel:
    """Apply the changes of the full model, with ``sure`` findings and newly ``folded`` ones, to the model of a
    ``file``."""
    effects = {(effect.effect, effect.joint): effect for effect in file.effects}
    findings = []
    for finding in sure:
        previous = effects.pop((finding.effect, finding.joint), None) if finding.was else None
        before_it = previous.parameters if previous else {}
        shifts = {name: before_it[name].value - was for name, was in finding.was.items() if name in before_it}
        findings.append(with_shifted_parameters(finding, shifts))
    return WrittenModel(_shifted(file, before, after), tuple(combined([*effects.values(), *findings])), folded)


def _shifted(
    file: WrittenModel, before: Mapping[str, FloatArray], after: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Inertias of a file's model, changed as those of the full model. A link that cannot be lighter by the difference,
    as the file has a part of it elsewhere, gets the full inertia."""
    inertias = {}
    for name, inertia in after.items():
        changed = file.inertias.get(name, before[name]) + (inertia - before[name])
        inertias[name] = changed if pseudo_inertia.is_body(changed) else inertia
    return inertias


def _fitted_models(
    session: Session, identified: Identified | None, result: GapResult, after: Mapping[str, FloatArray]
) -> dict[str, WrittenModel]:
    """Models of descriptions, fitted within the limits of each, by reader: those of the session's model with the
    findings, or those ``identified`` without one, with sure payloads. None of the latter if anything else is sure that
    ``identify`` cannot find, as its effects absorb that. The full model's links are those ``after`` the workflow."""
    if identified is None:
        before = dict(zip(session.model.body_names, nominal_inertias(session), strict=True))
        given = session.loaded.fitted_models
        return {name: _changed(model, before, after, result.sure, result.newly_folded) for name, model in given.items()}
    others = [effect for effect in result.added if not issubclass(effect.cls, IdentifiedEffect)]
    if not all(effect.is_payload for effect in others):
        return {}
    estimate = identified.estimate
    links = {link.name: link.parameters for link in estimate.links} if others else after
    models = {reader: written_model(identified.session.model, estimate, reader) for reader in estimate.within}
    return {
        reader: WrittenModel(_shifted(model, links, after), tuple(combined([*model.effects, *others])))
        for reader, model in models.items()
    }


def nominal_inertias(session: Session) -> FloatArray:
    """Inertias of the identified bodies before ``(bodies, 10)``: the earlier estimate's, or else the URDF's."""
    return session.known_parameters[: len(session.model.nominal_inertias)].reshape(-1, 10)


def without_findings(session: Session, result: GapResult, held_out: Sequence[Samples]) -> FloatArray:
    """Prediction ``(N, channels)`` of the final model without any finding, at the samples of the result's trace."""
    samples = Samples.concatenate(list(held_out))
    order = np.argsort(samples.stamps, kind="stable")
    chosen = samples.select(order[np.searchsorted(samples.stamps, result.trace.stamps, sorter=order)])
    parameters = np.concatenate([result.inertias.ravel(), np.nan_to_num(result.coefficients)])
    return session.model.predict(chosen, parameters)[1]


def simulate_again(
    session: Session, result: GapResult, sharp: Sequence[Samples], commands: Sequence[Samples], cutoff: float
) -> tuple[list[Resimulated], str]:
    """Simulate held-out recordings from the written models, before and after the findings.

    Known errors of the sensors are corrected in the samples, so they are not in these models.

    Args:
        session: the model before.
        result: the findings.
        sharp: held-out samples with a high cutoff, one element per recording.
        commands: the joints' set-points in them, to simulate in closed loop as well; or nothing.
        cutoff: low-pass [Hz] of the samples that the result is from.

    Returns:
        The simulations that were possible, short windows first, and the reasons why others are missing.
    """
    if find_spec("mujoco") is None:
        return [], _NO_MUJOCO
    loaded = session.loaded
    fitted = loaded.refitted(session.model, result.coefficients, result.beside)
    with TemporaryDirectory() as folder:
        before, after = Path(folder) / "before", Path(folder) / "after"
        _write(before, session, nominal_inertias(session), loaded.effects_in_samples)
        _write(after, session, result.inertias, [*fitted.effects_in_samples, *result.added])
        robots, noise = (session.model, ModelFiles.of(before), ModelFiles.of(after)), ResidualNoise.of(result)
        simulations = [("", partial(resimulate, *robots, sharp, noise))]
        if commands:
            loop = partial(resimulate_closed_loop, *robots, sharp, commands, noise=noise, cutoff=cutoff)
            simulations.append(("in closed loop, ", loop))
        simulated, reasons = list[Resimulated](), list[str]()
        for prefix, simulate in simulations:
            try:
                simulated.append(simulate())
            except NotSimulatedError as reason:
                reasons.append(f"{prefix}{reason}")
            except InputError as error:  # the findings are worth more than their simulation
                return [], str(error)
    return simulated, "; ".join(reasons)


def _write(
    folder: Path, session: Session, inertias: FloatArray, effects: Sequence[KnownEffect], **further: Any
) -> list[Path]:
    by_name = dict(zip(session.model.body_names, inertias, strict=True))
    gravity, findings = session.configuration.gravity, session.review.findings
    return write_model(folder, session.model, session.urdf, by_name, effects, gravity, findings=findings, **further)


_OPTION = "--command"


def tracking_of(session: Session, written: WrittenModel, bags: Bags, topic: str) -> Tracking:
    """Simulate held-out data in MuJoCo, from a written model and the commands on a ``topic``.

    Raises:
        InputError: MuJoCo is not installed, nothing is held out, or the topic cannot be read.
    """
    if find_spec("mujoco") is None:
        raise InputError(f"{_OPTION} simulates in MuJoCo, which is not installed (pip install mujoco)")
    if not bags.holds_out:
        raise InputError(f"{_OPTION} simulates held-out data, but none are held out: use --hold-out or --validate")
    paths = [path for path, share in bags.held_out_fractions if share > 0.0]
    sharp = GapReader(session, bags).high_cutoff_samples()
    pairs = [_commanded(session, path, topic, samples) for path, samples in zip(paths, sharp, strict=True)]
    with TemporaryDirectory() as name:
        folder, gravity = Path(name), session.configuration.gravity
        files = ModelFiles(folder / "written.xml", folder / "effects.yaml")
        write_text(files.mjcf, mjcf(session.robot, written.inertias, written.effects, gravity=gravity))
        write_sidecar(folder / "effects.yaml", session.robot.name, written.effects)
        return tracking(session.model, files, *(list(column) for column in zip(*pairs, strict=True)))


def _commanded(session: Session, path: Path, topic: str, samples: Samples) -> tuple[Samples, Samples]:
    """Samples of a recording, and the set-points in force at them: a command holds until the next one."""
    stamps, setpoints = _setpoints(session.robot.joint_names, path, topic)
    last = np.searchsorted(stamps, samples.stamps, side="right") - 1
    commanded = samples.select(np.flatnonzero(last >= 0))
    position, velocity, effort = setpoints[last[last >= 0]].swapaxes(0, 1)
    return commanded, replace(commanded, position=position, velocity=velocity, effort=effort)


def _setpoints(joints: Sequence[str], path: Path, topic: str) -> tuple[IntArray, FloatArray]:
    """Stamps ``(N,)`` [ns] of the commands on a topic, and the joints' set-points ``(N, 3, J)`` of position, velocity
    and effort, zero where a command has none."""
    stamps, setpoints = list[int](), list[FloatArray]()
    with Bag(path) as bag:
        name = bag.find_topic(topic, message_type(JOINT_STATES), _OPTION)
        for _, _, message in bag.messages([name]):
            names = list(message.name)
            if missing := [joint for joint in joints if joint not in names]:
                raise InputError(f"{path}: {name} commands no joint '{missing[0]}'; it has {', '.join(names)}")
            order, zeros = [names.index(joint) for joint in joints], np.zeros(len(names))
            fields = (message.position, message.velocity, message.effort)
            setpoints.append(np.array([values if len(values) == len(names) else zeros for values in fields])[:, order])
            stamps.append(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)
    return np.array(stamps, dtype=np.int64), np.array(setpoints).reshape(-1, 3, len(joints))
