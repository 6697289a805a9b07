"""Identification of link inertias from rosbags: estimate, prediction error, verdict and files."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomid_ros.api.rebuild import tables, write_tables
from geomid_ros.api.robot import configuration, description, recordings
from geomid_ros.checks.candidates import ROUNDS
from geomid_ros.checks.moving_base import never_lifted
from geomid_ros.checks.verdict import DOUBTFUL, Verdict
from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import STDS_OF_95, EffectEstimate, Estimate, LinkEstimate
from geomid_ros.estimation.suggested_motions import suggested_motions
from geomid_ros.exports.handover import DescriptionTest, FileTest
from geomid_ros.files.disk import staged, write_json, write_text
from geomid_ros.files.models.effects_file import write_sidecar
from geomid_ros.files.models.estimate_file import EstimateFile, model_effects
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.files.models.posterior import POSTERIOR, write_posterior
from geomid_ros.files.models.readers import READERS, URDF, with_same_files
from geomid_ros.gap.features import KnownRemainder
from geomid_ros.model.channels import Channel
from geomid_ros.model.effects import GravityEffect, LoadEffect, effect_class
from geomid_ros.model.samples import Samples
from geomid_ros.options import Progress, silent, takes
from geomid_ros.report.result_pages import write_identification_page
from geomid_ros.report.series import Series, series_of
from geomid_ros.session.gap import remainder_of
from geomid_ros.session.options import IdentifyOptions, PathLike
from geomid_ros.session.recordings import Bags, read_fitted, train
from geomid_ros.session.session import Session, document, identified_urdf, installed_version
from geomid_ros.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from geomid_ros.resimulation.resimulate import Tracking

DELAY = "command.delay"
"""Configuration parameter for the delay of commands; the identification estimates it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification:
    """Result of an identification, and its files.

    Attributes:
        session: the robot, its model and its configuration.
        bags: the recordings.
        estimate: result of the solver.
        judged: the samples that the result is tested on, in batches: the held-out ones, or all fitted ones if nothing
            was held out.
        reader: software that will read the robot description.
        command: topic of the joint set-points, to simulate the robot under them.
    """

    session: Session
    bags: Bags
    estimate: Estimate
    judged: Sequence[Samples]
    reader: str = URDF
    command: str | None = None

    @property
    def held_out(self) -> Sequence[Samples]:
        """The held-out samples, in batches; empty if nothing was held out."""
        return self.judged if self.bags.holds_out else ()

    @property
    def links(self) -> tuple[LinkEstimate, ...]:
        """Links with mass, centre of mass, inertia and their standard deviations."""
        return self.estimate.links

    @property
    def effects(self) -> tuple[EffectEstimate, ...]:
        """Coefficients of the effects with their standard deviations."""
        return self.estimate.effects

    @property
    def rms(self) -> dict[str, float]:
        """Residual RMS of the estimate by channel [N m, N], on held-out data, or the fitted data if there are none.
        NaN for a channel that was not measured."""
        return self._by_channel(self._rms_on_judged[:, 1])

    @property
    def warnings(self) -> list[str]:
        """Warnings on the result, as sentences, in addition to the :attr:`verdict`."""
        return self.session.review.warnings(self.estimate, self.verdict)

    @cached_property
    def verdict(self) -> Verdict:
        """Verdict on the result: ``usable``, ``doubtful`` or ``not converged``, with the reasons."""
        verdict = self.session.review.verdict(self.estimate, self.judged, self.held_out_rms)
        if verdict.explains_all:
            return verdict
        beside = [] if self._urdf_test is None else [*self._urdf_test.worse, *self._urdf_test.limited]
        verdict = replace(verdict, warnings=(*verdict.warnings, *self.handover.limited, *beside))
        worse = self.handover.worse
        return replace(verdict, word=DOUBTFUL, reasons=(*verdict.reasons, *worse)) if worse else verdict

    @cached_property
    def written(self) -> DescriptionTest:
        """Robot description written for :attr:`reader`."""
        return DescriptionTest(self.session, self.estimate, self.reader)

    @cached_property
    def handover(self) -> FileTest:
        """Prediction error of :attr:`written` on :attr:`judged`, loaded again by MuJoCo or pinocchio.

        Raises:
            InputError: that program rejects it.
        """
        return self.written.evaluate(self.judged, self.rms)

    @cached_property
    def _urdf_test(self) -> FileTest | None:
        """Prediction error of identified.urdf, if :attr:`written` is another file that can represent more."""
        urdf = DescriptionTest(self.session, self.estimate, URDF)
        if self.written.name == urdf.name:
            return None
        test = urdf.evaluate(self.judged, self.rms)
        if test.omissions == self.handover.omissions:
            return None
        return replace(test, fuller_file=self.written.name) if self.reader in test.fuller else test

    @cached_property
    def train(self) -> Sequence[Samples]:
        """The fitted samples, in batches; read from the bags again if others are held out, as they are not kept."""
        if not self.held_out:
            return self.judged
        return read_fitted(self.session.again(), self.bags)

    @property
    def rms_nominal(self) -> dict[str, float]:
        """Residual RMS of the URDF by channel [N m, N], with its inertias and the friction in its ``<dynamics>``."""
        return self._by_channel(self._rms_on_judged[:, 0])

    @property
    def held_out_rms(self) -> FloatArray | None:
        """Residual RMS on held-out data ``(channels,)``; None if nothing was held out."""
        return self._rms_on_judged[:, 1] if self.held_out else None

    @cached_property
    def _rms_on_judged(self) -> FloatArray:
        """Residual RMS of the URDF and of the estimate ``(channels, 2)``."""
        if not self.held_out:
            return np.column_stack([self.estimate.rms_nominal, self.estimate.rms])
        both = self.estimate.predictor.beside(self.session.model.described_parameters)
        return self.session.rms(self.held_out, *both)[:, ::-1]

    @cached_property
    def tracking(self) -> Tracking | None:
        """Deviation of a robot built from :attr:`written` from the measured one under the recorded commands, simulated
        in MuJoCo on the held-out data; None without a :attr:`command`.

        Raises:
            InputError: MuJoCo is not installed, nothing is held out, or the topic cannot be read.
        """
        if self.command is None:
            return None
        from geomid_ros.session.written_simulation import tracking_of  # noqa: PLC0415 rarely needed

        return tracking_of(self.session.again(), self.written.model, self.bags, self.command)

    def _by_channel(self, values: FloatArray) -> dict[str, float]:
        return dict(zip(self.estimate.channels, values.tolist(), strict=True))

    @property
    def document(self) -> dict[str, Any]:
        """All numbers, as in ``estimate.json``, but without their origin."""
        entries = document(self.session, self.estimate, self.held_out_rms, self.verdict)
        entries["handover"][self.reader] |= self.handover.entry
        entries["notes"] = self.notes
        if self.tracking is not None:
            entries["handover"][self.reader]["tracking"] = dict(self.tracking.rms)
        model = self.session.model
        masses = model.nominal_inertias.reshape(-1, 10)[:, 0].tolist()
        return entries | {
            "urdf_masses": dict(zip(model.body_names, masses, strict=True)),
            "channels": [self._channel(channel) for channel in model.channels if math.isfinite(self.rms[channel.name])],
            "telling": self._suggested_motions,
        }

    def _channel(self, channel: Channel) -> dict[str, Any]:
        """Residual RMS of a channel: URDF, estimate, and written file."""
        return {
            "channel": channel.name,
            "unit": channel.unit,
            "judged_on": self.judged_on,
            "urdf": self.rms_nominal[channel.name],
            "identified": self.rms[channel.name],
            "file": self.handover.alone[channel.name],
            "file_with_offsets": self.handover.corrected[channel.name],
        }

    @cached_property
    def _suggested_motions(self) -> dict[str, dict[str, list[str]]]:
        """Quantities that a motion would identify, by link and motion."""
        return suggested_motions(self.session.model, self.estimate)

    @property
    def judged_on(self) -> str:
        """Name of the data in :attr:`judged`."""
        return "held-out data" if self.held_out else "fitted data"

    @property
    def notes(self) -> list[str]:
        """Remarks that make nothing doubtful, as sentences: on the recordings, and on what the description for
        :attr:`reader` omits, or this ignores."""
        return [*self.session.notes, *filter(None, [self.handover.note]), *self.written.omissions]

    def __repr__(self) -> str:
        """Reasons for doubt, the state of convergence, and a line for each link."""
        state = "converged" if self.estimate.converged else f"NOT converged ({self.estimate.reason})"
        lines = [
            f"  {link.name}: {link.mass:.3f} ± {link.std_mass:.3f} kg, {100 * link.from_data:.0f} % from data"
            for link in self.links
        ]
        heading = f"Identification of {self.session.robot.name}: {self.estimate.rows_accepted} rows, {state}"
        return "\n".join([*self.verdict.remarks, heading, *lines])

    def urdf(self) -> str:
        """Return the URDF with the identified inertias and friction; only names of files, which become absolute,
        change besides."""
        return identified_urdf(self.session, self.estimate)

    def plot(self) -> Figure:
        """Draw the bodies before and after, and the channels measured and predicted."""
        from geomid_ros.report.drawing import draw_identification  # noqa: PLC0415 imports matplotlib

        remarks = self.verdict.remarks
        return draw_identification(self.session, self.estimate, self.judged, self._series, self.judged_on, remarks)

    @cached_property
    def _series(self) -> Sequence[Series]:
        """The channels, measured and predicted."""
        return series_of(self.session, self.estimate, self.judged)

    def _document(self, command: str) -> dict[str, Any]:
        """Return all numbers with their origin: the program, the command line, and the files read."""
        urdf = hashlib.sha256(self.session.urdf.encode(errors="replace")).hexdigest()
        origin = {
            "version": installed_version(),
            "command": command,
            "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC"),
            "files": [
                [f"{self.session.robot.source} (SHA-256 {urdf})", "robot"],
                *([str(path), _recording(share)] for path, share in self.bags.held_out_fractions),
            ],
            "configuration": self.session.configuration.given_values,
        }
        return self.document | {"origin": origin}

    def report(self, path: PathLike, *, command: str = "geomid_ros.identify") -> Path:
        """Write one HTML page with all results and plots. The page needs no network.

        Args:
            path: the file.
            command: the command line, for the page.

        Returns:
            The same path.

        Raises:
            GeomidError: the file cannot be written.
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
        report.html, and the description for :attr:`reader`. If one cannot be written, none is.

        Args:
            folder: created if it does not exist.
            report: whether to write identification.png and report.html, which are for people.
            progress: called with the current stage and its completed fraction, 0 to 1.
            command: the command line, for the report.

        Returns:
            The files.

        Raises:
            GeomidError: a file cannot be written.
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
        estimated = model_effects(self.estimate, self.session.loaded.effects)
        write_sidecar(sidecar, self.session.robot.name, self.written.model.effects, estimated=estimated)
        document = self._document(command)
        write_json(folder / "estimate.json", document)
        posterior = write_posterior(folder / POSTERIOR, self.estimate.posterior, self._remainder(folder, progress))
        csv = write_tables(folder, tables(document))
        written = [folder / name for name in ("estimate.json", *texts)]
        return [*written, sidecar, *posterior, *csv]

    def _write_report(self, folder: Path, progress: Progress, command: str) -> list[Path]:
        from geomid_ros.report.pictures import write_picture  # noqa: PLC0415 imports matplotlib

        picture = folder / "identification.png"
        progress("drawing", 0.0)
        write_picture(picture, self.plot())
        return [picture, self.report(folder / "report.html", command=command)]

    def _remainder(self, folder: Path, progress: Progress) -> KnownRemainder | None:
        """Return the remainder of the estimate in ``folder`` on the bags, as ``geomid gap --model`` will compute it.
        Return None and add a note if it cannot be computed: the estimate is worth keeping without it."""
        written = {"model": str(folder / "estimate.json"), "prior": "", "effects": [], "candidates": []}
        try:
            return remainder_of(self.session.again(written), self.bags, progress)
        except (GeomidError, np.linalg.LinAlgError) as error:
            self.session.review.settled.append(f"{POSTERIOR} does not contain the remainder of the model: {error}")
            return None


@takes(IdentifyOptions)
def identify(options: IdentifyOptions) -> Identification:
    """Identify link inertias and joint effects from rosbags.

    The result is tested on held-out data: the end of each bag, or the bags of ``validate``.
    ``geomid identify`` calls this; its options have the same names, but ``--for`` for ``reader``.

    Raises:
        InputError: a file, an argument or the data cannot be used; the message names it and says what to do.
    """
    recorded = replace(recordings(options, options.bags), unloaded=True)
    only_effects = options.effects is not None and options.candidates is None
    parameters = configuration(options, options.model, **({"candidates": []} if only_effects else {}))
    robot = description(options, recorded.fitted, options.model)
    known: LoadedModel | None = None  # the robot as first found
    # Whether it repeats to see if legs were in the air beside the friction that was found; the number of rows before.
    unlifted, rows = False, 0
    for rounds_left in range(ROUNDS, -1, -1):
        make, read = partial(Session, readers=READERS, loads=known), partial(_read, recorded, options.progress)
        session, judged = robot.read(make, parameters, read)
        session.review.check_description()
        recorded = replace(recorded, unloaded=False, left_out=session.review.left_out)  # as is known now
        first = known is None and session.prior is None
        if not unlifted or session.identifier.counts.taken != rows:
            options.progress("solving", 0.0)
            changes = partial(_changes_rows, first=first)
            estimate = session.identifier.solve_unless(changes) if rounds_left else session.identifier.solve()
            rows = estimate.rows_accepted
        again = bool(rounds_left) and _changes_rows(estimate, first=first)
        unlifted = bool(rounds_left) and first and not again and bool(never_lifted(session.model, estimate))
        if not again and not unlifted:
            break
        if (delay := _command_delay(estimate)) is not None:
            parameters = parameters.with_values({DELAY: parameters[DELAY] + delay})
        if first and (unlifted or _depends_on_links(estimate)):
            known = _found_robot(session, estimate)
    if parameters[DELAY]:
        session.review.settled.append(f"commands act {1e3 * parameters[DELAY]:.1f} ms after their stamps")
    return Identification(
        session=session,
        bags=recorded,
        estimate=estimate,
        judged=judged,
        reader=with_same_files(options.reader),
        command=options.command,
    )


def _changes_rows(estimate: Estimate, *, first: bool) -> bool:
    """True if rows are to be made anew by what an estimate found: a delay of commands, or at ``first`` effects whose
    columns are those of the links."""
    return _command_delay(estimate) is not None or (first and _depends_on_links(estimate))


def _depends_on_links(estimate: Estimate) -> bool:
    """True if the columns of an effect are those of links known beforehand: a tilt, friction by load."""
    kinds = (effect_class(effect.name) for effect in estimate.effects)
    return any(issubclass(kind, GravityEffect | LoadEffect) for kind in kinds)


def _found_robot(session: Session, estimate: Estimate) -> LoadedModel:
    """Links and effects of an estimate, for :class:`Session`, which takes them to be known."""
    bodies = estimate.parameters[: len(session.model.nominal_inertias)].reshape(-1, 10)
    effects = (effect for effect in model_effects(estimate, ()) if effect.cls.has_columns)
    return LoadedModel(inertias=dict(zip(session.model.body_names, bodies, strict=True)), effects=tuple(effects))


def _command_delay(estimate: Estimate) -> float | None:
    """Return the identified delay of commands [s], or None if it is not significant. The model is first order in the
    delay, so :func:`identify` applies it and repeats, at most :data:`ROUNDS` times."""
    delays = (effect for effect in estimate.effects if effect_class(effect.name).place == "commands")
    return next((effect.value for effect in delays if abs(effect.value) > STDS_OF_95 * effect.std), None)


def _recording(share: float) -> str:
    """Describe the use of a recording of which ``share`` is held out."""
    if share >= 1.0:
        return "recording, held out"
    return "recording, fitted" + (f" except the last {100.0 * share:.0f} %" if share > 0.0 else "")


def _read(bags: Bags, progress: Progress, session: Session) -> list[Samples]:
    """Return the samples to test on: the held-out ones, or all fitted ones if none are held out."""
    if bags.holds_out:
        return train(session, bags, progress)
    fitted: list[Samples] = []
    train(session, bags, progress, fitted.append)
    return fitted
