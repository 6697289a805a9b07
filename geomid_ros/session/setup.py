"""Setup of a robot from description and configuration: its model, and the pipeline from messages to samples."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from geomid_ros.files.models.effects_file import tilted_gravity
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.model.columns import Column
from geomid_ros.model.controller import PDController
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.moving_base import ImuMount
from geomid_ros.model.robot import Robot
from geomid_ros.model.urdf_tree import parse
from geomid_ros.session.configuration import Configuration, naming
from geomid_ros.signals.ledger import Ledger
from geomid_ros.signals.messages import COMMANDS, IMU, JOINT_STATES, ODOM, AcceptedMessages
from geomid_ros.signals.pipeline import SignalPipeline, ignore
from geomid_ros.signals.settings import ACCELEROMETER_BIAS, SignalSettings
from geomid_ros.signals.unitree import UnitreeMessages
from geomid_ros.types import FloatArray

LIGHT = 0.1
"""Fraction of a mass that is negligible."""


class Setup:
    """A robot, its model and its signals, as defined by description, configuration and an earlier model."""

    def __init__(self, urdf: str, configuration: Configuration, source: str, loaded: LoadedModel | None = None) -> None:
        """Build the model.

        Args:
            urdf: text of the robot description.
            configuration: parameters.
            source: origin of the description, for messages.
            loaded: the model to start from; that of the configuration unless given.

        Raises:
            InputError: these do not fit together.
        """
        self.urdf = urdf
        self.source = source
        self.configuration = configuration
        self.loaded = loaded or LoadedModel.read(configuration["model"])
        sensors = self.loaded.corrected_sensors(configuration.sensors)
        self._sensors = sensors
        locked = self.loaded.locked_joints(parse(urdf, source)) if self.loaded.merged else ()
        self.locked_joints = tuple(dict.fromkeys([*configuration["locked_joints"], *locked]))
        """Joints fixed at zero: those of the configuration, and those that were locked when the model was
        identified."""
        self.robot = self.read_robot(urdf, source)
        gains, delay = configuration.gains, configuration["command.delay"]
        key = f"{configuration.source}: command.gains"
        self.controller = naming(key, PDController.of, gains, self.robot.joint_names, delay)
        """Controller from which efforts are computed; None if they are measured."""
        effects = configuration.effects
        model = MeasurementModel(
            self.robot,
            effects,
            sensors,
            configuration["links"] or None,
            self.loaded.local_effects(effects),
            candidates=configuration.candidates,
            link_side_joints=configuration.behind_gear([joint.name for joint in self.robot.tree.joints]),
            contacts=configuration.contacts,
            commanded=self.controller is not None,
        )
        self.model = model.with_known_loads(self.loaded.parameters(model))
        self.received_joints: set[str] = set()
        """Names of joints in all messages so far."""

    def unitree(self) -> UnitreeMessages:
        """Create a converter of a Unitree robot's messages. It raises InputError naming the fault of its ``motors``
        once there are such messages."""
        configuration = self.configuration
        return UnitreeMessages(configuration["motors"], self.robot.joint_names, self.controller, configuration.source)

    def read_robot(self, urdf: str, source: str) -> Robot:
        """Read a description with the same links and joints as this one's. Raises InputError naming the ``source``."""
        configuration = self.configuration
        return Robot(
            urdf,
            floating_base=configuration.floating_base,
            cuts=[sensor.frame for sensor in self._sensors if sensor.role == "mounted"],
            locked_joints=self.locked_joints,
            gravity=tilted_gravity(configuration.gravity, self.loaded.effects),
            source=source,
        )

    @property
    def prior(self) -> FloatArray | None:
        """Parameters ``(D,)`` of an earlier estimate to start from, NaN where it has none; None without one."""
        return self.loaded.parameters(self.model)

    @property
    def known_parameters(self) -> FloatArray:
        """Parameters ``(D,)`` of the model to start from: an earlier estimate's, or the URDF's where it has none."""
        nominal, prior = self.model.nominal_parameters, self.prior
        return nominal if prior is None else np.where(np.isnan(prior), nominal, prior)

    @property
    def lockable(self) -> tuple[str, ...]:
        """Joints that are in no message so far, as those of grippers, if all of them may count as fixed at zero.

        They may if nothing measured depends on their positions: distal to them are no joints in messages, no wrench
        sensors, and at most a tenth of the moving mass. An unknown name in a message may be that of a joint that seems
        to be missing: then nothing is locked.
        """
        robot, received = self.robot, frozenset(self.received_joints)
        absent = [joint for joint in robot.joint_names if joint not in received]
        unknown = received.difference(joint.name for joint in robot.tree.joints)
        if len(absent) == len(robot.joint_names) or unknown:
            return ()
        follow = {f.joint.name: robot.joint_names[f.master] for f in robot.mimic_joints}
        child = {joint.name: joint.child for joint in robot.tree.joints}
        locked = [joint for joint in (*robot.joint_names, *follow) if follow.get(joint, joint) in absent]
        measured = [joint for joint in (*robot.joint_names, *follow) if joint not in locked]
        distal = {link for joint in locked for link in robot.tree.subtree(child[joint])}
        if distal & {*(sensor.frame for sensor in self.model.sensors), *(child[joint] for joint in measured)}:
            return ()
        moving = {link for joint in measured for link in robot.tree.subtree(child[joint])}
        moving = set(robot.tree.links) if robot.floating_base else moving
        masses = {link: float(parameters[0]) for link, parameters in robot.tree.inertials.items() if link in moving}
        light = sum(masses[link] for link in distal & masses.keys()) <= LIGHT * sum(masses.values())
        return tuple(absent) if light else ()

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics on which data are expected, by the pipeline's names."""
        base = (self.base_topic,) if self.robot.floating_base else ()
        commands = () if self.controller is None else (COMMANDS,)
        return (JOINT_STATES, *commands, *base, *(sensor.topic for sensor in self.model.sensors))

    @property
    def meaning(self) -> dict[str, Any]:
        """Everything that the rows depend on, by name, as JSON. Rows of two sessions may be added up if these agree."""
        loaded, joints = self.loaded, self.robot.joint_names
        signals = loaded.corrected_signals(SignalSettings(), joints)
        corrections = {
            "effort_gain": signals.effort_gain,
            "effort_delay": signals.effort_delay,
            "wrench_offsets": [list(sensor.offset) for sensor in self.model.sensors],
            "gravity": self.robot.gravity.tolist(),
            "effects": [[c.effect.name, c.place_name, vars(c.effect)] for c in self.model.coefficients],
        }
        urdf = hashlib.sha256(self.urdf.encode(errors="replace")).hexdigest()
        parameters = {**self.configuration.row_parameters, "locked_joints": [*self.locked_joints]}
        return {"robot_description": urdf, **parameters, "model": corrections}

    @property
    def effort_gains(self) -> FloatArray:
        """Factors ``(joints,)`` from the messages' efforts to N m (or N), including known sensor gains."""
        return self.signals.effort_gains(self.robot.joint_names)

    @property
    def signals(self) -> SignalSettings:
        """The configuration's settings, including what is known of the sensors."""
        joints = self.robot.joint_names
        return self.loaded.corrected_signals(self.configuration.signals(joints), joints)

    def new_pipeline(
        self,
        cutoff: float | None = None,
        effect_columns: tuple[Column, ...] | None = None,
        on_accepted: Callable[[AcceptedMessages], None] = ignore,
        ledger: Ledger | None = None,
    ) -> SignalPipeline:
        """Create a pipeline for another recording of the same robot.

        Args:
            cutoff: cutoff of the low-pass [Hz]; the configuration's, unless given.
            effect_columns: the columns to compute; those of the model's effects, unless given.
            on_accepted: called with every accepted message.
            ledger: counts what becomes of each message.
        """
        return SignalPipeline(
            self.model,
            replace(self.signals, cutoff=cutoff) if cutoff else self.signals,
            effect_columns=effect_columns,
            on_accepted=on_accepted,
            ledger=ledger,
            received_joints=self.received_joints,
            locked_joints=self.locked_joints,
            still_distance=self.configuration["still_distance"],
            mount=self._imu_mount,
            controller=self.controller,
        )

    @property
    def base_topic(self) -> str:
        """Topic of a floating base's motion, by the pipeline's name."""
        return IMU if self.configuration["imu.frame"] else ODOM

    @property
    def relative_mass_std(self) -> float:
        """Standard deviation of the relative difference in total mass between two recordings, as the bias of an
        accelerometer along gravity is mistaken for it. Zero without an IMU."""
        gravity = float(np.linalg.norm(self.robot.gravity))
        return np.sqrt(2.0) * ACCELEROMETER_BIAS / gravity if self.base_topic == IMU else 0.0

    @property
    def _imu_mount(self) -> ImuMount | None:
        """Placement of the IMU. Raises InputError if it is not on the base."""
        frame = self.configuration["imu.frame"]
        if not frame:
            return None
        placement = naming(f"{self.configuration.source}: imu.frame", self.robot.base_placement, frame)
        return ImuMount(placement[:3, :3], placement[:3, 3], self.robot.gravity)
