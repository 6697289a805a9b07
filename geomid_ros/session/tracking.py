"""A written model under the commands of the recordings that it is judged on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.disk import write_text
from geomid_ros.files.models.gap_model import ModelFiles
from geomid_ros.files.models.handover import WrittenModel
from geomid_ros.files.models.mjcf import mjcf
from geomid_ros.files.models.sidecar import write_sidecar
from geomid_ros.model.samples import Samples
from geomid_ros.resimulation.closed_loop import Tracking, tracking
from geomid_ros.session.gap import GapReader
from geomid_ros.session.recordings import Bags
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import JOINT_STATES, message_type
from geomid_ros.types import FloatArray, IntArray

_OPTION = "--command"


def tracking_of(session: Session, written: WrittenModel, bags: Bags, topic: str) -> Tracking:
    """Simulate what is judged on in MuJoCo, from a written model and the commands on a ``topic``.

    Raises:
        InputError: MuJoCo is not installed, nothing is held out, or the topic cannot be read.
    """
    if find_spec("mujoco") is None:
        raise InputError(f"{_OPTION} simulates in MuJoCo, which is not installed (pip install mujoco)")
    if not bags.holds_out:
        raise InputError(f"{_OPTION} simulates what is held out, and nothing is: use --hold-out or --validate")
    paths = [path for path, share in bags.shares if share > 0.0]
    sharp = GapReader(session, bags).sharp()
    pairs = [_commanded(session, path, topic, samples) for path, samples in zip(paths, sharp, strict=True)]
    with TemporaryDirectory() as name:
        folder, gravity = Path(name), session.configuration.gravity
        files = ModelFiles(folder / "written.xml", folder / "effects.yaml")
        write_text(files.mjcf, mjcf(session.robot, written.inertias, written.effects, gravity=gravity))
        write_sidecar(folder / "effects.yaml", session.robot.name, written.effects)
        return tracking(session.model, files, *(list(each) for each in zip(*pairs, strict=True)))


def _commanded(session: Session, path: Path, topic: str, samples: Samples) -> tuple[Samples, Samples]:
    """Samples of a recording, and the set-points that held then: a command holds until the next one comes."""
    stamps, setpoints = _setpoints(session.robot.joint_names, path, topic)
    held = np.searchsorted(stamps, samples.stamps, side="right") - 1
    known = samples.select(np.flatnonzero(held >= 0))
    position, velocity, effort = setpoints[held[held >= 0]].swapaxes(0, 1)
    return known, replace(known, position=position, velocity=velocity, effort=effort)


def _setpoints(joints: Sequence[str], path: Path, topic: str) -> tuple[IntArray, FloatArray]:
    """Stamps ``(N,)`` [ns] of the commands on a topic, and the joints' set-points ``(N, 3, J)`` of position, velocity
    and effort, zero where a command says none."""
    stamps, setpoints = list[int](), list[FloatArray]()
    with Bag(path) as bag:
        found = bag.find_topic(topic, message_type(JOINT_STATES), _OPTION)
        for _, _, message in bag.messages([found]):
            names = list(message.name)
            if missing := [joint for joint in joints if joint not in names]:
                raise InputError(f"{path}: {found} commands no joint '{missing[0]}'; it has {', '.join(names)}")
            order, none = [names.index(joint) for joint in joints], np.zeros(len(names))
            said = (message.position, message.velocity, message.effort)
            setpoints.append(np.array([own if len(own) == len(names) else none for own in said])[:, order])
            stamps.append(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)
    return np.array(stamps, dtype=np.int64), np.array(setpoints).reshape(-1, 3, len(joints))
