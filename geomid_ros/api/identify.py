"""Identification of link inertias from rosbags."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomid_ros.api.identification import IdentificationSummary
from geomid_ros.api.options import IdentifyOptions
from geomid_ros.api.robot import configuration, description, recordings
from geomid_ros.checks.candidates import ROUNDS
from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.uncertain_inertia import STDS_OF_95
from geomid_ros.files.disk import staged, write_json, write_text
from geomid_ros.files.models.effects_file import write_sidecar
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.files.models.posterior import POSTERIOR, write_posterior
from geomid_ros.files.models.readers import READERS
from geomid_ros.files.models.tables import tables, write_tables
from geomid_ros.gap.evidence.features import StandingRemainder
from geomid_ros.model.effects import effect_class
from geomid_ros.model.samples import Samples
from geomid_ros.options import Progress, silent, takes
from geomid_ros.report.result_pages import write_identification_page
from geomid_ros.report.series import Series, series_of
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.gap import gap_session, remainder_of
from geomid_ros.session.options import PathLike
from geomid_ros.session.recordings import Bags, read_bags
from geomid_ros.session.session import Session, identified_urdf, installed_version
from geomid_ros.session.training import Training

if TYPE_CHECKING:
    from matplotlib.figure import Figure


DELAY = "command.delay"
"""The parameter that an identification finds of commands."""


class Identification(IdentificationSummary):
    """Result of an identification, and its files."""

    def urdf(self) -> str:
        """The robot description with the identified inertias and friction; every other character is kept."""
        return identified_urdf(self.session, self.estimate)

    def plot(self) -> Figure:
        """Draw the bodies before and after, and the channels measured and predicted."""
        from geomid_ros.report.drawing import draw_identification  # noqa: PLC0415 matplotlib, for pictures alone

        return draw_identification(self.session, self.estimate, self.judged, self._series, self.judged_on)

    @cached_property
    def _series(self) -> Sequence[Series]:
        """The channels, measured and predicted."""
        return series_of(self.session, self.estimate, self.judged)

    def _document(self, command: str) -> dict[str, Any]:
        """All numbers with where they are from: the program, what was run, and what was read."""
        urdf = hashlib.sha256(self.session.urdf.encode(errors="replace")).hexdigest()
        origin = {
            "version": installed_version(),
            "command": command,
            "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC"),
            "files": [
                [f"{self.session.robot.source} (SHA-256 {urdf})", "robot"],
                *([str(path), _recording(share)] for path, share in self.bags.shares),
            ],
            "configuration": self.session.configuration.given,
        }
        return self.document | {"origin": origin}

    def report(self, path: PathLike, *, command: str = "geomid_ros.identify") -> Path:
        """Write one HTML page with all results and plots, which needs no network.

        Args:
            path: the file.
            command: the command line, for the page.

        Returns:
            The same path.

        Raises:
            InputError: the file cannot be written.
        """
        file = EstimateFile.of(self._document(command), "estimate.json")
        write_identification_page(Path(path), file, self._series)
        return Path(path)

    def save(
        self,
        folder: PathLike,
        *,
        report: bool = True,
        progress: Progress = silent,
        command: str = "geomid_ros.identify",
    ) -> list[Path]:
        """Write estimate.json, identified.urdf, effects.yaml, posterior.npz, tables (CSV), identification.png,
        report.html, and the description for :attr:`reader`: all of them, or none.

        Args:
            folder: created if it does not exist.
            report: whether to write identification.png and report.html, which are for people.
            progress: called with the current stage and its completed share, 0 to 1.
            command: the command line, for the report.

        Returns:
            The files.

        Raises:
            InputError: a file cannot be written.
        """
        with staged(Path(folder)) as stage:
            files = self._write(stage, progress, command)
            files += self._write_report(stage, progress, command) if report else []
        return [Path(folder) / file.name for file in files]

    def _write(self, folder: Path, progress: Progress, command: str) -> list[Path]:
        texts = {"identified.urdf": self.urdf(), **self.written.files}
        for name, text in texts.items():
            write_text(folder / name, text)
        sidecar = folder / "effects.yaml"
        write_sidecar(sidecar, self.session.robot.name, self.written.model.effects)
        document = self._document(command)
        write_json(folder / "estimate.json", document)
        posterior = write_posterior(folder / POSTERIOR, self.estimate.posterior, self._remainder(folder, progress))
        csv = write_tables(folder, tables(document))
        written = [folder / name for name in ("estimate.json", *texts)]
        return [*written, sidecar, *posterior, *csv]

    def _write_report(self, folder: Path, progress: Progress, command: str) -> list[Path]:
        from geomid_ros.report.pictures import write_picture  # noqa: PLC0415 as above

        picture = folder / "identification.png"
        progress("drawing", 0.0)
        write_picture(picture, self.plot())
        return [picture, self.report(folder / "report.html", command=command)]

    def _remainder(self, folder: Path, progress: Progress) -> StandingRemainder | None:
        """What the estimate in a folder lacks on the bags, as ``geomid gap --model`` will see it; None, and that is
        told, where it cannot be found: the estimate is worth keeping without it."""
        urdf, configuration, source = self.same_again
        written = configuration.with_values({"model": str(folder / "estimate.json"), "prior": ""})
        try:
            return remainder_of(gap_session(urdf, written, source), self.bags, progress)
        except (GeomidError, np.linalg.LinAlgError) as error:
            self.session.review.settled.append(f"{POSTERIOR}: without what the model leaves unexplained: {error}")
            return None


@takes(IdentifyOptions)
def identify(options: IdentifyOptions) -> Identification:
    """Identify link inertias and joint effects from rosbags.

    The result is tested on held-out data: the end of each bag, or the bags of ``validate``.
    ``geomid identify`` calls this; its options have the same names, but ``--for`` for ``reader``.

    Raises:
        InputError: a file, an argument or the data cannot be used; the message names it and says what to do.
    """
    recorded = recordings(options, options.bags)
    alone = options.effects is not None and options.candidates is None
    parameters = configuration(options, options.model, **({"candidates": []} if alone else {}))
    robot = description(options, recorded.fitted, options.model)

    def solved(parameters: Configuration) -> tuple[Session, list[Samples], list[Samples], Estimate]:
        make = partial(Session, readers=(*READERS,))
        session, (held_out, judged) = robot.read(
            make, parameters, lambda session: _read(session, recorded, options.progress)
        )
        session.review.check_description()
        options.progress("solving", 0.0)
        return session, held_out, judged, session.identifier.solve()

    session, held_out, judged, estimate = solved(parameters)
    for _ in range(ROUNDS):
        if (delay := _late(estimate)) is None:
            break
        parameters = parameters.with_values({DELAY: parameters[DELAY] + delay})
        session, held_out, judged, estimate = solved(parameters)
    if parameters[DELAY]:
        session.review.settled.append(f"commands act {1e3 * parameters[DELAY]:.1f} ms after their stamps")
    return Identification(
        session=session,
        bags=recorded,
        estimate=estimate,
        held_out=held_out,
        judged=judged,
        reader=options.reader,
        command=options.command,
    )


def _late(estimate: Estimate) -> float | None:
    """How late commands act [s], if they do: a delay is identified to first order, as it becomes smaller exactly."""
    delays = (effect for effect in estimate.effects if effect_class(effect.name).place == "commands")
    return next((effect.value for effect in delays if abs(effect.value) > STDS_OF_95 * effect.std), None)


def _recording(share: float) -> str:
    """What a recording is for, of which a share is held out."""
    if share >= 1.0:
        return "recording, held out"
    return "recording, fitted" + (f" except the last {100.0 * share:.0f} %" if share > 0.0 else "")


def _read(session: Session, bags: Bags, progress: Progress) -> tuple[list[Samples], list[Samples]]:
    """The samples that are held out, and those to judge on: the same, or all that were fitted."""
    training, train = Training(session), list[Samples]()

    def fit(samples: Samples) -> None:
        training.add(samples)
        if not bags.holds_out:
            train.append(samples)

    held_out = read_bags(session, bags, fit, progress)
    training.end()
    return held_out, held_out or train
