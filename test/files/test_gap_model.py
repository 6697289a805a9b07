"""The files of a model that ``gap`` found."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import yaml

from geomid_ros.files.models.estimate_file import by_channel
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.files.models.written_model import write_model
from geomid_ros.model.effects import KnownEffect, Quantity
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.robot import Robot

from .recordings import BAGS

URDF = (BAGS / "arm3.urdf").read_text(encoding="utf-8")
MODEL = MeasurementModel(Robot(URDF), ())


def friction(effect: str, value: float, unit: str) -> KnownEffect:
    return KnownEffect(effect, "joint1", "", {"coefficient": Quantity(value, 0.01, unit)})


def test_files_that_cannot_say_a_friction_have_the_other_without_it(tmp_path: Path) -> None:
    effects = [
        friction("viscous_friction", 2.0, "N m s/rad"),
        friction("quadratic_friction", -0.5, "N m s^2/rad^2"),
    ]
    inertias = dict(zip(MODEL.body_names, MODEL.nominal_inertias.reshape(-1, 10), strict=True))
    noise = {"floor": by_channel(MODEL.robot.joint_names, np.array([0.1, 0.2, np.nan])), "cutoff": 8.0}
    folded = {("joint1", "dynamics/damping"): -0.4}
    gravity = MODEL.robot.gravity
    write_model(tmp_path, MODEL, URDF, inertias, effects, gravity, noise=noise, folded=folded)
    joint = ElementTree.parse(tmp_path / "identified.urdf").find("joint[@name='joint1']/dynamics")
    assert joint is not None
    assert float(joint.attrib["damping"]) == 1.6
    mjcf = ElementTree.parse(tmp_path / "identified.xml").find(".//joint[@name='joint1']")
    assert mjcf is not None
    assert float(mjcf.attrib["damping"]) == 1.6
    known = {e.effect: e.parameters["coefficient"].value for e in LoadedModel.read(f"{tmp_path}/estimate.json").effects}
    assert known == {"viscous_friction": 2.0, "quadratic_friction": -0.5}
    said = yaml.safe_load((tmp_path / "effects.yaml").read_text())["effects"]
    assert [entry.get("alone") for entry in said] == [{"coefficient": 1.6}, None]
    document = json.loads((tmp_path / "estimate.json").read_text())
    assert (document["floor"], document["cutoff"]) == ({"joint1": 0.1, "joint2": 0.2, "joint3": None}, 8.0)
