"""Robot descriptions: reading, conversion from xacro, the files of their meshes, insertion of identified inertias and
effects without any other change."""

from __future__ import annotations

import html
import os
import re
import resource
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote

from geomid_ros.errors import InputError
from geomid_ros.files.disk import read_text
from geomid_ros.files.models.effects_file import joint_attributes, of_followers, payload_name
from geomid_ros.files.models.xml_edits import Edit, Span, edited, end_of_tag, insertion, spans_of, with_attributes
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import KnownEffect
from geomid_ros.model.urdf_tree import MOST_URDF_BYTES, masters, parse, read_xml
from geomid_ros.signals.settings import LONGEST_REASON
from geomid_ros.types import FloatArray

SUFFIX = ".xacro"
_SECONDS = 30  # time limit of xacro [s]
_MEMORY = 2_000_000_000  # memory limit of xacro [bytes]
_ROBOT = ["robot"]


def read_urdf(path: Path, arguments: Sequence[str] = ()) -> str:
    """Read the text of a URDF file, with its line ends, or make it of a xacro file with these ``arguments``. Raises
    InputError naming it."""
    if path.suffix == SUFFIX:
        return urdf_of_xacro(path, arguments)
    return read_text(path, "robot description", MOST_URDF_BYTES)


def urdf_of_xacro(path: Path, arguments: Sequence[str] = ()) -> str:
    """Convert a xacro file to URDF.

    A xacro file is a program: it evaluates Python expressions, and includes any file that the user may read.

    Args:
        path: the file.
        arguments: its arguments, as ``NAME:=VALUE``.

    Raises:
        InputError: it names the file, and the command that makes the URDF if xacro is not installed.
    """
    invalid = next((argument for argument in arguments if ":=" not in argument), None)
    if invalid is not None:
        raise InputError(f"xacro's argument '{invalid}' is not of the form NAME:=VALUE")
    if not path.is_file():
        raise InputError(f"{path}: no regular file, as a robot description is")
    if find_spec("xacro") is None:
        command = shlex.join(["xacro", str(path), *arguments])
        raise InputError(
            f"{path}: a xacro file; convert it to a URDF: {command} > robot.urdf (after 'pip install xacro', or in a "
            "sourced workspace, geomid does this itself)"
        )
    return _run_xacro([sys.executable, "-c", "import xacro; xacro.main()", str(path), *arguments], path)


def _run_xacro(command: Sequence[str], path: Path) -> str:
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as errors:
        try:
            status = subprocess.run(  # noqa: S603 the user's own file
                command,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=errors,
                timeout=_SECONDS,
                check=False,
                preexec_fn=_bounds,
            ).returncode
        except subprocess.TimeoutExpired as error:
            raise InputError(f"{path}: xacro takes longer than {_SECONDS} s") from error
        out.seek(0), errors.seek(0)
        text, output = out.read(MOST_URDF_BYTES + 1), errors.read(MOST_URDF_BYTES)
    if status != 0:
        last = " ".join(output.decode(errors="replace").split())[-LONGEST_REASON:]
        raise InputError(
            f"{path}: xacro cannot make a URDF of it ({last or status}); is an --xacro-arg missing, or a workspace not "
            "sourced?"
        )
    return text.decode(errors="replace")


_FILE_NAME = re.compile(r"""(<(?:mesh|texture)\b[^<>]*?\sfilename\s*=\s*["'])([^"':<>]+)""")


def with_absolute_files(urdf: str, source: str) -> str:
    """Replace relative names of mesh and texture files by absolute ones, which are found from any folder; names of
    files that do not exist remain. They start at the folder of ``source``, or remain if that is no file."""
    if not os.path.isfile(source):  # noqa: PTH113 it is false for a text that is no path
        return urdf

    def absolute(match: re.Match[str]) -> str:
        path = str(Path(source).resolve().parent / html.unescape(match[2]))
        return match[1] + html.escape(path) if os.path.isfile(path) else match[0]  # noqa: PTH113

    return _FILE_NAME.sub(absolute, urdf)


def _bounds() -> None:
    """Limit memory and file size of the process."""
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_FSIZE, (MOST_URDF_BYTES + 1, MOST_URDF_BYTES + 1))


def with_inertials(urdf: str, inertias: Mapping[str, FloatArray], removed: Sequence[str] = ()) -> str:
    """Replace the inertials of ``urdf`` by bodies with these parameters ``(10,)``, by link, and delete those of the
    links ``removed``, which are fixed to others and included there; every other character is kept."""
    data = urdf.encode()
    links = spans_of(data, _ROBOT, "link", "inertial")
    edits = [insertion(data, links[name], _inertial(parameters)) for name, parameters in inertias.items()]
    edits += [(*inertial, b"") for name in removed if (inertial := links[name].child)]
    return edited(data, edits).decode()


def _inertial(parameters: FloatArray) -> bytes:
    mass, inertia = parameters[0], pseudo_inertia.central_inertia(parameters)
    centre = " ".join(f"{value:.9g}" for value in pseudo_inertia.centre_of_mass(parameters))
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    numbers = " ".join(f'{key}="{inertia[index]:.9g}"' for key, index in entries.items())
    return (
        f'<inertial>\n      <origin xyz="{centre}" rpy="0 0 0"/>\n      <mass value="{mass:.9g}"/>\n'
        f"      <inertia {numbers}/>\n    </inertial>"
    ).encode()


def with_effects(urdf: str, effects: Iterable[KnownEffect]) -> str:
    """Insert the effects that a URDF can represent into ``urdf``; every other character is kept.

    Values for the same attribute of a joint's ``<dynamics>`` are added up. Those of a joint include what its mimic
    joints had. A payload becomes a link fixed to the link that carries it.
    """
    data, source = urdf.encode(), "robot description"
    effects = list(effects)
    attributes = joint_attributes(effects, "dynamics")
    joints, links = spans_of(data, _ROBOT, "joint", "dynamics"), spans_of(data, _ROBOT, "link", "inertial")
    for name, zeros in of_followers(attributes, masters(parse(urdf, source), source)).items():
        element = data[slice(*span)] if (span := joints[name].child) else b""
        there = {key: zero for key, zero in zeros.items() if re.search(rb"\s" + key.encode() + rb"\s*=", element)}
        attributes[name] = attributes.get(name, {}) | there
    edits = [_at_end(data, "".join(_payload(effect, links, joints) for effect in effects if effect.is_payload))]
    for name, numbers in attributes.items():
        if numbers:  # the other attributes of the element remain
            element = data[slice(*span)] if (span := joints[name].child) else b"<dynamics/>"
            texts = {key: f"{value:.9g}" for key, value in numbers.items()}
            edits.append(insertion(data, joints[name], with_attributes(element, texts)))
    return edited(data, edits).decode()


def _at_end(data: bytes, text: str) -> Edit:
    """Edit that appends a text to the robot's elements."""
    end = data.rindex(b"</robot")
    return end, end, text.encode()


def _payload(effect: KnownEffect, links: Mapping[str, Span], joints: Mapping[str, Span]) -> str:
    name = payload_name(effect.link)
    while name in links or name in joints:
        name += "_"
    inertial = _inertial(effect.body).decode()
    return (
        f'  <link name="{name}">\n    {inertial}\n  </link>\n  <joint name="{name}" type="fixed">\n'
        f'    <parent link="{effect.link}"/>\n    <child link="{name}"/>\n  </joint>\n'
    )


_DRAKE = 'xmlns:drake="http://drake.mit.edu"'
_FRICTION = re.compile(rb"""\s+friction\s*=\s*("[^"]*"|'[^']*')""")
_OF_DRAKE = re.compile(rb"\s*<drake:(?:rotor_inertia|gear_ratio)\b[^>]*/>")


def for_drake(urdf: str, effects: Iterable[KnownEffect], source: str) -> str:
    """Add reflected rotor inertias to ``urdf`` at the actuators of its transmissions; a joint without a transmission
    gets one. Deletes massless inertials, and dry friction, which Drake ignores. Drake:
    ``multibody/parsing/parsing_doxygen.h``, tag_drake_rotor_inertia."""
    data = urdf.encode()
    transmissions = {
        joint.get("name"): transmission.get("name")
        for transmission in read_xml(urdf, source).findall("transmission")
        for joint in transmission.findall("joint")
    }
    spans = spans_of(data, _ROBOT, "transmission", "actuator")
    edits, added = list[Edit](), ""
    for joint, attributes in joint_attributes(effects, "actuator").items():
        value = f'value="{attributes["drake:rotor_inertia"]:.9g}"'
        inside = f'<drake:rotor_inertia {_DRAKE} {value}/>\n      <drake:gear_ratio {_DRAKE} value="1"/>'
        place = spans.get(transmissions.get(joint) or "")
        if place and place.child:
            actuator = _OF_DRAKE.sub(b"", data[slice(*place.child)])
            start = Span("actuator", (0, end_of_tag(actuator, 0)))
            edits.append((*place.child, edited(actuator, [insertion(actuator, start, inside.encode())])))
        else:
            added += _transmission(joint, inside)
    for span in spans_of(data, _ROBOT, "joint", "dynamics").values():
        if span.child:
            element = _FRICTION.sub(b"", data[slice(*span.child)])
            edits.append((*span.child, element if b"=" in element else b""))
    return edited(data, [*edits, *_massless(urdf, source), _at_end(data, added)]).decode()


def _massless(urdf: str, source: str) -> list[Edit]:
    """Edits that delete inertials without a mass, as Drake reads such a link as one of 1 kg."""
    weightless = [
        link.get("name")
        for link in read_xml(urdf, source).findall("link")
        if (mass := link.find("inertial/mass")) is not None and float(mass.get("value", 0.0)) == 0.0
    ]
    spans = spans_of(urdf.encode(), _ROBOT, "link", "inertial")
    return [(*span.child, b"") for name in weightless if name and (span := spans[name]).child]


def _transmission(joint: str, inside: str) -> str:
    name = _quoted(joint)
    return (
        f"  <transmission name={_quoted(joint + '_transmission')}>\n"
        f"    <type>transmission_interface/SimpleTransmission</type>\n    <joint name={name}/>\n"
        f"    <actuator name={name}>\n      {inside}\n    </actuator>\n  </transmission>\n"
    )


def _quoted(text: str) -> str:
    """Quote a text as the value of an attribute."""
    from xml.sax.saxutils import quoteattr  # noqa: PLC0415 it imports code that opens URLs

    return quoteattr(text)


def for_gazebo(urdf: str, effects: Iterable[KnownEffect]) -> str:
    """Add springs to ``urdf`` as elements ``<gazebo>`` of joints (SDFormat's extensions to URDF)."""
    data = urdf.encode()
    added = "".join(
        f"  <gazebo reference={_quoted(joint)}>\n"
        + "".join(f"    <{name}>{value:.9g}</{name}>\n" for name, value in attributes.items())
        + "  </gazebo>\n"
        for joint, attributes in joint_attributes(effects, "gazebo").items()
    )
    return edited(data, [_at_end(data, added)]).decode()


class MeshFinder:
    """Finds the file of a URDF's mesh URI."""

    def __init__(self, urdf: Path, packages: Mapping[str, Path]) -> None:
        """Set where meshes are searched. ``packages``: folders by package name, which take precedence. Other packages
        are searched above the ``urdf``, in ROS_PACKAGE_PATH and in AMENT_PREFIX_PATH."""
        self._folder = urdf.resolve().parent
        self._packages = packages

    def find(self, uri: str, where: str) -> Path:
        """Find the file of a ``package://`` or ``file://`` URI or a path; relative paths start at the URDF's folder.

        Raises InputError beginning with ``where``.
        """
        scheme, separator, rest = uri.partition("://")
        if not separator:
            candidates = [self._folder / uri]
        elif scheme == "file":
            candidates = [Path(unquote(rest))]
        elif scheme == "package":
            package, _, inside = unquote(rest).partition("/")
            candidates = [folder / inside for folder in self._folders(package)]
        else:
            raise InputError(f"{where}: the mesh '{uri}' is neither a package:// nor a file:// URI nor a path")
        for path in candidates:
            if path.exists() and not path.is_dir():
                return path
        raise InputError(f"{where}: the mesh '{uri}' was not found. {_advice(uri, candidates)}")

    def _folders(self, package: str) -> list[Path]:
        if package in self._packages:
            return [self._packages[package]]
        above = [folder for folder in (self._folder, *self._folder.parents) if folder.name == package]
        sources = [Path(folder) for folder in _path_list("ROS_PACKAGE_PATH")]
        above += [folder for source in sources for folder in (source, source / package) if folder.name == package]
        return above + [Path(prefix) / "share" / package for prefix in _path_list("AMENT_PREFIX_PATH")]


def _path_list(variable: str) -> list[str]:
    return [part for part in os.environ.get(variable, "").split(os.pathsep) if part]


def _advice(uri: str, candidates: list[Path]) -> str:
    looked = f"Looked in {', '.join(map(str, candidates))}. " if candidates else ""
    if not uri.startswith("package://"):
        return looked.rstrip()
    package = uri.removeprefix("package://").partition("/")[0]
    return f"{looked}Locate the package: --package-path {package}=FOLDER, or source its workspace"
