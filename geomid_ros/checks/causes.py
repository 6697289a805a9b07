"""Causes of what is wrong with a recording: their kinds, a sentence for each, and findings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

_APART = "Record again, or use only the part before or after"
_FOLLOW = "efforts would follow this robot's gravity and motion"
_SENTENCES = {
    "sign": f"{{efforts}} reversed: with {{settings}} {_FOLLOW}",
    "order": f"the efforts of joints {{both}} are swapped: swapped back {_FOLLOW}; correct their order in the driver, "
    "or the names in the URDF",
    "names": "the names of joints {pairs} are swapped: swapped back positions and efforts would be those of this "
    "robot; correct the names in the driver, or in the URDF",
    "gain": f"{{efforts}} about {{ratio}} of what this robot needs in N m{{unit}}: with about {{settings}} {_FOLLOW} "
    "(the exact factor cannot be distinguished from the masses)",
    "magnitude": "the effort of {joints} is unsigned (a magnitude): gravity and motion require both signs. Record "
    "efforts with their sign",
    "friction": "{joints}: the estimated friction is negative (over-compensated), while masses and inertias match this "
    "robot. Record efforts before friction compensation, or compensate less",
    "zero": f"the zero of joint {{joints}} seems to be off: {{zero}} to be added to its positions before {_FOLLOW}. "
    "Calibrate the joint, or rotate its frame in the URDF",
    "axis": f"joint {{joints}} seems to turn opposite to its axis in the URDF: with {{reversed}} reversed{{zero}}, "
    f"{_FOLLOW}. Correct the signs in the driver, or the axis in the URDF",
    "absolute": "the position of joint {first} seems to include that of {second} (an angle against the base, not "
    f"against the previous link): {{sign}} the position of {{second}}, {_FOLLOW}. Send the angle between the links",
    "coupled": "the motor of joint {first} seems to drive {second}, too: {sign} the effort of {second}, "
    f"{_FOLLOW}. Send the efforts of joints, not of motors",
    "position": f"{{positions}} in {{unit}}: read as such, {_FOLLOW}; send messages in {{right}}",
    "time": f"stamps run {{rate}}: with {{period}} the time between messages, {_FOLLOW}; stamp messages in seconds, "
    "when they are measured",
    "guided": "the efforts hold the robot but do not accelerate it: it was guided by hand, or they are gravity "
    "compensation only. Let its motors move it, and record their measured efforts",
    "gravity": "gravity acts {how} than configured: {settings} fits ({check})",
    "level": "the efforts are explained much better if gravity is {vector} in the base frame: the base may be tilted "
    "by {angle:.1f} degrees. With gravity_tilt among the candidates that is identified; better, measure it, and "
    "correct it with --gravity {vector} (the parameter gravity)",
    "compensated": "gravity is not in the efforts: they are compensated for it, or there is none. Record measured "
    "efforts without compensation, or write {settings}; then only accelerations identify masses",
    "offset": "efforts are shifted {when}, independently of the motion: {sizes}; check for a zeroed sensor or an "
    "external load. {advice}",
    "drift": "{efforts} {factor:.2f} times the earlier value {when}: check for a change of unit, or a motor that "
    "warms up. {advice}",
    "switched": "gravity is not in the efforts {when}: its compensation was switched. {advice}",
    "load": "'{link}' carries about {mass:.2g} kg {way} {when}: something is picked up or put down; identify the "
    "robot from a recording without it. {advice}",
    "slip": "positions are off {when}: {sizes}; check for a slipping coupling or a zeroed encoder. {advice}",
    "stream": "the efforts of all joints have {factor} {when}: another unit or sign begins; use one of the two parts, "
    "with effort_gain for its unit",
    "late": "efforts are not synchronous with the motion: {sizes}; check whether the driver filters, holds or polls "
    "them, or positions are set-points. Record both as measured, with the stamp of the measurement ('geomid gap' "
    "identifies a pure delay)",
    "unexplained": "efforts of {joints} are inconsistent with the URDF, and no known single cause explains all joints: "
    "check that the recording and the URDF are of the same robot. Closest: {nearest}",
    "unrelated": "the efforts follow neither the gravity nor the motion of this robot: check whether they are "
    "external or compensated efforts or in another unit (effort_gain, --gain), or the URDF is of another robot",
    "constant": "the effort of {joints} never changes though the joint moves: it is not measured",
    "held": "the effort of joint {joints} is stuck from about {begin} to {end}, while gravity and motion "
    "require a change of {asked:.3g}: it is not measured there; leave that part out",
    "frozen": "the position of joint {joints} is frozen for {share:.0%} of the time, but the efforts do not match a "
    "constant pose: check the encoder, and whether the driver repeats an old value. Leave that part out",
    "noise": "accelerations are noisy, as positions are: at {joints} inertial efforts come out up to {share:.0%} too "
    "small. Halve the cutoff of the low-pass (--cutoff, filter.cutoff), or record a faster motion",
    "lengths": "in the URDF {what}: {quantity} may be in {unit}; they must be in {right}",
}
"""Sentence of each kind, or of a special case."""
MODEL = (
    "the efforts equal those of the URDF's own model, without friction or errors: they come from a simulation or a "
    "controller's model. To identify a real robot, record its measured efforts"
)
"""Remark on efforts that nobody measured."""
NOT_CHECKED = (
    "the efforts of all joints are rarely measured at once, so that units, signs and zeros are not checked: record "
    "efforts that are neither missing nor saturated"
)
"""Remark on efforts that could not be checked."""
BIT_BY_BIT = "gradually during the recording"
"""Time of a gradual change."""


@dataclass(frozen=True, kw_only=True)
class Cause:
    """A possible cause of what is wrong with a recording.

    Attributes:
        kind: key of the sentences, or another word.
        sentence: what is wrong, and what to do.
        settings: the parameters that correct it, by full name; empty if none does.
        places: the joints, or the topic, that it concerns.
    """

    kind: str
    sentence: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    places: tuple[str, ...] = ()

    @staticmethod
    def of(
        kind: str,
        places: Sequence[str],
        settings: Mapping[str, Any] | None = None,
        *,
        sentence_key: str = "",
        all_joints: bool = False,
        **values: Any,
    ) -> Cause:
        """Create a cause with the sentence of its kind.

        Args:
            kind: key of the sentences, or another word.
            places: names of joints.
            settings: the parameters that correct it.
            sentence_key: key of the sentence, if it is not the kind's.
            all_joints: True if these are all joints.
            **values: of the sentence's other fields.
        """
        quoted = [f"'{place}'" for place in places]
        values |= {
            "joints": ", ".join(quoted),
            "efforts": "the efforts of all joints are" if all_joints else f"the effort of joint {', '.join(quoted)} is",
            "both": " and ".join(quoted),
            "first": quoted[0] if quoted else "",
            "second": quoted[-1] if quoted else "",
            "settings": format_settings(settings or {}),
            "advice": "Fix that and record again" if values.get("when") == BIT_BY_BIT else _APART,
        }
        sentence = _SENTENCES[sentence_key or kind].format(**values)
        return Cause(kind=kind, sentence=sentence, settings=settings or {}, places=tuple(places))


@dataclass(frozen=True, kw_only=True)
class RecordingFault:
    """A fault of a recording.

    Attributes:
        cause: the best explanation.
        sure: True if the cause is named; otherwise it is suspected.
        rivals: other causes that explain it as well.
    """

    cause: Cause
    sure: bool = True
    rivals: tuple[Cause, ...] = ()

    @property
    def sentence(self) -> str:
        """Sentence of the cause, with its rivals."""
        if not self.sure:
            return f"Possibly: {self.cause.sentence}"
        others = "; or: ".join(rival.sentence for rival in self.rivals)
        return f"{self.cause.sentence}; or: {others}" if others else self.cause.sentence


def as_faults(causes: Iterable[Cause]) -> tuple[RecordingFault, ...]:
    """Return a fault for each cause, all of them sure."""
    return tuple(RecordingFault(cause=cause) for cause in causes)


def format_settings(settings: Mapping[str, Any]) -> str:
    """Format parameters as in a configuration."""
    return ", ".join(f"{name}: {value}" for name, value in settings.items())


def gain_settings(joints: Sequence[str], gains: Iterable[float], all_joints: bool) -> dict[str, Any]:
    """Return the parameters that set the gains of joints.

    Args:
        joints: their names.
        gains: factors from messages' efforts to N m.
        all_joints: True if these are all joints.
    """
    rounded = [float(f"{gain:.3g}") for gain in gains]
    if all_joints and len(set(rounded)) == 1:
        return {"effort_gain": rounded[0]}
    return {f"joint.{joint}.effort_gain": gain for joint, gain in zip(joints, rounded, strict=True)}
