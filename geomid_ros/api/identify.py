"""From rosbags to the inertias of a robot's links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geomid_ros.api.arguments import Config, PathLike, Paths, Texts, bag_paths, configuration, description, entries
from geomid_ros.api.origin import origin
from geomid_ros.estimation.estimate import EffectEstimate, Estimate, LinkEstimate
from geomid_ros.estimation.telling_motions import telling_motions
from geomid_ros.files.models.effect_forms import unsaid
from geomid_ros.files.models.results import model_effects
from geomid_ros.model.samples import Samples
from geomid_ros.plausibility.verdict import Verdict
from geomid_ros.report.drawing import draw_identification, series_of
from geomid_ros.report.identification_page import IdentificationPage, write_identification_page
from geomid_ros.report.series import Series
from geomid_ros.report.sheet import write_picture
from geomid_ros.session.fitting import Fitting
from geomid_ros.session.locking import read_with_locked
from geomid_ros.session.recordings import Bags, Progress, Topics, read_bags, read_fitted, silent
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification:
    """What was identified.

    Attributes:
        session: the robot, its model and its configuration.
        bags: what was read.
        estimate: all that the solver found.
        held_out: the samples to judge on, in batches, which were not fitted; empty if nothing was held out.
        judged: the samples that it is judged on: those, or all that were fitted.
    """

    session: Session
    bags: Bags
    estimate: Estimate
    held_out: Sequence[Samples]
    judged: Sequence[Samples]

    @property
    def links(self) -> tuple[LinkEstimate, ...]:
        """The links with mass, centre of mass, inertia and their standard deviations."""
        return self.estimate.links

    @property
    def effects(self) -> tuple[EffectEstimate, ...]:
        """The effects' coefficients with their standard deviations."""
        return self.estimate.effects

    @property
    def rms(self) -> dict[str, float]:
        """RMS of what the estimate leaves unexplained, by channel [N m, N]: on held-out data, or on the fitted data if
        nothing was held out. NaN where nothing was measured."""
        return self._by_channel(self.estimate.rms if self.held_out_rms is None else self.held_out_rms)

    @property
    def warnings(self) -> list[str]:
        """What to know of the result, in sentences, beside the :attr:`verdict`."""
        return self.session.warnings(self.estimate, self.verdict)

    @cached_property
    def verdict(self) -> Verdict:
        """Whether the result can be used: ``usable``, ``doubtful`` or ``not converged``, and why not."""
        return self.session.verdict(self.estimate, self.judged, self.held_out_rms)

    @cached_property
    def train(self) -> Sequence[Samples]:
        """The samples that were fitted, in batches; where others are held out they are read once more, as they are not
        remembered."""
        if not self.held_out:
            return self.judged
        return read_fitted(Session(self.session.urdf, self.session.configuration, ""), self.bags)

    @cached_property
    def rms_nominal(self) -> dict[str, float]:
        """The same of the URDF: its inertias and no effects."""
        if not self.held_out:
            return self._by_channel(self.estimate.rms_nominal)
        return self._by_channel(self.session.rms(self.held_out, self.session.nominal_parameters))

    @cached_property
    def held_out_rms(self) -> FloatArray | None:
        """RMS of the residuals on held-out data ``(channels,)``; None if nothing was held out."""
        return self.session.rms(self.held_out, self.estimate.parameters) if self.held_out else None

    def _by_channel(self, values: FloatArray) -> dict[str, float]:
        return dict(zip(self.estimate.channels, values.tolist(), strict=True))

    @property
    def document(self) -> dict[str, Any]:
        """All numbers, as ``estimate.json`` has them."""
        return self.session.document(self.estimate, self.held_out_rms, self.verdict)

    def urdf(self) -> str:
        """The robot description with the identified inertias and friction; every other character of it is kept."""
        return self.session.identified_urdf(self.estimate)

    @property
    def not_in_urdf(self) -> str:
        """What :meth:`urdf` cannot say, or is too unsure to say, in a sentence; empty for nothing."""
        names = unsaid(model_effects(self.estimate, self.session.loaded.effects), ("urdf",))
        return f"identified.urdf does not say: {'; '.join(names)}" if names else ""

    def plot(self) -> Figure:
        """Draw the bodies, before and after, and the channels, measured and predicted."""
        return draw_identification(self.session, self.estimate, self.judged, self._series, self._of_what)

    @property
    def _of_what(self) -> str:
        return "held-out data" if self.held_out else "training data"

    @cached_property
    def _series(self) -> Sequence[Series]:
        """The channels, measured and predicted."""
        return series_of(self.session, self.estimate, self.judged)

    def report(self, path: PathLike, *, command: str = "geomid_ros.identify") -> Path:
        """Write everything with pictures on one HTML page that needs no network: whether the result can be used and for
        what, and all that it rests on.

        Args:
            path: the file.
            command: what was run, for the page.

        Returns:
            The same path.

        Raises:
            InputError: the file cannot be written.
        """
        session, estimate = self.session, self.estimate
        page = IdentificationPage(
            robot=session.robot.name,
            verdict=self.verdict,
            warnings=self.warnings,
            notes=session.notes,
            estimate=estimate,
            masses=session.model.nominal_inertias.reshape(-1, 10)[:, 0],
            effects=model_effects(estimate, session.loaded.effects),
            series=self._series,
            held_out=bool(self.held_out),
            telling=telling_motions(session.model, estimate),
            messages=session.pipeline.ledger.topics,
            refused_rows=session.identifier.rows_rejected,
            origin=origin(session, self.bags, command),
        )
        write_identification_page(Path(path), page)
        return Path(path)

    def save(
        self, folder: PathLike, *, progress: Progress = silent, command: str = "geomid_ros.identify"
    ) -> list[Path]:
        """Write estimate.json, identified.urdf, posterior.npz, identification.png and report.html.

        Args:
            folder: made if it does not exist.
            progress: called with what is being done.
            command: what was run, for the report.

        Returns:
            The files.

        Raises:
            InputError: a file cannot be written.
        """
        files = self.session.save(Path(folder), self.estimate, self.held_out_rms, self.verdict)
        progress("drawing", 0.0)
        picture = Path(folder) / "identification.png"
        write_picture(picture, self.plot())
        return [*files, picture, self.report(Path(folder) / "report.html", command=command)]

    def __repr__(self) -> str:
        """Why it should not be used, and a line for each link."""
        state = "converged" if self.estimate.converged else f"NOT converged ({self.estimate.reason})"
        lines = [
            f"  {link.name}: {link.mass:.3f} ± {link.std_mass:.3f} kg, {100 * link.from_data:.0f} % from data"
            for link in self.links
        ]
        heading = f"Identification of {self.session.robot.name}: {self.estimate.rows_accepted} rows, {state}"
        return "\n".join([*self.verdict.remarks, heading, *lines])


def identify(
    bags: Paths,
    urdf: PathLike | None = None,
    *,
    config: Config | None = None,
    model: PathLike | None = None,
    prior: PathLike | None = None,
    xacro_args: Texts = (),
    effects: Texts | None = None,
    candidates: Texts | None = None,
    links: Texts | None = None,
    known: Texts = (),
    floating_base: bool = False,
    wrench: Texts = (),
    joint_topic: str = "joint_states",
    odom_topic: str = "odom",
    hold_out: float | None = None,
    validate: Paths = (),
    progress: Progress = silent,
) -> Identification:
    """Identify link inertias and joint effects from rosbags.

    How well the result predicts is judged on data that were held out: the end of each bag, or the bags of ``validate``.
    ``geomid identify`` calls this; its options have the same names.

    Args:
        bags: rosbag folders, or .mcap and .db3 files.
        urdf: path or text of the robot description; None for the identified.urdf beside ``model``, or else what is
            recorded on robot_description in the bags.
        config: the node's parameter file (YAML), or parameters by their full names.
        model: an estimate.json to start from.
        prior: a population.json of the robot's type (``geomid fleet``) to start from.
        xacro_args: arguments, as ``NAME:=VALUE``, of ``urdf``, if that is a .xacro file, which is run.
        effects: names of the effects to identify at every joint and no others, ``[]`` for none; None for the configured
            ones, and for the candidates where held-out data ask for them.
        candidates: names of effects to identify where held-out data ask for them, beside ``effects``.
        links: names of the only links to identify; None for the configured ones.
        known: masses that were weighed, as ``LINK=MASS:STD``, ``LINK+LINK=MASS:STD`` or ``total=MASS:STD`` [kg].
        floating_base: whether the base moves; its pose is read from ``odom_topic``.
        wrench: wrench sensors, as ``TOPIC:FRAME:ROLE[:AXES]``; ``ROLE`` is mounted or external.
        joint_topic: topic of the joint states.
        odom_topic: topic of the base's pose.
        hold_out: share of each bag's time, at the end, to judge on; None for 0.3, with ``validate`` 0.
        validate: bags to judge on.
        progress: called with what is being done and the share of it, 0 to 1, that is done.

    Raises:
        InputError: a file, an argument or the data cannot be used; the message names it and says what to do.
    """
    weighed = entries("known", known)
    chosen: dict[str, Any] = {"known": weighed} if weighed else {}
    if prior is not None:
        chosen["prior"] = str(prior)
    if effects is not None:
        chosen |= {"effects": entries("effects", effects), "candidates": []}
    chosen |= {
        name: entries(name, given)
        for name, given in (("candidates", candidates), ("links", links))
        if given is not None
    }
    parameters = configuration(config, model=model, floating_base=floating_base, wrench=wrench, **chosen)
    topics = Topics(joint_topic, odom_topic)
    recorded = Bags(fitted=bag_paths(bags), validate=bag_paths(validate), hold_out=hold_out, topics=topics)
    robot = description(urdf, recorded.fitted, model=model, xacro_args=xacro_args)
    session, (held_out, judged) = read_with_locked(
        lambda chosen: Session(robot.text, chosen, robot.source),
        parameters,
        lambda session: _read(session, recorded, progress),
    )
    session.settled.extend(robot.notes)
    session.check_description()
    progress("solving", 0.0)
    estimate = session.identifier.solve()
    return Identification(session=session, bags=recorded, estimate=estimate, held_out=held_out, judged=judged)


def _read(session: Session, bags: Bags, progress: Progress) -> tuple[list[Samples], list[Samples]]:
    """The samples that are held out, and those to judge on: the same, or all that were fitted."""
    fitting, train = Fitting(session), list[Samples]()

    def fit(samples: Samples) -> None:
        fitting.add(samples)
        if not bags.holds_out:
            train.append(samples)

    held_out = read_bags(session, bags, fit, progress)
    fitting.end()
    return held_out, held_out or train
