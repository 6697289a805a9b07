"""Linear measurement model: turns samples into rows ``a . parameters = b``, one per channel and sample.

A channel is one measured number: a joint's effort or one axis of a wrench sensor. The parameters are those of
:class:`~geomid_ros.geometry.manifold.ParameterManifold`: ten per identified body, then the effects' positive
coefficients, then the real ones.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import chain
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin

from geomid_ros.errors import InputError, check_name
from geomid_ros.geometry.manifold import ParameterManifold
from geomid_ros.model.channels import AXES, BASE, WORLD_FRAMES, Channel, ChannelLayout, WrenchSensor
from geomid_ros.model.coefficients import Coefficient, EffectPlaces, Mechanism
from geomid_ros.model.effects import (
    AtSensor,
    GravityEffect,
    IdentifiedEffect,
    LoadEffect,
    MotionEffect,
    Place,
    SensorEffect,
    joint_of,
    joints_of,
)
from geomid_ros.model.moving_base import Contact, Legs
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import (
    REST,
    SIGN,
    SMOOTH_SIGN,
    Column,
    Entries,
    Samples,
    affected_joints,
    column_of,
)
from geomid_ros.types import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of N samples: ``coefficients (N, channels, D)``, ``targets (N, channels)``, NaN where not measured."""

    coefficients: FloatArray
    targets: FloatArray


def slides(robot: Robot, place: Place) -> bool:
    """True if a joint of a place slides: its speeds are in m/s."""
    return any(robot.joints[joint].unit == "N" for joint in joints_of(place))


class MeasurementModel:
    """The unknown parameters, the measured channels, and the linear rows that relate them."""

    def __init__(
        self,
        robot: Robot,
        effects: Sequence[IdentifiedEffect],
        sensors: Sequence[WrenchSensor] = (),
        links: Sequence[str] | None = None,
        local_effects: Mapping[str, Sequence[IdentifiedEffect]] = MappingProxyType({}),
        candidates: Sequence[IdentifiedEffect] = (),
        link_side_joints: Collection[str] = (),
        contacts: Sequence[Contact] = (),
        commanded: bool = False,
    ) -> None:
        """Build the model of a robot.

        Args:
            robot: its bodies and joints.
            effects: effects that act at every place of their kind.
            sensors: wrench sensors.
            links: bodies to identify (default all); the others keep the URDF's inertia.
            local_effects: effects that act at one place only, by the name of the place.
            candidates: effects that may act at every default place of their kind without a local effect of that name.
            link_side_joints: names of the joints with effort sensors on the link side of the gear, unaffected by the
                motor.
            contacts: feet of a floating base; ground forces follow from the efforts of their legs.
            commanded: True if efforts are computed from commands, which may act late.

        Raises:
            InputError: if a link or sensor does not fit the robot, or no measured channel can be predicted.
        """
        self.robot = robot
        self.sensors = tuple(sensors)
        self.mounted = [sensor for sensor in sensors if sensor.role == "mounted"]
        """Sensors inside the chain, in the order of their channels."""
        self.external = [sensor for sensor in sensors if sensor.role == "external"]
        """Sensors of the loads that the surroundings put on the robot."""
        self.identified = self._identified_bodies(links)
        self.body_names = tuple(robot.bodies[index].name for index in self.identified)
        """Names of the identified bodies."""
        self.gear_inertias = np.array([body.parameters for body in robot.bodies])
        """Parameters of all bodies ``(bodies, 10)`` from which gear loads are computed: the URDF's, or known ones."""
        self.legs = Legs(robot, contacts) if contacts else None
        """Legs, if ground forces are computed from their efforts; else None."""
        self._check_sensors()
        joints, base = len(robot.joints) if self._efforts_usable else 0, len(AXES) if self.legs else 0
        every, summed = list(range(len(robot.bodies))), self.external[:1] if robot.floating_base else []
        # Sensors with rows, and the bodies that load each. The first external sensor stands for the sum of all.
        self._loaded = [(s, robot.subtree(s.frame)) for s in self.mounted] + [(s, every) for s in summed]
        with_rows = [sensor for sensor, _ in self._loaded]
        self.layout = ChannelLayout.of(joints, with_rows, base)
        self.places = EffectPlaces(
            robot=robot, links=self.body_names, sensors=with_rows, layout=self.layout, commanded=commanded
        )
        self.coefficients = self.places.coefficients(effects, local_effects, candidates, link_side_joints)
        self._number()
        self.drive_gains = np.ones(len(self.channels))
        """Factors ``(channels,)`` with which the efforts of the links are measured."""
        if not self.channels:
            raise InputError(
                "no measured channel can be predicted: joint efforts need every external wrench sensor to be on a "
                "link and to measure all six axes; a floating base needs --contacts, the feet on the ground, or at "
                "least one wrench sensor of role external (a force plate, or sensors on all that touches the ground)"
            )

    def _identified_bodies(self, links: Sequence[str] | None) -> tuple[int, ...]:
        names = self.robot.body_names
        for link in links or ():
            check_name("link", link, names)
        return tuple(index for index, name in enumerate(names) if links is None or name in links)

    def _check_sensors(self) -> None:
        frames = (*self.robot.tree.links, *(WORLD_FRAMES if self.robot.floating_base else ()))
        for sensor in self.sensors:
            if sensor.role == "mounted":
                self._check_mounted(sensor)
            else:
                check_name("frame of an external wrench", sensor.frame, frames)
        topics = [sensor.topic for sensor in self.sensors]
        if len(set(topics)) < len(topics):
            raise InputError(f"two wrench sensors have the same topic: {', '.join(topics)}")
        external = self.external
        if external and self.legs:
            raise InputError(
                f"contacts and an external wrench sensor, '{external[0].topic}', exclude each other: ground reaction "
                "forces are either computed from efforts or measured; remove one"
            )
        if len(external) > 1 and any(len(sensor.axes) < 6 for sensor in external):
            raise InputError(
                "with several external wrench sensors, each must measure all six axes: their wrenches are summed"
            )

    def _check_mounted(self, sensor: WrenchSensor) -> None:
        check_name("frame of a mounted wrench sensor", sensor.frame, self.robot.tree.links)
        if not self.robot.is_divided_at(sensor.frame):
            raise InputError(
                f"a wrench sensor is mounted at link '{sensor.frame}', where the robot's bodies are not divided; add "
                "this link to `cuts`"
            )
        if not self.robot.subtree(sensor.frame):
            raise InputError(
                f"the wrench sensor mounted at link '{sensor.frame}' has no mass distal to it: neither this link nor "
                "its subtree has a mass in the URDF"
            )

    @property
    def _efforts_usable(self) -> bool:
        """True if all external loads on the joints are known. They are not with a force plate, whose load acts on an
        unknown link, nor with a floating base that has neither sensors nor contacts."""
        on_robot = all(s.frame in self.robot.tree.links and len(s.axes) == 6 for s in self.external)
        return on_robot and (not self.robot.floating_base or bool(self.external) or self.legs is not None)

    def without_effects(self) -> MeasurementModel:
        """Return a model with the same channels and bodies, but no effects."""
        return self.with_coefficients(())

    def with_gravity(self, gravity: FloatArray) -> MeasurementModel:
        """Return the model under another ``gravity (3,)`` in the base frame [m/s^2]."""
        robot = self.robot.with_gravity(gravity)
        return self._replaced(robot=robot, legs=self.legs and Legs(robot, self.legs.contacts, self.legs.efforts))

    def with_known_loads(self, known: FloatArray | None) -> MeasurementModel:
        """Return the model with gear loads from the links of ``known (D,)`` parameters, the URDF's where NaN, and with
        ground forces beside the effects of joints."""
        if known is None:
            return self
        first, loading = 10 * len(self.identified), self.gear_inertias.copy()
        inertias = np.where(np.isfinite(known[:first]), known[:first], self.nominal_inertias)
        loading[list(self.identified)] = inertias.reshape(-1, 10)
        efforts = partial(self._motion_efforts, np.nan_to_num(known[first:]))
        legs = self.legs and Legs(self.robot, self.legs.contacts, efforts)
        return self._replaced(gear_inertias=loading, legs=legs)

    def _motion_efforts(self, coefficients: FloatArray, samples: Samples) -> FloatArray:
        """Joint efforts ``(N, joints)`` of the effects that depend on the motion alone."""
        entries, joints, parameters, indices = self._of_motion
        values = coefficients[parameters - 10 * len(self.identified)] * samples.values_of(entries)[:, indices]
        efforts = np.zeros(samples.effort.shape)
        np.add.at(efforts.T, joints, values.T)
        return efforts

    def with_drive_gains(self, gains: FloatArray) -> MeasurementModel:
        """Return the model in which the efforts of the links are measured ``gains (channels,)`` times what they are in
        this one."""
        return self._replaced(drive_gains=self.drive_gains * gains)

    def with_payload(self, link: str) -> MeasurementModel:
        """Return the model with a payload as its last body, fixed to the identified ``link`` and in its frame."""
        return self._replaced(
            identified=(*self.identified, self.identified[self.body_names.index(link)]),
            body_names=(*self.body_names, f"payload of {link}"),
        )

    def with_coefficients(self, chosen: Sequence[int]) -> MeasurementModel:
        """Return the model with only the ``chosen`` coefficients, by index."""
        return self._replaced(coefficients=tuple(self.coefficients[index] for index in chosen))

    def _replaced(self, **changes: Any) -> MeasurementModel:
        """Return a copy with changed attributes and everything that depends on them recomputed."""
        model = object.__new__(MeasurementModel)
        cached = {name for name, value in vars(MeasurementModel).items() if isinstance(value, cached_property)}
        vars(model).update({name: value for name, value in vars(self).items() if name not in cached} | changes)
        model._number()
        return model

    def _number(self) -> None:
        """Count the parameters and list those that each channel depends on."""
        self.positives = sum(coefficient.positive for coefficient in self.coefficients)
        """Number of positive effect coefficients; they come first."""
        first = 10 * len(self.identified)
        self.dimension = first + len(self.coefficients)
        """Number of parameters D."""
        self._numbered = list(enumerate(self.coefficients, first))
        self._reach = {c.mechanism: self._reached(c.effect, c.place) for c in self.coefficients}
        self.channels = tuple(self._channels())
        """Channels in the order of :attr:`layout`."""

    @property
    def nominal_inertias(self) -> FloatArray:
        """URDF parameters of the identified bodies, ``(10 bodies,)``."""
        return np.array([self.robot.bodies[index].parameters for index in self.identified]).ravel()

    @property
    def unidentified_mass(self) -> float:
        """URDF mass of all links that are not identified, fixed ones included [kg]."""
        every = sum(float(parameters[0]) for parameters in self.robot.tree.inertials.values())
        return every - float(np.sum(self.nominal_inertias[::10]))

    @property
    def nominal_parameters(self) -> FloatArray:
        """Nominal parameters ``(D,)``: the URDF's inertias and no effects."""
        return np.append(self.nominal_inertias, np.zeros(len(self.coefficients)))

    @cached_property
    def usual_shapes(self) -> dict[Mechanism, int]:
        """Index among the D parameters of each mechanism. Of several instances of an effect it is that of the one that
        acts everywhere, the first; if all are candidates, that of the middle of their grid, which is nearest to all."""
        instances: dict[Mechanism, list[tuple[int, Coefficient]]] = {}
        for parameter, coefficient in self._numbered:
            instances.setdefault(coefficient.mechanism, []).append((parameter, coefficient))
        return {
            mechanism: several[(len(several) - 1) // 2 if several[0][1].optional else 0][0]
            for mechanism, several in instances.items()
        }

    @cached_property
    def described_shapes(self) -> dict[Mechanism, int]:
        """Index among the D parameters of each mechanism in the shape that a robot description means: the usual one;
        the sharpest for sliding joints, whose speeds may be no larger than the usual one's smoothing."""
        sharpest: dict[Mechanism, tuple[float, int]] = {}
        for parameter, c in self._numbered:
            if slides(self.robot, c.place) and c.effect.default_constant and not c.effect.constant:
                shape = float(getattr(c.effect, c.effect.default_constant)), parameter
                sharpest[c.mechanism] = min(shape, sharpest.get(c.mechanism, shape))
        return self.usual_shapes | {mechanism: parameter for mechanism, (_, parameter) in sharpest.items()}

    @property
    def described_coefficients(self) -> FloatArray:
        """Value of each coefficient in the URDF's ``<dynamics>`` ``(coefficients,)``; zero where there is none."""
        described = self.robot.described_dynamics
        return np.array(
            [described.get((c.place_name, c.effect.column_parameters[c.index].urdf), 0.0) for c in self.coefficients]
        )

    @property
    def described_parameters(self) -> FloatArray:
        """Parameters ``(D,)`` of the URDF: its inertias, and its ``<dynamics>`` as effects in the shape of these."""
        described = np.append(self.nominal_inertias, self.described_coefficients)
        held = [*range(len(self.nominal_inertias)), *self.described_shapes.values()]
        return np.where(np.isin(np.arange(self.dimension), held), described, 0.0)

    def manifold(self, scales: FloatArray) -> ParameterManifold:
        """Return the manifold of the parameters, with ``scales`` of the real coefficients."""
        return ParameterManifold(len(self.identified), self.positives, scales)

    def _reached(self, effect: IdentifiedEffect, place: Place) -> tuple[int, ...]:
        """Return the channels that an effect at a place affects."""
        if isinstance(place, AtSensor):
            return place.channels
        sensed = chain.from_iterable(self.layout.wrenches.values()) if effect.turns_gravity else ()
        return *affected_joints(place, len(self.layout.efforts)), *sensed

    def _columns(self, channel: int, bodies: Sequence[int]) -> IntArray:
        """Return the parameters that a channel depends on: those of ``bodies`` and of the effects that reach it."""
        columns = [10 * index + k for index, body in enumerate(self.identified) if body in bodies for k in range(10)]
        columns += [parameter for parameter, c in self._numbered if channel in self._reach[c.mechanism]]
        return np.array(columns, dtype=np.int64)

    def _channels(self) -> Iterator[Channel]:
        layout = self.layout
        for index, joint in zip(layout.efforts, self.robot.joints, strict=False):
            columns = self._columns(index, np.flatnonzero(self.robot.supports[index]).tolist())
            yield Channel(name=joint.name, unit=joint.unit, columns=columns, joint=index)
        for sensor, loaded in self._loaded:
            for index, axis in zip(layout.wrenches[sensor.topic], sensor.axes, strict=True):
                yield Channel.of_wrench(sensor.topic, axis, self._columns(index, loaded))
        for axis in AXES[: len(layout.base)]:
            yield Channel.of_wrench(BASE, axis, np.arange(self.dimension))

    def rows(self, samples: Samples) -> Rows:
        """Compute the rows of N samples."""
        coefficients = np.empty((len(samples), len(self.channels), self.dimension))
        targets = np.empty((len(samples), len(self.channels)))
        begin = 0
        for piece in samples.in_pieces():
            span = slice(begin, begin + len(piece))
            coefficients[span], targets[span] = self._rows(piece)
            begin = span.stop
        return Rows(coefficients, targets)

    def _rows(self, samples: Samples) -> tuple[FloatArray, FloatArray]:
        bodies = np.zeros((len(samples), len(self.channels), len(self.robot.bodies), 10))
        targets = np.empty((len(samples), len(self.channels)))
        wrenches = self._measured_wrenches(samples)
        motion, joints, base = self.robot.configuration(samples), len(self.layout.efforts), list(self.layout.base)
        if joints:
            by_efforts = [*self.layout.efforts, *base]
            bodies[:, by_efforts] = self.robot.joint_effort_rows(*motion, base=bool(base))
            targets[:, :joints] = samples.effort
            targets[:, base] = 0.0
        for index, (q, v, a) in enumerate(zip(*motion, strict=True) if self.sensors else ()):
            self.robot.update_motion(q, v, a)
            measured = dict(zip(self.sensors, wrenches[index], strict=False))
            if joints:
                efforts = (self.robot.frame_jacobian(q, s.frame).T @ measured[s] for s in self.external)
                targets[index, :joints] += sum(efforts, np.zeros(joints))
            self._fill_wrench_rows(measured, bodies[index], targets[index])
        coefficients, targets = self._assemble(samples, bodies, targets)
        if self.legs is not None:
            self.legs.eliminate(samples, np.array(base), coefficients, targets)
        return coefficients, targets

    def _measured_wrenches(self, samples: Samples) -> FloatArray:
        """Return wrenches ``(N, sensors, 6)`` with the sensors' signs applied, and zero on unmeasured axes."""
        wrenches = np.zeros(samples.wrenches.shape)
        for index, sensor in enumerate(self.sensors):
            wrenches[:, index, sensor.axis_indices] = sensor.sign * samples.wrenches[:, index, sensor.axis_indices]
        return wrenches

    def _fill_wrench_rows(
        self, measured: Mapping[WrenchSensor, FloatArray], bodies: FloatArray, targets: FloatArray
    ) -> None:
        """Fill in the rows ``(channels, bodies, 10)`` and targets ``(channels,)`` of the wrench sensors."""
        for sensor, loaded in self._loaded:
            channels, axes = self.layout.wrenches[sensor.topic], sensor.axis_indices
            wrench = self._total_external(measured) if sensor.role == "external" else measured[sensor]
            bodies[channels], targets[channels] = self.robot.wrench_rows(loaded, sensor.frame)[axes], wrench[axes]

    def _total_external(self, measured: Mapping[WrenchSensor, FloatArray]) -> FloatArray:
        """Sum the external wrenches in the frame of the first sensor, ``(6,)``."""
        first = self.robot.placement(self.external[0].frame)
        total = np.zeros(6)
        for sensor in self.external:
            move = first.actInv(self.robot.placement(sensor.frame)).toDualActionMatrix()
            total += move @ measured[sensor]
        return total

    def _assemble(self, samples: Samples, bodies: FloatArray, targets: FloatArray) -> tuple[FloatArray, FloatArray]:
        first = 10 * len(self.identified)
        coefficients = np.zeros((*targets.shape, self.dimension))
        coefficients[:, :, :first] = bodies[:, :, self.identified].reshape(*targets.shape, first)
        (scaled,) = np.nonzero(self.drive_gains != 1.0)
        coefficients[:, scaled, :first] *= self.drive_gains[scaled, None]
        for index in set(range(len(self.robot.bodies))).difference(self.identified):
            targets -= self.drive_gains * (bodies[:, :, index] @ self.robot.bodies[index].parameters)
        entries, channels, parameters, entry_indices = self._of_motion
        coefficients[:, channels, parameters] = samples.values_of(entries)[:, entry_indices]
        if self._of_loads:
            loads, signs = self._loads(samples, bodies), samples.column(SIGN)
            for parameter, effect, joint in self._of_loads:
                coefficients[:, joint, parameter] = effect.column(loads[:, joint], signs[:, joint])
        for of_gravity, places, numbers in self._of_gravity:
            directions = of_gravity.slopes(self.robot.gravity, np.zeros(of_gravity.count))[:, numbers]
            coefficients[:, :, places] = self._by_gravity(samples, directions)
        for of_sensor, axes, channels, (parameters, indices) in self._of_sensors:
            coefficients[:, channels, parameters] = of_sensor.columns(samples.motion, axes)[:, :, indices]
        return coefficients, targets

    def _loads(self, samples: Samples, bodies: FloatArray) -> FloatArray:
        """Compute gear loads ``(N, J)`` from the known bodies."""
        loads = np.einsum("njbk,bk->nj", bodies[:, self.layout.efforts], self.gear_inertias)
        return self.with_ground(samples, loads)

    def with_ground(self, samples: Samples, loads: FloatArray) -> FloatArray:
        """Return gear loads ``(N, J)``, given those without ground forces. For standing legs these are the measured
        efforts, because the ground loads them too; zero where efforts are not measured."""
        loads = loads.copy()
        for joints, stands in zip(self.legs.joints if self.legs else (), samples.standing.T, strict=False):
            loads[np.ix_(stands, joints)] = np.nan_to_num(samples.effort[np.ix_(stands, joints)])
        return loads

    @cached_property
    def _of_motion(self) -> tuple[Entries, IntArray, IntArray, IntArray]:
        """Entries of this model's columns, and three arrays ``(n,)``: the channel and the parameter where the rows hold
        an entry, and the index of that entry."""
        entries = Entries(self.columns, len(self.layout.efforts))
        indices = [
            (joint, parameter, entries.at(column_of(c.effect, c.place), joint))
            for parameter, c in self._numbered
            if isinstance(c.effect, MotionEffect)
            for joint in self._reached(c.effect, c.place)
        ]
        channels, parameters, entry_indices = np.array(indices, dtype=np.int64).reshape(-1, 3).T
        return entries, channels, parameters, entry_indices

    @cached_property
    def _of_loads(self) -> list[tuple[int, LoadEffect, int]]:
        """Parameter, effect and joint of each coefficient of load-dependent friction."""
        return [(p, c.effect, joint_of(c.place)) for p, c in self._numbered if isinstance(c.effect, LoadEffect)]

    def _by_gravity(self, samples: Samples, directions: FloatArray) -> FloatArray:
        """Compute the change of all channels ``(N, channels, k)`` per unit of gravity in ``directions (3, k)``, by the
        weight of the known bodies."""
        columns = np.zeros((len(samples), len(self.channels), directions.shape[1]))
        q, v, _ = self.robot.configuration(samples)
        columns[:, self.layout.efforts] = self.robot.efforts_by_gravity(*self._weighed, q, directions)
        for direction, column in zip(directions.T if self._loaded else (), np.moveaxis(columns, 2, 0), strict=False):
            robot = self.robot.with_gravity(direction)
            for configuration, channels in zip(q, column, strict=True):
                robot.update_motion(configuration, 0.0 * v[0], 0.0 * v[0])
                for sensor, loaded in self._loaded:
                    rows = robot.wrench_rows(loaded, sensor.frame)[sensor.axis_indices]
                    channels[self.layout.wrenches[sensor.topic]] = np.sum(rows * self.gear_inertias, axis=(1, 2))
        return columns * self.drive_gains[:, None]

    def gravity_at(self, parameters: FloatArray) -> FloatArray:
        """Gravity ``(3,)`` in the base frame [m/s^2] at parameters ``(D,)``."""
        gravity = self.robot.gravity
        for effect, places, indices in self._of_gravity:
            coefficients = np.zeros(effect.count)
            coefficients[indices] = parameters[places]
            gravity = effect.tilted_gravity(gravity, effect.values(coefficients))
        return gravity

    @cached_property
    def _weighed(self) -> tuple[pin.Model, pin.Data]:
        """Model and data of the robot with the known bodies."""
        model = self.robot.with_inertias(self.gear_inertias, range(len(self.gear_inertias)))
        return model, model.createData()

    @cached_property
    def _of_gravity(self) -> list[tuple[GravityEffect, IntArray, IntArray]]:
        """Each effect on gravity, with the parameters and the indices of its coefficients ``(k,)``."""
        numbers: dict[GravityEffect, list[tuple[int, int]]] = {}
        for parameter, c in self._numbered:
            if isinstance(c.effect, GravityEffect):
                numbers.setdefault(c.effect, []).append((parameter, c.index))
        return [(effect, *np.array(pairs).T) for effect, pairs in numbers.items()]

    @cached_property
    def _of_sensors(self) -> list[tuple[SensorEffect, list[str], IntArray, IntArray]]:
        """Each effect of a sensor: its axes, their channels ``(axes, 1)``, and parameters and indices ``(2, k)`` of its
        coefficients."""
        numbers: dict[tuple[SensorEffect, Place], list[tuple[int, int]]] = {}
        for parameter, c in self._numbered:
            if isinstance(c.effect, SensorEffect):
                numbers.setdefault((c.effect, c.place), []).append((parameter, c.index))
        return [
            (effect, self._axes(place), np.array(self._reached(effect, place))[:, None], np.array(pairs).T)
            for (effect, place), pairs in numbers.items()
        ]

    def _axes(self, place: Place) -> list[str]:
        """Return the axes of a place at a sensor."""
        return [self.channels[channel].axis for channel in place.channels] if isinstance(place, AtSensor) else []

    def columns_of(
        self, samples: Samples, effect: MotionEffect | SensorEffect, place: Place, index: int
    ) -> dict[int, FloatArray]:
        """Return the column ``(N,)`` of an effect's coefficient ``index`` in each channel that it reaches."""
        channels = self._reached(effect, place)
        if isinstance(effect, MotionEffect):
            efforts = samples.column(column_of(effect, place))
            return {channel: efforts[:, channel] for channel in channels}
        columns = effect.columns(samples.motion, self._axes(place))[:, :, index]
        return {channel: column for channel, column in zip(channels, columns.T, strict=True) if np.any(column)}

    def eliminate_ground(self, samples: Samples, columns: Iterable[dict[int, FloatArray]]) -> None:
        """Eliminate ground forces from ``columns``: subtract from the base's channels, in place, what the columns
        ``(N,)`` add to the joints of standing legs. :meth:`rows` does the same with its rows."""
        for joints, standing, onto_base in self.legs.standing(samples) if self.legs else ():
            for column in columns:
                for index in [index for index, joint in enumerate(joints) if joint in column]:
                    ground = np.zeros((len(samples), len(self.layout.base)))
                    ground[standing] = np.nan_to_num(onto_base[:, :, index]) * column[joints[index]][standing, None]
                    for channel, of_axis in zip(self.layout.base, ground.T, strict=True):
                        column[channel] = column.get(channel, 0.0) - of_axis

    def caused_by_efforts(self, samples: Samples, efforts: FloatArray) -> FloatArray:
        """Return what K cases of further joint ``efforts (N, joints, K)`` add to all channels ``(N, channels, K)``, the
        base's of standing legs included, from which :meth:`rows` eliminates ground forces."""
        added = np.zeros((len(samples), len(self.channels), efforts.shape[2]))
        added[:, self.layout.efforts] = efforts
        if self.legs is not None:
            self.legs.eliminate(samples, np.array(self.layout.base), added, np.zeros(added.shape[:2]))
        return added

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """Columns that samples must contain: those of the effects, and of the joints' direction and rest."""
        effect_columns = [column_of(c.effect, c.place) for c in self.coefficients if isinstance(c.effect, MotionEffect)]
        return tuple(dict.fromkeys([*effect_columns, *((SIGN, SMOOTH_SIGN, REST) if self.layout.efforts else ())]))

    def predict(
        self, samples: Samples, parameters: FloatArray, drive_gains: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return measured values ``(N, channels)`` and values predicted at parameters ``(D,)``; with several parameter
        vectors ``(D, K)``, predictions are ``(N, channels, K)``. ``drive_gains (channels,)`` or ``(channels, K)``:
        further factors of the identified links' efforts."""
        first = 10 * len(self.identified)
        (used,) = np.nonzero(np.any(np.atleast_2d(parameters.T), axis=0)[first:])
        model, parameters = self.with_coefficients(used.tolist()), parameters[[*range(first), *(first + used)]]
        # Rows are many times as large as their samples, so they are not computed all at once.
        measured, predicted = [], []
        for piece in samples.in_pieces():
            rows = model.rows(piece)
            measured.append(rows.targets)
            predicted.append(rows.coefficients @ parameters)
            if drive_gains is not None:
                predicted[-1] += (drive_gains - 1.0) * (rows.coefficients[:, :, :first] @ parameters[:first])
        return np.concatenate(measured), np.concatenate(predicted)

    def predicted_efforts(
        self, samples: Samples, parameters: FloatArray, drive_gains: FloatArray | None = None
    ) -> FloatArray:
        """Predict measured efforts ``(N, joints)``, including links that are not identified and measured external
        loads; NaN for joints whose effort is not measured. The arguments are those of :meth:`predict`."""
        measured, predicted = self.predict(samples, parameters, drive_gains)
        efforts = np.full(samples.effort.shape, np.nan)
        if self.layout.efforts:
            efforts[:] = samples.effort - (measured - predicted)[:, self.layout.efforts]
        return efforts
