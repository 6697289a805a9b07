"""What fills a URDF's links: shapes as they are placed, joined, read from files and looked for."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from geomid_ros.errors import InputError
from geomid_ros.files.models.urdf import MeshFinder
from geomid_ros.files.shapes import ShapeReader
from geomid_ros.model import shapes
from geomid_ros.model.shape_prior import Solid
from geomid_ros.types import FloatArray

SIZE = np.array([0.2, 0.3, 0.5])
BOX = '<box size="0.2 0.3 0.5"/>'


def element(geometry: str, origin: str = "", kind: str = "collision") -> str:
    return f"<{kind}>{f'<origin {origin}/>' if origin else ''}<geometry>{geometry}</geometry></{kind}>"


def reader(folder: Path, **packages: Path) -> ShapeReader:
    return ShapeReader(folder / "robot.urdf", packages)


def read(body: str, folder: Path = Path()) -> tuple[Solid | None, list[str]]:
    """What fills a link of this body, and the warnings."""
    own = reader(folder)
    return own.solid(ElementTree.fromstring(f'<link name="arm">{body}</link>')), own.warnings


def moments(body: str, folder: Path = Path()) -> FloatArray:
    """The moments of a link that is read without a warning."""
    solid, warnings = read(body, folder)
    assert warnings == []
    assert solid is not None
    return solid.moments


def placed(own: FloatArray, xyz: tuple[float, ...], rpy: tuple[float, ...] = (0.0, 0.0, 0.0)) -> FloatArray:
    placement = np.eye(4)
    placement[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
    placement[:3, 3] = xyz
    return shapes.moved(own, placement)


def saved(mesh: trimesh.Trimesh, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh.export(path)
    return path


class TestPrimitives:
    def test_a_frame_has_none(self) -> None:
        assert read('<inertial><mass value="1"/></inertial>') == (None, [])
        assert read('<collision name="empty"/>') == (None, [])

    @pytest.mark.parametrize(
        ("geometry", "own"),
        [
            (BOX, shapes.box(SIZE)),
            ('<cylinder radius="0.2" length="0.7"/>', shapes.cylinder(0.2, 0.7)),
            ('<sphere radius="0.3"/>', shapes.sphere(0.3)),
        ],
    )
    def test_as_they_are_placed(self, geometry: str, own: FloatArray) -> None:
        np.testing.assert_array_equal(moments(element(geometry)), own)
        found = moments(element(geometry, 'xyz="1 -2 3" rpy="0.3 -0.7 1.9"'))
        np.testing.assert_allclose(found, placed(own, (1, -2, 3), (0.3, -0.7, 1.9)), rtol=1e-14)

    def test_the_surface_is_where_the_solid_is(self) -> None:
        solid, _ = read(element('<cylinder radius="0.2" length="0.7"/>', 'xyz="1 2 3" rpy="0 1.5707963267948966 0"'))
        assert solid is not None
        np.testing.assert_allclose(solid.vertices.min(axis=0), [0.65, 1.8, 2.8], atol=1e-12)
        np.testing.assert_allclose(solid.vertices.max(axis=0), [1.35, 2.2, 3.2], atol=1e-12)

    @pytest.mark.parametrize(
        ("geometry", "message"),
        [
            ('<sphere radius="-1"/>', "a sphere has a negative radius"),
            ('<box size="1 2"/>', 'its <box> has size="1 2"; expected 3 finite numbers'),
            ('<cylinder radius="1"/>', 'its <cylinder> has radius="1", no length; expected 2 finite numbers'),
            ('<capsule radius="1" length="2"/>', "a shape is a <capsule>. Valid: box, cylinder, sphere, mesh"),
        ],
    )
    def test_nonsense_is_named(self, geometry: str, message: str) -> None:
        with pytest.raises(InputError) as caught:
            read(element(geometry))
        assert str(caught.value).startswith(f"robot.urdf: link 'arm': {message}")


class TestUnion:
    def test_shapes_that_touch_add_up(self) -> None:
        """To the last digit: nothing is taken from the closed forms."""
        body = element(BOX) + element('<cylinder radius="0.1" length="0.4"/>', 'xyz="0 0 0.45"')
        expected = shapes.box(SIZE) + placed(shapes.cylinder(0.1, 0.4), (0, 0, 0.45))
        np.testing.assert_array_equal(moments(body), expected)

    def test_boxes_that_overlap_count_once(self) -> None:
        body = element(BOX) + element(BOX, 'xyz="0 0 0.2"') + element(BOX, 'xyz="0 0 0.1"')
        expected = placed(shapes.box(np.add(SIZE, [0.0, 0.0, 0.2])), (0, 0, 0.1))
        np.testing.assert_allclose(moments(body), expected, atol=1e-6 * shapes.volume(expected))

    def test_without_the_library_that_joins_they_add_up_and_that_is_said(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def missing(*_arguments: object, **_options: object) -> None:
            raise ImportError

        monkeypatch.setattr(trimesh.boolean, "union", missing)
        solid, warnings = read(2 * element(BOX))
        assert solid is not None
        np.testing.assert_array_equal(solid.moments, 2.0 * shapes.box(SIZE))
        assert warnings == ["shapes that cannot be merged, so their overlap counts twice: arm"]


class TestMeshes:
    def test_scaled_and_mirrored(self, tmp_path: Path) -> None:
        wedge = trimesh.Trimesh(
            [[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
        )
        saved(wedge, tmp_path / "wedge.stl")
        found = moments(element('<mesh filename="wedge.stl" scale="0.001 -0.002 0.003"/>'), tmp_path)
        corner = moments(element('<mesh filename="wedge.stl"/>'), tmp_path)
        assert corner[3, 3] == pytest.approx(1.0)  # a sixth of 1 x 2 x 3
        np.testing.assert_allclose(corner[:3, 3], [0.25, 0.5, 0.75])
        np.testing.assert_allclose(found[3, 3], 6e-9)
        np.testing.assert_allclose(found[:3, 3] / found[3, 3], [0.25e-3, -1e-3, 2.25e-3])
        scaled = wedge.copy().apply_transform(np.diag([0.001, -0.002, 0.003, 1.0]))
        np.testing.assert_allclose(found, shapes.polyhedron(scaled.vertices, scaled.faces), rtol=1e-9)

    def test_what_is_not_closed_counts_as_its_hull(self, tmp_path: Path) -> None:
        box = trimesh.creation.box(SIZE)
        box.update_faces(np.arange(len(box.faces)) != 3)
        saved(box, tmp_path / "open.stl")
        solid, warnings = read(element('<mesh filename="open.stl"/>'), tmp_path)
        assert solid is not None
        np.testing.assert_allclose(solid.moments, shapes.box(SIZE), rtol=1e-6, atol=1e-9)
        assert solid.shape == "collision: hull of open.stl"
        assert warnings == ["meshes that are not closed, replaced by their convex hulls: open.stl of arm"]

    def test_a_hole_in_a_solid_is_empty(self, tmp_path: Path) -> None:
        inner = trimesh.creation.box(0.5 * SIZE)
        inner.invert()
        saved(trimesh.util.concatenate([trimesh.creation.box(SIZE), inner]), tmp_path / "hollow.stl")
        found = moments(element('<mesh filename="hollow.stl"/>'), tmp_path)
        np.testing.assert_allclose(found, shapes.box(SIZE) - shapes.box(0.5 * SIZE), rtol=1e-6, atol=1e-9)

    def test_a_collada_file_may_be_in_other_units(self, tmp_path: Path) -> None:
        path = saved(trimesh.creation.box(1000.0 * SIZE), tmp_path / "box.dae")
        text = path.read_text()
        assert text.count("<asset>") == 1
        path.write_text(text.replace("<asset>", '<asset><unit name="mm" meter="0.001"/>'))
        found = moments(element('<mesh filename="box.dae"/>'), tmp_path)
        np.testing.assert_allclose(found, shapes.box(SIZE), rtol=1e-6, atol=1e-9)

    @pytest.mark.parametrize(
        ("name", "content", "message"),
        [
            ("a.stl", b"", "has no triangles with finite vertices"),
            ("a.stl", b"solid nothing\nendsolid\n", "a.stl "),
            ("a.dae", b"<COLLADA", "cannot be read"),
            ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "is flat and encloses no volume"),
            ("a.obj", b"v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "has no triangles with finite vertices"),
            ("a.step", b"", "is not a readable mesh; expected .stl, .dae, .obj"),
        ],
    )
    def test_a_file_that_is_no_solid_is_named(self, name: str, content: bytes, message: str, tmp_path: Path) -> None:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=rf"robot.urdf: link 'arm': .*{message}"):
            read(element(f'<mesh filename="{name}"/>'), tmp_path)

    def test_what_would_never_end_is_named(self, tmp_path: Path) -> None:
        """A pipe that nobody writes to, a device; and more than memory holds."""
        os.mkfifo(tmp_path / "pipe.stl")
        (tmp_path / "device.obj").symlink_to("/dev/zero")
        with (tmp_path / "large.dae").open("wb") as file:
            file.truncate(10**11)
        for name, message in (
            ("pipe.stl", "not a regular file"),
            ("device.obj", "not a regular file"),
            ("large.dae", "larger than 100 MB"),
        ):
            with pytest.raises(InputError, match=rf"robot.urdf: link 'arm': .*/{name}: {message}"):
                read(element(f'<mesh filename="{name}"/>'), tmp_path)

    @pytest.mark.parametrize("suffix", [".obj", ".dae"])
    def test_no_other_file_is_opened(self, suffix: str, tmp_path: Path) -> None:
        """A mesh names its materials and pictures: whoever opened this pipe to read it would wait for ever."""
        os.mkfifo(tmp_path / "colours")
        path = saved(trimesh.creation.box(SIZE), tmp_path / f"box{suffix}")
        text = path.read_text()
        library = '<library_images><image id="i"><init_from>colours</init_from></image></library_images>'
        named = (
            "mtllib colours\nusemtl a\n" + text if suffix == ".obj" else text.replace("</asset>", "</asset>" + library)
        )
        path.write_text(named)
        np.testing.assert_allclose(
            moments(element(f'<mesh filename="{path.name}"/>'), tmp_path), shapes.box(SIZE), rtol=1e-6, atol=1e-9
        )


class TestFinding:
    @pytest.fixture(autouse=True)
    def without_a_workspace(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for variable in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
            monkeypatch.delenv(variable, raising=False)

    def found(self, uri: str, urdf: Path, **packages: Path) -> Path:
        return MeshFinder(urdf, packages).find(uri, "robot.urdf: link 'arm'")

    def mesh(self, path: Path) -> Path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
        return path

    def test_paths_and_file_uris(self, tmp_path: Path) -> None:
        mesh, urdf = self.mesh(tmp_path / "my meshes/a.stl"), tmp_path / "urdf/robot.urdf"
        urdf.parent.mkdir()
        for uri in ("../my meshes/a.stl", str(mesh), f"file://{mesh}", mesh.as_uri()):
            assert self.found(uri, urdf).resolve() == mesh

    @pytest.mark.parametrize(
        ("variable", "listed", "inside"),
        [
            ("ROS_PACKAGE_PATH", "src", "src/my_robot/meshes/a.stl"),
            ("ROS_PACKAGE_PATH", "src/my_robot", "src/my_robot/meshes/a.stl"),
            ("AMENT_PREFIX_PATH", "install", "install/share/my_robot/meshes/a.stl"),
        ],
    )
    def test_packages_of_a_workspace(
        self, variable: str, listed: str, inside: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        mesh = self.mesh(tmp_path / inside)
        monkeypatch.setenv(variable, f"/nowhere:{tmp_path / listed}")
        assert self.found("package://my_robot/meshes/a.stl", tmp_path / "robot.urdf") == mesh

    @pytest.mark.parametrize(
        ("uri", "message"),
        [
            ("package://my_robot/a.stl", "was not found. Locate the package: --package-path my_robot=FOLDER"),
            ("a.stl", "was not found. Looked in .*a.stl"),
            ("http://host/a.stl", "neither a package:// nor a file:// URI nor a path"),
            ("", "was not found"),
        ],
    )
    def test_what_is_missing_is_named(self, uri: str, message: str, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=rf"robot.urdf: link 'arm': the mesh '{uri}' .*{message}"):
            self.found(uri, tmp_path / "robot.urdf")
