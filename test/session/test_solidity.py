"""What no solid of a link's shape can be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
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


def said(*links: LinkEstimate, urdf: str = URDF) -> list[str]:
    return list(impossible_links(urdf, "robot.urdf", links))


def test_a_rod_of_lead_can_be_and_one_of_thrice_that_cannot() -> None:
    assert said(rod(113.0)) == []
    (sentence,) = said(rod(340.0))
    assert "3.4e+04 kg/m^3" in sentence
    assert "'rod'" in sentence


def test_mass_outside_of_the_shape() -> None:
    (sentence,) = said(rod(20.0, 1.5))
    assert "outside" in sentence


def test_a_shape_that_is_not_that_of_the_mass_in_the_urdf_says_nothing() -> None:
    """As of a wrist that is drawn without its drive."""
    inertia = '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.01"/>'
    for centre, count in (("0 0 0", 1), ("0 0 1.5", 0)):
        inertial = f'<inertial><origin xyz="{centre}"/><mass value="20"/>{inertia}</inertial>'
        assert len(said(rod(20.0, 1.5), urdf=URDF.replace("<collision>", f"{inertial}<collision>"))) == count


def test_what_has_no_shape_or_counts_others_in_passes() -> None:
    assert said(replace(rod(340.0), merged=("tool",))) == []
    assert said(rod(340.0), urdf=URDF.replace("<collision>", "<!--").replace("</collision>", "-->")) == []
    mesh = URDF.replace('<box size="0.1 0.1 1"/>', '<mesh filename="package://nowhere/rod.stl"/>')
    assert said(rod(340.0), urdf=mesh) == []


def test_the_links_of_the_shipped_arm_can_be() -> None:
    text = (BAGS / "arm7.urdf").read_text()
    light = replace(link_estimate("link3"), parameters=1e-3 * rod(1000.0).parameters)
    assert "outside" in said(light, urdf=text)[0], "a rod of a metre is no link of this arm"
