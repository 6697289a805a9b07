"""What no solid of a link's shape can be."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from files.estimates import link_estimate
from files.recordings import BAGS

from geomid_ros.estimation.estimate import LinkEstimate
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.session.review import impossible_links

URDF = """<robot name="one"><link name="base"/>
<link name="rod"><collision><geometry><box size="0.1 0.1 1"/></geometry></collision></link>
<joint name="joint" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 0 1"/>
<limit effort="1" velocity="1" lower="-1" upper="1"/></joint></robot>"""


def rod(mass: float, centre: float = 0.0) -> LinkEstimate:
    """A box of 0.1 by 0.1 by 1 m, moved along its length."""
    inertia = mass / 12.0 * np.diag([1.01, 1.01, 0.02])
    parameters = pseudo_inertia.assemble(np.array(mass), np.array([0.0, 0.0, centre]), inertia)
    return replace(link_estimate("rod"), parameters=parameters)


INERTIA = '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.01"/>'
INERTIAL = f'<inertial><origin xyz="{{}}"/><mass value="20"/>{INERTIA}</inertial><collision>'
MESH = '<mesh filename="package://nowhere/rod.stl"/>'


@pytest.mark.parametrize(
    ("link", "old", "new", "expected"),
    [
        (rod(113.0), "", "", ""),  # of lead
        (rod(340.0), "", "", "link 'rod' .* density of 3.4e[+]04 kg/m"),
        (rod(20.0, 1.5), "", "", "outside"),
        (rod(20.0, 1.5), "<collision>", INERTIAL.format("0 0 0"), "outside"),
        # The shape is not that of the mass, as of a wrist that is drawn without its drive.
        (rod(20.0, 1.5), "<collision>", INERTIAL.format("0 0 1.5"), ""),
        (replace(rod(340.0), merged=("tool",)), "", "", ""),
        (rod(340.0), "collision", "collided", ""),  # no shape
        (rod(340.0), '<box size="0.1 0.1 1"/>', MESH, ""),
    ],
)
def test_what_no_solid_of_the_shape_can_be_is_said(link: LinkEstimate, old: str, new: str, expected: str) -> None:
    sentences = list(impossible_links(URDF.replace(old, new) if old else URDF, "robot.urdf", [link]))
    assert len(sentences) == bool(expected)
    assert re.search(expected, "".join(sentences))


def test_the_links_of_the_shipped_arm_can_be() -> None:
    light = replace(link_estimate("link3"), parameters=1e-3 * rod(1000.0).parameters)
    (sentence,) = impossible_links((BAGS / "arm7.urdf").read_text(), "robot.urdf", [light])
    assert "outside" in sentence, "a rod of a metre is no link of this arm"
