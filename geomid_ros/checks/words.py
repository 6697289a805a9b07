"""The causes in sentences, with what to write into the configuration."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from geomid_ros.checks.hypotheses import Cause
from geomid_ros.types import FloatArray


def gain_settings(joints: Sequence[str], gains: Iterable[float], of_all: bool) -> dict[str, Any]:
    """The parameters that give joints these gains.

    Args:
        joints: their names.
        gains: factors from messages' efforts to N m.
        of_all: whether these are all joints.
    """
    rounded = [float(f"{gain:.3g}") for gain in gains]
    if of_all and len(set(rounded)) == 1:
        return {"effort_gain": rounded[0]}
    return {f"joint.{joint}.effort_gain": gain for joint, gain in zip(joints, rounded, strict=True)}


def written(settings: Mapping[str, Any]) -> str:
    """Parameters as a configuration has them."""
    return ", ".join(f"{name}: {value}" for name, value in settings.items())


def reversed_efforts(joints: Sequence[str], gains: Iterable[float], of_all: bool) -> Cause:
    """The efforts of joints, or of all of them, have the opposite sign."""
    settings = gain_settings(joints, [-gain for gain in gains], of_all)
    who = "the efforts of all joints are" if of_all else f"the effort of joint '{joints[0]}' is"
    sentence = f"{who} reversed: with {written(settings)} {_would_follow(of_all)} this robot's gravity and motion"
    return Cause(kind="sign", sentence=sentence, settings=settings, places=tuple(joints))


def _would_follow(of_all: bool) -> str:
    return "they would follow" if of_all else "it would follow"


def exchanged_efforts(first: str, second: str) -> Cause:
    """The efforts of two joints are exchanged."""
    sentence = (
        f"the efforts of joints '{first}' and '{second}' are swapped: swapped back they would follow this robot's "
        "gravity and motion; correct their order in the driver, or the names in the URDF"
    )
    return Cause(kind="order", sentence=sentence, places=(first, second))


def exchanged_names(joints: Sequence[str], others: Sequence[str]) -> Cause:
    """Each of some joints has the name of another one."""
    pairs = ", ".join(f"'{joint}' and '{other}'" for joint, other in zip(joints, others, strict=True))
    sentence = (
        f"the names of joints {pairs} are swapped: swapped back positions and efforts would be those of this robot; "
        "correct the names in the driver, or in the URDF"
    )
    return Cause(kind="names", sentence=sentence, places=(*joints, *others))


def other_unit(joints: Sequence[str], gains: Iterable[float], factor: float, of_all: bool) -> Cause:
    """Efforts have to be multiplied by a factor; ``gains`` are those that result."""
    settings = gain_settings(joints, gains, of_all)
    who = "the efforts of all joints are" if of_all else f"the effort of joint '{joints[0]}' is"
    sentence = (
        f"{who} about 1/{factor:.3g}" if factor > 1.0 else f"{who} about {1.0 / factor:.3g} times"
    ) + f" of what this robot needs in N m{_unit(factor)}: with about {written(settings)} {_would_follow(of_all)} its "
    sentence += "gravity and motion (the exact factor cannot be distinguished from the masses)"
    return Cause(kind="gain", sentence=sentence, settings=settings, places=tuple(joints))


def _unit(factor: float) -> str:
    if 0.5e-3 < factor < 2e-3:
        return " (in mN m?)"
    if 250.0 < factor < 4000.0:
        return " (in kN m? or masses of the URDF in grams?)"
    return " (in A? or on the motor side of the gear?)" if factor > 1.0 else ""


def degrees(joints: Sequence[str]) -> Cause:
    """Positions and speeds are in degrees."""
    sentence = (
        "joint positions are in degrees: read as degrees, the efforts follow this robot's gravity and motion; send "
        "messages in rad and rad/s"
    )
    return Cause(kind="degrees", sentence=sentence, places=tuple(joints))


def other_gravity(gravity: FloatArray, joints: Sequence[str]) -> Cause:
    """Gravity acts in another direction."""
    settings = _gravity(gravity)
    sentence = (
        f"gravity acts in another direction than configured: {written(settings)} fits (check how the robot is mounted)"
    )
    return Cause(kind="gravity", sentence=sentence, settings=settings, places=tuple(joints))


def not_level(gravity: FloatArray, angle: float, joints: Sequence[str]) -> Cause:
    """The base is tilted a little, by an angle [rad]."""
    written = " ".join(f"{entry:g}" for entry in np.round(gravity, 2) + 0.0)
    sentence = (
        f"the efforts are explained much better if gravity is {written} in the base frame: the base may be "
        f"tilted by {np.degrees(angle):.1f} degrees. Measure it; correct it with --gravity {written} (the parameter "
        "gravity), or let 'geomid gap' fit it"
    )
    return Cause(kind="gravity", sentence=sentence, settings=_gravity(gravity), places=tuple(joints))


def _gravity(gravity: FloatArray) -> dict[str, list[float]]:
    return {"gravity": [float(entry) for entry in np.round(gravity, 2) + 0.0]}


def no_gravity(joints: Sequence[str]) -> Cause:
    """Gravity is not in the efforts."""
    settings = {"gravity": [0.0, 0.0, 0.0]}
    sentence = (
        "gravity is not in the efforts: they are compensated for it, or there is none. Record measured efforts "
        f"without compensation, or write {written(settings)}; then only accelerations identify masses"
    )
    return Cause(kind="compensated", sentence=sentence, settings=settings, places=tuple(joints))


def from_on(time: float) -> str:
    """When something is another."""
    return f"from about {time:.0f} s on"


def until(time: float) -> str:
    """When something is another."""
    return f"until about {time:.0f} s"


BIT_BY_BIT = "gradually during the recording"
"""How something changes."""
_APART = "record again, or use only the part before or after"


def change(joint: str, size: float, unit: str) -> str:
    """By how much the effort of a joint is another."""
    return f"'{joint}' by {size:+.3g} {unit}"


def other_offset(joints: Sequence[str], said: Sequence[str], when: str) -> Cause:
    """The constant part of efforts changes."""
    sentence = (
        f"efforts are shifted {when}, independently of the motion: {', '.join(said)}; check for a zeroed sensor or an "
        f"external load. {_advice(when)}"
    )
    return Cause(kind="offset", sentence=sentence, places=tuple(joints))


def gain_changes(joints: Sequence[str], factor: float, when: str, of_all: bool) -> Cause:
    """Efforts change by a factor."""
    who = "the efforts of all joints" if of_all else f"the effort of joint '{joints[0]}'"
    sentence = (
        f"{who} changed to {factor:.2f} times the earlier value {when}: check for a change of unit, or a motor that "
        f"warms up. {_advice(when)}"
    )
    return Cause(kind="drift", sentence=sentence, places=tuple(joints))


def unit_switches(joints: Sequence[str], factor: float, when: str) -> Cause:
    """Efforts change to another unit, or sign."""
    what = "the opposite sign" if factor == -1.0 else f"{factor:.2g} times the earlier value"
    sentence = (
        f"the efforts of all joints have {what} {when}: another unit or sign begins; use one of the two parts, with "
        "effort_gain for its unit"
    )
    return Cause(kind="stream", sentence=sentence, places=tuple(joints))


def gravity_goes(joints: Sequence[str], when: str) -> Cause:
    """Gravity is in the efforts for a part of the time."""
    sentence = f"gravity is not in the efforts {when}: its compensation was switched; {_APART}"
    return Cause(kind="switched", sentence=sentence, places=tuple(joints))


def payload_changes(link: str, mass: float, joints: Sequence[str], when: str) -> Cause:
    """Something is taken up or put down."""
    what = "more" if mass > 0.0 else "less"
    sentence = (
        f"'{link}' carries about {abs(mass):.2g} kg {what} {when}: something is picked up or put down; identify the "
        f"robot from a recording without it ({_APART})"
    )
    return Cause(kind="load", sentence=sentence, places=tuple(joints))


def displaced(joint: str, size: float, turns: bool) -> str:
    """By how much the position of a joint is off."""
    return f"'{joint}' by {np.degrees(size):+.0f} degrees" if turns else f"'{joint}' by {1000.0 * size:+.0f} mm"


def zero_changes(joints: Sequence[str], said: Sequence[str], when: str) -> Cause:
    """Positions are others than they were."""
    sentence = (
        f"positions are off {when}: {', '.join(said)}; check for a slipping coupling or a zeroed encoder. "
        f"{_advice(when)}"
    )
    return Cause(kind="slip", sentence=sentence, places=tuple(joints))


def _advice(when: str) -> str:
    return "Fix that and record again" if when == BIT_BY_BIT else _APART[0].upper() + _APART[1:]


def all_late(joints: Sequence[str], lag: float) -> Cause:
    """All efforts are late or early."""
    first, second = ("efforts", "positions") if lag > 0.0 else ("positions", "efforts")
    held = "they are filtered, held or polled in the driver" + (", or positions are set-points" if lag > 0.0 else "")
    sentence = (
        f"the {first} come about {1000.0 * abs(lag):.0f} ms later than the matching {second}: {held}. Record "
        "both as measured, with the stamp of the measurement ('geomid gap' identifies a pure delay)"
    )
    return Cause(kind="late", sentence=sentence, places=tuple(joints))


def some_late(joints: Sequence[str], lags: Iterable[float]) -> Cause:
    """The efforts of some joints are late or early."""
    times = [f"{1000.0 * abs(lag):.0f} ms {'late' if lag > 0.0 else 'early'}" for lag in lags]
    said = ", ".join(f"'{joint}' about {time}" for joint, time in zip(joints, times, strict=True))
    sentence = (
        f"efforts are not synchronous with the motion: that of {said}; check whether the driver filters or holds "
        f"them, or "
        "polls them one after the other. Record all joints with the stamp of their measurement"
    )
    return Cause(kind="late", sentence=sentence, places=tuple(joints))


def frozen_effort(joint: str, begin: float, end: float, asked: float) -> Cause:
    """An effort stays the same for a while."""
    sentence = (
        f"the effort of joint '{joint}' is exactly the same from about {begin:.0f} s to {end:.0f} s, while gravity and "
        f"motion change the required effort by {asked:.3g}: it is not measured there; leave that part out"
    )
    return Cause(kind="constant", sentence=sentence, places=(joint,))


MODEL = (
    "the efforts equal those of the URDF's own model, without friction or errors: they come from a simulation or a "
    "controller's model. To identify a real robot, record its measured efforts"
)
"""What efforts are that nobody measures."""


def unrelated(joints: Sequence[str]) -> Cause:
    """No model explains the efforts."""
    sentence = (
        "the efforts follow neither the gravity nor the motion of this robot: check whether they are external or "
        "compensated efforts, or the URDF is of another robot"
    )
    return Cause(kind="unrelated", sentence=sentence, places=tuple(joints))


def constant(joints: Sequence[str]) -> Cause:
    """Efforts never change though the joints move."""
    named = ", ".join(f"'{joint}'" for joint in joints)
    sentence = f"the effort of {named} never changes though the joint moves: it is not measured"
    return Cause(kind="constant", sentence=sentence, places=tuple(joints))


def overcompensated(joints: Sequence[str]) -> Cause:
    """Friction drives the motion."""
    named = ", ".join(f"'{joint}'" for joint in joints)
    sentence = (
        f"at {named} friction seems to drive the motion: more friction is compensated than there is, while masses and "
        "inertias match this robot. Record efforts before friction compensation, or compensate less"
    )
    return Cause(kind="friction", sentence=sentence, places=tuple(joints))


def magnitudes(joints: Sequence[str]) -> Cause:
    """Efforts have lost their sign."""
    named = ", ".join(f"'{joint}'" for joint in joints)
    sentence = (
        f"the effort of {named} has no sign: it never changes sign, though this robot's gravity and motion require it. "
        "Record efforts with their sign"
    )
    return Cause(kind="magnitude", sentence=sentence, places=tuple(joints))


def other_zero(joint: str, zero: float, deviation: float) -> Cause:
    """A joint counts from another zero: ``zero`` [rad] has to be added to its positions."""
    sentence = (
        f"the zero of joint '{joint}' seems to be off: {_degrees(zero, deviation)} to be added to its positions before "
        "efforts follow this robot's gravity and motion. Calibrate the joint, or rotate its frame in the URDF"
    )
    return Cause(kind="zero", sentence=sentence, places=(joint,))


def turned_axis(joint: str, zero: float, deviation: float) -> Cause:
    """A joint counts the other way round."""
    zeros = "" if abs(zero) < _LEAST_ZERO else f", and {_degrees(zero, deviation)} to be added to its positions then"
    sentence = (
        f"joint '{joint}' seems to turn opposite to its axis in the URDF: with position, velocity and effort "
        f"reversed, efforts would follow this robot's gravity and motion{zeros}. Correct the signs in the driver, or "
        "the axis in the URDF"
    )
    return Cause(kind="axis", sentence=sentence, places=(joint,))


def absolute(joint: str, other: str, share: float) -> Cause:
    """The position of a joint holds that of another one, too."""
    sentence = (
        f"the position of joint '{joint}' seems to include that of '{other}' (an angle against the base, not against "
        f"the "
        f"previous link): {'minus' if share > 0.0 else 'plus'} the position of '{other}', efforts follow this robot's "
        "gravity and motion. Send the angle between the links"
    )
    return Cause(kind="absolute", sentence=sentence, places=(joint, other))


def frozen_position(joint: str, share: float) -> Cause:
    """A position that stands still."""
    sentence = (
        f"the position of joint '{joint}' is frozen for {share:.0%} of the time, while efforts are not those of that "
        "pose: check the encoder, and whether the driver repeats an old value. Leave that part out"
    )
    return Cause(kind="frozen", sentence=sentence, places=(joint,))


def far_centre(link: str, distance: float, length: float) -> Cause:
    """Centres of mass in another unit."""
    sentence = (
        f"the URDF has the centre of mass of link '{link}' {distance:.3g} m from its frame, though all links together "
        f"are {length:.3g} m long: the centres of mass may be in mm; they must be in m"
    )
    return Cause(kind="description", sentence=sentence, places=(link,))


def wide_inertia(link: str, radius: float, length: float) -> Cause:
    """Moments of inertia in another unit."""
    sentence = (
        f"the URDF's moments of inertia of link '{link}' are those of mass {radius:.3g} m away from its centre, though "
        f"all links together are {length:.3g} m long: are they in g mm^2 or kg mm^2? They have to be in kg m^2"
    )
    return Cause(kind="description", sentence=sentence, places=(link,))


def too_heavy(mass: float, reason: str) -> Cause:
    """Masses in another unit."""
    sentence = (
        f"in the URDF the links weigh {mass:.3g} kg in total, and {reason}: the masses may be in grams; they must be "
        "in kg"
    )
    return Cause(kind="description", sentence=sentence)


_LEAST_ZERO = np.radians(5.0)


def _degrees(zero: float, deviation: float) -> str:
    turn = np.degrees((zero + np.pi) % (2.0 * np.pi) - np.pi)
    return f"about {turn:.0f} (+-{max(2.0 * np.degrees(deviation), 1.0):.0f}) degrees have"
