"""What some simulators read in a URDF beside its own elements."""

from __future__ import annotations

import re
from collections.abc import Iterable
from xml.sax.saxutils import escape, quoteattr

from geomid_ros.files.models.effect_forms import joint_attributes
from geomid_ros.files.models.xml_edits import Edit, Span, children_of, edited, end_of_tag, insertion
from geomid_ros.model.effects import KnownEffect
from geomid_ros.model.urdf_tree import read_xml

_DRAKE = 'xmlns:drake="http://drake.mit.edu"'
_OF_DRAKE = re.compile(rb"\s*<drake:(?:rotor_inertia|gear_ratio)\b[^>]*/>")


def for_drake(urdf: str, effects: Iterable[KnownEffect], source: str) -> str:
    """``urdf`` with the inertia of rotors, as it is behind the gear, at the actuators of its transmissions; a joint
    without one gets one. Drake: ``multibody/parsing/parsing_doxygen.h``, tag_drake_rotor_inertia."""
    data = urdf.encode()
    transmissions = {
        joint.get("name"): transmission.get("name")
        for transmission in read_xml(urdf, source).findall("transmission")
        for joint in transmission.findall("joint")
    }
    spans = children_of(data, "robot", "transmission", "actuator")
    end, edits, added = data.rindex(b"</robot"), [], b""
    for joint, said in joint_attributes(effects, "actuator").items():
        inside = _rotor(said["drake:rotor_inertia"])
        span = spans.get(transmissions.get(joint) or "")
        if span and span.child:
            own = _OF_DRAKE.sub(b"", data[slice(*span.child)])
            actuator = Span("actuator", (0, end_of_tag(own, 0)))
            edits.append((*span.child, edited(own, [insertion(own, actuator, inside)])))
        else:
            added += _transmission(joint, inside)
    return edited(data, [*edits, *_massless(urdf, source), (end, end, added)]).decode()


def _massless(urdf: str, source: str) -> list[Edit]:
    """Edits that take off inertials without a mass: Drake reads such a link as one of 1 kg."""
    weightless = [
        link.get("name")
        for link in read_xml(urdf, source).findall("link")
        if (mass := link.find("inertial/mass")) is not None and float(mass.get("value", 0.0)) == 0.0
    ]
    spans = children_of(urdf.encode(), "robot", "link", "inertial")
    return [(*span.child, b"") for name in weightless if name and (span := spans[name]).child]


def _rotor(inertia: float) -> bytes:
    return (
        f'<drake:rotor_inertia {_DRAKE} value="{inertia:.9g}"/>\n      <drake:gear_ratio {_DRAKE} value="1"/>'
    ).encode()


def _transmission(joint: str, inside: bytes) -> bytes:
    named = quoteattr(joint)
    return (
        f"  <transmission name={quoteattr(joint + '_transmission')}>\n"
        f"    <type>transmission_interface/SimpleTransmission</type>\n    <joint name={named}/>\n"
        f"    <actuator name={named}>\n      {inside.decode()}\n    </actuator>\n  </transmission>\n"
    ).encode()


def for_gazebo(urdf: str, effects: Iterable[KnownEffect]) -> str:
    """``urdf`` with springs as elements ``<gazebo>`` of joints (SDFormat's extensions to URDF)."""
    data = urdf.encode()
    added = "".join(
        f"  <gazebo reference={quoteattr(joint)}>\n"
        + "".join(f"    <{name}>{escape(f'{value:.9g}')}</{name}>\n" for name, value in said.items())
        + "  </gazebo>\n"
        for joint, said in joint_attributes(effects, "gazebo").items()
    )
    end = data.rindex(b"</robot")
    return edited(data, [(end, end, added.encode())]).decode()
