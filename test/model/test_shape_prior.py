"""A prior from shapes: one density, the given total, and which inertials are called nonsense."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from geomid_ros.errors import InputError
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model import shape_prior, shapes, urdf_tree
from geomid_ros.model.shape_prior import MISSING, Solid, UrdfInertial
from geomid_ros.types import FloatArray

ORIGIN = np.zeros(3)
SIZE = np.array([0.1, 0.2, 0.4])
NONE = UrdfInertial(None, MISSING)
DENSITY = 2000.0


def box(size: FloatArray = SIZE, centre: FloatArray = ORIGIN) -> Solid:
    placement = np.eye(4)
    placement[:3, 3] = centre
    mesh = trimesh.creation.box(size)
    return Solid(shapes.moved(shapes.box(size), placement), mesh.vertices + centre, mesh.faces, "box")


def inertial(mass: float, *inertia: float, com: FloatArray = ORIGIN) -> UrdfInertial:
    return UrdfInertial(pseudo_inertia.assemble(np.array(mass), com, np.diag(inertia)), "")


def cloud(rng: np.random.Generator, low: FloatArray, high: FloatArray) -> UrdfInertial:
    """Some point masses in a box, mostly at its corners."""
    corners = rng.integers(0, 2, size=(8, 3)).astype(float)
    shares = np.where(rng.uniform(size=(8, 3)) < 0.7, corners, rng.uniform(size=(8, 3)))
    points = np.column_stack([low + shares * (high - low), np.ones(8)])
    masses = rng.uniform(size=8) ** 4
    masses *= DENSITY * float(np.prod(SIZE)) / masses.sum()
    return UrdfInertial(pseudo_inertia.to_parameters((points.T * masses) @ points), "")


def test_all_links_weigh_the_total() -> None:
    rng = np.random.default_rng(1)
    names = [f"link{k}" for k in range(6)]
    solids = {name: box(rng.uniform(0.05, 0.5, 3), rng.normal(size=3)) for name in names[:4]}
    kept = {"link4": inertial(1.5, 0.1, 0.1, 0.1), "link5": NONE}
    inertials = {name: kept.get(name, NONE) for name in names}
    total = rng.uniform(2.0, 30.0)
    prior = shape_prior.shape_prior(inertials, solids, total, "robot.urdf")
    assert [link.name for link in prior.links] == names
    np.testing.assert_allclose(prior.mass, total, rtol=1e-14)
    for link in prior.links:
        if link.name in solids:
            assert link.parameters is not None
            np.testing.assert_allclose(link.mass, prior.density * shapes.volume(solids[link.name].moments), rtol=1e-14)
            assert pseudo_inertia.is_body(link.parameters)
        else:
            assert link.parameters is None
            assert link.mass == kept[link.name].mass


def test_a_box_of_one_kilogram() -> None:
    (link,) = shape_prior.shape_prior({"a": NONE}, {"a": box(centre=np.array([0.0, 0.0, 1.0]))}, 1.0, "").links
    expected = pseudo_inertia.assemble(np.array(1.0), np.array([0.0, 0.0, 1.0]), np.diag([0.2, 0.17, 0.05]) / 12)
    np.testing.assert_allclose(link.parameters, expected, atol=1e-15)


def test_what_stays_may_not_weigh_it_all() -> None:
    with pytest.raises(InputError, match=r"robot.urdf: .* already have 3.000 kg, at least the total of 3 kg"):
        shape_prior.shape_prior({"a": NONE, "b": inertial(3.0, 1, 1, 1)}, {"a": box()}, 3.0, "robot.urdf")


def test_without_shapes_there_is_no_prior() -> None:
    with pytest.raises(InputError, match=r"robot.urdf: no link has a shape"):
        shape_prior.shape_prior({"a": NONE}, {}, 3.0, "robot.urdf")


class TestVerdict:
    @pytest.mark.parametrize("seed", range(3))
    def test_no_body_within_twice_its_shape_is_said_to_reach_beyond(self, seed: int) -> None:
        body = cloud(np.random.default_rng(seed), -0.999 * SIZE, 0.999 * SIZE)
        assert shape_prior.verdict(body, box(), DENSITY) != shape_prior.OUTSIDE

    def test_masses_at_the_ends_of_twice_the_shape_are_just_within(self) -> None:
        """Bhatia and Davis's bound is reached by two masses at the ends, and only by them."""
        for share, verdict in ((0.999, ""), (1.001, shape_prior.OUTSIDE)):
            ends = share * SIZE * np.array([[0, 0, 1], [0, 0, -1], [0.5, 0.5, 0], [-0.5, 0.5, 0], [-0.5, -0.5, 0]])
            points = np.column_stack([ends, np.ones(5)])
            masses = DENSITY * float(np.prod(SIZE)) * np.array([0.4999, 0.4999, 1e-4, 0.5e-4, 0.5e-4])
            body = UrdfInertial(pseudo_inertia.to_parameters((points.T * masses) @ points), "")
            found = shape_prior.verdict(body, box(SIZE * [1.0, 1.0, 0.9999]), DENSITY)
            assert found == verdict, (share, found)

    def test_a_body_beside_its_shape_reaches_beyond(self) -> None:
        rng = np.random.default_rng(1)
        away = 2.0 * SIZE * np.sign(rng.normal(size=3)) * (np.arange(3) == 1 % 3)
        assert shape_prior.verdict(cloud(rng, away - SIZE / 2, away + SIZE / 2), box(), DENSITY) == shape_prior.OUTSIDE

    @pytest.mark.parametrize(
        ("body", "verdict"),
        [
            (NONE, MISSING),
            (inertial(16.0, 1.0, 1.0, 1.0), shape_prior.OUTSIDE),  # the placeholder of many exporters
            (inertial(16.0, 1e-4, 1e-4, 1e-4), shape_prior.POINT),
            (inertial(16.0, 0.2, 0.17, 0.05), ""),
            (inertial(170.0, 2.0, 1.7, 0.5), shape_prior.DENSE),
            (inertial(1.5, 0.02, 0.017, 0.005), shape_prior.LIGHT),
        ],
    )
    def test_of_a_box_that_should_weigh_16_kg(self, body: UrdfInertial, verdict: str) -> None:
        assert shape_prior.verdict(body, box(), DENSITY) == verdict

    def test_without_a_shape_only_the_inertial_itself_is_judged(self) -> None:
        assert shape_prior.verdict(inertial(16.0, 1.0, 1.0, 1.0), None, DENSITY) == ""


def test_massless_moving_links_are_told_apart() -> None:
    chain = ("base", "a", "b", "plate", "c", "d", "tip")
    kinds = ("revolute", "continuous", "fixed", "prismatic", "revolute", "fixed")
    joints = "".join(
        f'<joint name="j{k}" type="{kind}"><parent link="{chain[k]}"/><child link="{chain[k + 1]}"/>'
        '<limit effort="1" velocity="1"/></joint>'
        for k, kind in enumerate(kinds)
    )
    links = "".join(f'<link name="{name}"/>' for name in chain)
    tree = urdf_tree.parse(f'<robot name="r">{links}{joints}</robot>', "r.urdf")
    masses = dict.fromkeys(chain, 0.0)
    assert shape_prior.massless_links(tree, masses) == ([], ["a", "b", "c", "d"])
    assert shape_prior.massless_links(tree, masses | {"plate": 1.0}) == (["a"], ["c", "d"])
    assert shape_prior.massless_links(tree, masses | {"tip": 1.0}) == (["a", "b", "c"], [])
