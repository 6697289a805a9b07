"""Comparison of two results of one robot."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from math import nan
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from geomid_ros.api.robot import identified_urdf_path
from geomid_ros.api.verify import read_test_samples
from geomid_ros.checks.verdict import recording_verdict
from geomid_ros.errors import InputError
from geomid_ros.estimation.comparison import Difference, RobotValues, compare_robots
from geomid_ros.estimation.estimate import UncertainInertia
from geomid_ros.exports.model import ExportModel, read_model
from geomid_ros.exports.payload import Summand, total
from geomid_ros.files.models.effects_file import coefficients_of, effect_name, with_places
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.files.schema import attributes_entry, to_document
from geomid_ros.geometry.pseudo_inertia import nearest_body
from geomid_ros.model.urdf_tree import read_xml
from geomid_ros.options import takes
from geomid_ros.report.result_pages import ChannelErrors, ComparisonPage, write_comparison_page
from geomid_ros.session.options import CompareOptions, PathLike, paths
from geomid_ros.session.session import Session

_OWN = "the held-out data of its own recording"


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison(ComparisonPage):
    """Two results of one robot side by side.

    Attributes:
        first, second: the files.
        compared: all numbers, and the links that have changed.
        errors: residual RMS of both results, by channel.
        judged_on: the data that these errors are computed on.
        doubts: reasons not to trust a result or the recording, in sentences.
        notes: remarks, in sentences.
        status: exit status of the worse verdict of the two.
    """

    status: int

    @property
    def differing(self) -> list[Difference]:
        """Numbers that differ by more than their joint 95 % intervals, the most significant first."""
        return self.compared.differing

    @property
    def document(self) -> dict[str, Any]:
        """The whole comparison as a dictionary, for programs."""
        numbers = ("place", "effect", "parameter", "first", "second", "differs")
        return attributes_entry(self, "first", "second", "judged_on", "doubts", "notes") | {
            "differences": [
                attributes_entry(each, *numbers) | {"joint_interval": to_document(each.half_width)}
                for each in self.compared.differences
            ],
            "changed_links": to_document(self.compared.changed),
            "not_compared": to_document(self.compared.not_compared),
            "errors": [
                {"channel": each.name} | attributes_entry(each, "unit", "first", "second") for each in self.errors
            ],
        }

    def report(self, path: PathLike) -> Path:
        """Write the comparison as one HTML page. The page needs no network.

        Args:
            path: the file.

        Returns:
            The same path.

        Raises:
            GeomidError: the file cannot be written.
        """
        write_comparison_page(Path(path), self)
        return Path(path)

    def __repr__(self) -> str:
        """List the differences, one line each."""
        sentences = [*(link.sentence for link in self.compared.changed), *(each.sentence for each in self.differing)]
        heading = f"{self.first} and {self.second}: {len(sentences) or 'nothing'} beyond chance"
        return "\n".join([*self.doubts, heading, *(f"  {sentence}" for sentence in sentences)])


@takes(CompareOptions)
def compare(options: CompareOptions) -> Comparison:
    """Compare two results of one robot, or a result and a URDF.

    ``geomid compare`` calls this; its options have the same names. Without ``urdf``, the identified.urdf in the folder
    of each result is used.

    Raises:
        InputError: a file cannot be used, or they are of different robots.
    """
    first, second = options.first, options.second
    files = [Path(path) for path in (first, second)]
    sides = [EstimateFile.read(file) if file.suffix == ".json" else read_model(file) for file in files]
    results = [side for side in sides if isinstance(side, EstimateFile)]
    if not results:
        raise InputError(f"{first}, {second}: neither is an estimate.json; at least one must have standard deviations")
    values = [side.values if isinstance(side, EstimateFile) else _urdf_values(side, results[0]) for side in sides]
    _check_same_robot(sides, values)
    doubts = [doubt for result in results for doubt in result.doubts]
    status = max(result.judgement.status for result in results)
    errors = [_stated_errors(side, results[0]) for side in sides]
    units = {row.channel: row.unit for result in results for row in result.channels}
    if options.bag:
        predicted = [_errors_on_bags(side, options) for side in sides]
        errors = [rms for _, rms in predicted]
        units = {channel.name: channel.unit for session, _ in predicted for channel in session.model.channels}
        verdicts = [recording_verdict(session.review.findings) for session, _ in predicted]
        doubts += [reason for verdict in verdicts for reason in verdict.reasons]
        status = max(status, *(verdict.status for verdict in verdicts))
    before, after = errors
    return Comparison(
        first=str(first),
        second=str(second),
        compared=compare_robots(values[0], values[1]),
        errors=[
            ChannelErrors(name=name, unit=units.get(name, ""), first=before.get(name, nan), second=after.get(name, nan))
            for name in dict.fromkeys((*before, *after))
        ],
        judged_on=", ".join(map(str, paths(options.bag))) if options.bag else _OWN,
        doubts=list(dict.fromkeys(doubts)),
        notes=[
            *_notes_on(results, own_data=not options.bag),
            *(note for side in sides if isinstance(side, ExportModel) for note in _notes_on_urdf(side)),
            *_only_in_one((first, second), values),
        ],
        status=status,
    )


_Side: TypeAlias = EstimateFile | ExportModel
"""One side of a comparison: a result, or a URDF."""


def _stated_errors(side: _Side, result: EstimateFile) -> Mapping[str, float]:
    """Residual RMS by channel as stated in results; none of a URDF, unless the ``result`` was identified from it."""
    if isinstance(side, EstimateFile):
        return side.rms.held_out or side.rms.train
    digest = sha256(side.urdf.encode(errors="replace")).hexdigest()
    given = digest in str(result.origin.get("files"))  # this entry is for people: a file may have anything there
    return {row.channel: row.urdf for row in result.channels} if given else {}


def _robot(side: _Side) -> str:
    """Return the name of the robot; empty if neither the result nor its identified.urdf gives one."""
    if not isinstance(side, EstimateFile):
        return ""
    urdf = identified_urdf_path(side.source)
    return side.robot or (read_xml(read_urdf(urdf), str(urdf)).get("name", "") if urdf.is_file() else "")


def _urdf_values(model: ExportModel, result: EstimateFile) -> RobotValues:
    """Return the values of a URDF for the bodies of a result, with zero standard deviations.

    Raises:
        InputError: the URDF lacks a link, a link lacks an inertial, or a body has no mass.
    """
    links = {}
    for name, body in result.values.links.items():
        parts = [link for link in (name, *sorted(body.merged)) if link in model.bodies]
        if name not in model.tree.links:
            raise _other_robot(model.source, model.tree.links, result.source, result.values.links)
        if not parts:
            raise InputError(f"{model.source}: link '{name}' has no <inertial>, and {result.source} has identified it")
        terms = [Summand(_repaired(model.bodies[link]), model.placement(link, name), 1.0) for link in parts]
        inertia = total(terms, f"{model.source}: link '{name}'")
        links[name] = replace(inertia, std=np.zeros(10), merged=body.merged)
    return RobotValues(links=links, effects=model.effects)


def _repaired(body: UncertainInertia) -> UncertainInertia:
    """Return the body as :class:`~geomid_ros.model.robot.Robot` reads it, with moments that are possible."""
    return replace(body, parameters=nearest_body(body.parameters)) if body.mass > 0.0 else body


def _notes_on_urdf(model: ExportModel) -> list[str]:
    """Return a remark on the links whose moments are raised."""
    names = [name for name, body in model.bodies.items() if _repaired(body).parameters is not body.parameters]
    return [f"{model.source}: not physically consistent, moments are raised: {', '.join(names)}"] if names else []


def _check_same_robot(sides: Sequence[_Side], values: Sequence[RobotValues]) -> None:
    """Refuse results of different robots: no common link, or both names and bodies differ. Raises InputError."""
    first, second = values
    names = [_robot(side) for side in sides]
    bodies = [{name: {*link.merged} for name, link in each.links.items()} for each in values]
    different = all(names) and names[0] != names[1] and bodies[0] != bodies[1]
    if different or not first.links.keys() & second.links.keys():
        first_source, second_source = (
            f"{side.source} ('{name}')" if name else side.source for side, name in zip(sides, names, strict=True)
        )
        raise _other_robot(second_source, second.links, first_source, first.links)


def _other_robot(source: str, links: Iterable[str], other: str, other_links: Iterable[str]) -> InputError:
    return InputError(
        f"{source}: a model of another robot than {other}. Links of {source}: {', '.join(links)}; of {other}: "
        f"{', '.join(other_links)}"
    )


def _notes_on(results: Sequence[EstimateFile], *, own_data: bool) -> list[str]:
    """Return remarks on the comparison; with ``own_data`` also on errors, each on the data of its result."""
    exact = [r.source for r in results if not any(link.has_std for link in r.values.links.values())]
    fitted = [r.source for r in results if own_data and r.rms.train and not r.rms.held_out]
    return [
        *(f"{path} has no standard deviations; its links are treated as exact" for path in exact),
        *(f"{path} has no held-out data; its errors are training errors" for path in fitted),
    ]


def _only_in_one(sources: Sequence[PathLike], values: Sequence[RobotValues]) -> Iterator[str]:
    """Yield a remark on the effects, or parts of them, that the other result has not: they differ from nothing."""
    keys = [
        {
            (name, effect.location)
            for effect in each.effects
            for name in (effect.effect, *(part.name for part in effect.cls.grid()[0].parts))
        }
        for each in values
    ]
    for source, own, others in zip(sources, keys, reversed(keys), strict=True):
        if own - others:
            named = with_places((effect_name(effect), place) for effect, place in sorted(own - others))
            yield f"only {source} has {', '.join(named)}"


def _errors_on_bags(side: _Side, options: CompareOptions) -> tuple[Session, dict[str, float]]:
    """Return the session that read the recordings for a side, and the residual RMS of the side by channel."""
    if isinstance(side, EstimateFile):
        session, samples = read_test_samples(options, options.bag, model=side.source)
        parameters = session.known_parameters
    else:
        effects = list(dict.fromkeys(effect.effect for effect in side.effects))
        session, samples = read_test_samples(replace(options, urdf=side.source), options.bag, effects=effects)
        coefficients = coefficients_of(session.model, side.effects)  # the friction in the URDF
        parameters = np.concatenate([session.model.nominal_parameters[: -len(coefficients) or None], coefficients])
    names = [channel.name for channel in session.model.channels]
    return session, dict(zip(names, session.rms(samples, parameters).tolist(), strict=True))
