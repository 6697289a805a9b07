"""Options of a simulation with the units of every field, and requests for hidden effects as a user writes them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import IntEnum

import numpy as np

from geomid_ros.errors import InputError
from geomid_ros.options import Options, numbers_in, option

LONGEST_STEP = 1e-3
"""[s] Longest integration step: dry friction stops a joint within a few milliseconds."""
_STIFF_STEP = 2e-4  # [s] for a light rotor at an elastic gear
GEARS = ("joint_elasticity", "backlash")
"""Effects that add a second hinge behind a joint's motor."""
MOTIONS = ("sines", "aperiodic", "points", "chirp")
"""Kinds of motion."""


@dataclass(frozen=True)
class SimulationOptions(Options):
    """A robot, its hidden truth, its motion and its sensors. SI units; per joint rad and N m, or m and N if it slides.

    Attributes:
        duration: length of the recording [s].
        rate: messages per second [Hz].
        seed: random seed of the robot, its motion and the noise.
        realistic: simulate a realistic robot: friction with presliding, cogging, torque ripple, gains a few per cent
            off, encoder steps, stamp jitter, lost messages.
        motion_seed: random seed of another motion and noise of the same robot.
        motion: kind of motion; sines repeat every --period.
        motion_period: period of the slowest sine [s].
        inertia_error: relative error of the URDF's inertias.
        wrench_lag: delay of the wrench samples and stamps after the joints [s].
        commands: also record the controller's set-points on /joint_commands, and its gains.
        noise_time: time constant of coloured effort and wrench noise [s].
        position_step: resolution of positions [rad, m].
        effort_step: resolution of efforts, as a share of the effort limit.

    Robot:
        robot: a shipped robot's name, or the path of a ``.urdf`` file (the nominal model; it goes into the bag).
        Options that are ``drawn``, from the seed of a ``realistic`` robot, are refused for one, see ``realistic.py``.
        wrench_frame: link with a wrench sensor at its connection to its parent (``wrist_ft`` on the shipped robots);
            None records no ``/wrench``.
        inertia_error: approximate relative standard deviation of a link's mass. The bodies stay physically consistent
            whatever the size.

    True effects: those that ``hide`` requests, and no others. If it is None, every joint has friction, rotor inertia
    and offset, each drawn between 0.5 and 1.5 times the value described here.
        viscous_friction: effort at the joint's velocity limit, as a fraction of its effort limit.
        coulomb_friction: effort, as a fraction of the effort limit.
        rotor_inertia: time in which the bare rotor reaches its velocity limit at its effort limit [s].
        effort_offset: constant error of the measured effort, of either sign, as a fraction of the effort limit.

    Noise (standard deviations; Gaussian):
        position_noise [rad], velocity_noise [rad/s], effort_noise (fraction of the joint's effort limit),
        force_noise [N], torque_noise [N m]. Coloured noise is a first-order autoregression; with a noise_time of 0 it
        is white.

    Motion (faded in from rest):
        motion: ``sines`` (a sum of harmonics per joint, periodic), ``aperiodic`` (of frequencies without a common
        period), ``points`` (from point to point by trapezoids of speed) or ``chirp`` (one sine of rising frequency).
        motion_period: also twice the time from point to point. motion_harmonics: number
        of sines, the fastest at ``motion_harmonics / motion_period`` Hz. motion_range, motion_speed: largest excursion
        and speed as fractions of half the joint's range and of its velocity limit; the tighter limit applies.

    longest_step: upper bound of the integration step, at most 0.001 [s]; the step divides ``1 / rate``.
    """

    robot: str = "arm7"
    seed: int = option(1, min=0)
    realistic: bool = False
    motion_seed: int | None = option(min=0)

    duration: float = option(12.0, min=0.0, min_open=True)
    rate: float = option(100.0, min=0.0, min_open=True)
    wrench_frame: str | None = None
    wrench_lag: float = option(0.0, min=0.0)
    commands: bool = False

    inertia_error: float = option(0.2, min=0.0, drawn=True)

    hide: tuple[Hidden, ...] | None = None
    viscous_friction: float = option(0.03, min=0.0, drawn=True)
    coulomb_friction: float = option(0.02, min=0.0, drawn=True)
    rotor_inertia: float = option(0.002, min=0.0, drawn=True)
    effort_offset: float = option(0.005, min=0.0, drawn=True)

    position_noise: float = option(2e-5, min=0.0, drawn=True)
    velocity_noise: float = option(1e-3, min=0.0, drawn=True)
    effort_noise: float = option(2e-3, min=0.0, drawn=True)
    force_noise: float = option(0.1, min=0.0)
    torque_noise: float = option(5e-3, min=0.0)
    noise_time: float = option(0.0, min=0.0, drawn=True)
    position_step: float = option(0.0, min=0.0, drawn=True)
    effort_step: float = option(0.0, min=0.0, drawn=True)

    motion: str = option("sines", choices=MOTIONS)
    motion_period: float = option(6.0, flag="--period", min=0.0, min_open=True)
    motion_harmonics: int = option(6, min=1)
    motion_range: float = option(0.7, min=0.0, min_open=True, max=1.0)
    motion_speed: float = option(0.6, min=0.0, min_open=True, max=1.0)

    longest_step: float = option(5e-4, min=0.0, min_open=True, max=LONGEST_STEP)

    def __post_init__(self) -> None:
        super().__post_init__()
        for entry in fields(self) if self.realistic else ():
            if entry.metadata.get("drawn") and getattr(self, entry.name) != entry.default:
                raise InputError(f"a realistic robot draws its {entry.name} from the seed; leave the option out.")
        if self.samples < 2:
            raise InputError(f"{self.duration} s at {self.rate} Hz are fewer than 2 samples; lengthen the duration.")

    @property
    def samples(self) -> int:
        """Number of recorded samples."""
        return round(self.duration * self.rate)

    @property
    def substeps(self) -> int:
        """Number of integration steps from one recorded sample to the next."""
        stiff = any(request.effect in GEARS for request in self.hide or ())
        longest = min(self.longest_step, _STIFF_STEP) if stiff else self.longest_step
        return math.ceil(1.0 / (self.rate * longest) - 1e-9)

    @property
    def step(self) -> float:
        """Integration step [s]."""
        return 1.0 / (self.rate * self.substeps)

    @property
    def recording_seed(self) -> int:
        """Seed of the motion and of the noise."""
        return self.seed if self.motion_seed is None else self.motion_seed


@dataclass(frozen=True)
class Hidden:
    """Request to hide an ``effect`` at a ``place`` with ``parameters``; the seed decides whatever is left out.

    ``place`` is a joint, or the link that supports a payload. ``value`` is the value of the first parameter.
    """

    effect: str
    place: str = ""
    value: float | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)


NOTHING = "nothing"
"""Name of the request that hides no effect."""
LINK_MASS = "link_mass"
"""Hidden change that only realistic robots support: ``factor`` times the mass and inertia of the ``link``."""


def parse_hidden(text: str) -> Hidden:
    """Parse ``EFFECT[:PLACE][=VALUE]``, where VALUE is a number or ``name=number,name=number,...``."""
    target, _, value = text.partition("=")
    effect, _, place = target.partition(":")
    if not value:
        return Hidden(effect, place)
    if "=" not in value:
        return Hidden(effect, place, _number(value, text))
    pairs = [part.partition("=") for part in value.split(",")]
    return Hidden(effect, place, None, {name.strip(): _number(number, text) for name, _, number in pairs})


def _number(word: str, text: str) -> float:
    match numbers_in(word):
        case [value]:
            return value
    raise InputError(f"'{text}': '{word}' is not a number; write EFFECT:JOINT=1.5 or EFFECT:JOINT=name=1,name=2")


RandomStream = IntEnum("RandomStream", "INERTIA EFFECTS ORDER MOTION NOISE HIDDEN REALISTIC", start=0)
"""Purpose of each stream of random numbers. The streams are independent, so that changing one choice leaves the others
unchanged."""


def generator(seed: int, stream: RandomStream, *part: int) -> np.random.Generator:
    """Random generator of one stream of a seed, or of a ``part`` of it, at its beginning."""
    return np.random.default_rng([seed, stream, *part])
