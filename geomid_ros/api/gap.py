"""From rosbags to what a simulation of the robot lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geomid_ros.api.arguments import Config, PathLike, Paths, Texts, bag_paths, configuration, description
from geomid_ros.errors import InputError
from geomid_ros.files.disk import write_json
from geomid_ros.files.models.gap_results import gap_document
from geomid_ros.files.models.judgements import causes_entry
from geomid_ros.gap.result import Finding, GapResult, Verdict
from geomid_ros.model.samples import Samples
from geomid_ros.plausibility.verdict import recording_verdict
from geomid_ros.report.gap_page import GapPage, write_gap_page
from geomid_ros.report.gap_words import verdict_sentence
from geomid_ros.report.simulated_again import SimulatedAgain, position_units, simulated_again
from geomid_ros.session.gap import GapReader, find, gap_session
from geomid_ros.session.gap_simulation import nominal_inertias, simulate_again, without_findings, write_found
from geomid_ros.session.locking import read_with_locked
from geomid_ros.session.recordings import Bags, Progress, Topics, silent
from geomid_ros.session.session import Session


@dataclass(frozen=True, kw_only=True, eq=False)
class Gap:
    """What a simulation of the robot lacks.

    Attributes:
        session: the robot and the model before.
        bags: what was compared with it.
        result: all that the workflow found.
        held_out: the samples that were judged on, one element per recording.
        simulated: these recordings simulated again in MuJoCo, before and after.
        not_simulated: why there is no such simulation; empty if nothing is missing.
    """

    session: Session
    bags: Bags
    result: GapResult
    held_out: Sequence[Samples]
    simulated: Sequence[SimulatedAgain]
    not_simulated: str

    @property
    def verdict(self) -> Verdict:
        """``no gap``, ``named``, ``incomplete`` or ``unexplained``."""
        return self.result.verdict

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The effects that were found, the surest first."""
        return self.result.findings

    @property
    def document(self) -> dict[str, Any]:
        """All numbers, as ``gap.json`` has them."""
        document = gap_document(self.result, {simulation.kind: simulation.errors for simulation in self.simulated})
        session = self.session
        remarks = {"causes": causes_entry(session.findings), "warnings": session.warnings(), "notes": session.notes}
        return document | remarks

    def report(self, path: PathLike, *, progress: Progress = silent) -> Path:
        """Write everything with pictures on one HTML page that needs no network.

        Args:
            path: the file.
            progress: called with what is being done and the share of it, 0 to 1, that is done.

        Returns:
            The same path.

        Raises:
            InputError: the file cannot be written.
        """
        page = GapPage(
            robot=self.session.robot.name,
            recordings=[path.name for path, _ in self.bags.shares],
            joints=self.session.robot.joint_names,
            units=position_units(self.session.model),
            result=self.result,
            nominal=nominal_inertias(self.session),
            rigid=without_findings(self.session, self.result, self.held_out),
            known=self.session.loaded.effects,
            simulated=self.simulated,
            not_simulated=self.not_simulated,
            doubts=[finding.sentence for finding in self.session.findings],
            warnings=self.session.warnings(),
            notes=self.session.notes,
        )
        write_gap_page(Path(path), page, lambda share: progress("drawing", share))
        return Path(path)

    def save(self, folder: PathLike, *, progress: Progress = silent) -> list[Path]:
        """Write report.html, gap.json, and the model with what was found.

        Args:
            folder: made if it does not exist.
            progress: called with what is being done and the share of it, 0 to 1, that is done.

        Returns:
            The files; the model is estimate.json, identified.urdf, identified.xml (MJCF) and effects.yaml.

        Raises:
            InputError: a file cannot be written.
        """
        folder = Path(folder)
        files = write_found(folder, self.session, self.result)
        write_json(folder / "gap.json", self.document)
        return [self.report(folder / "report.html", progress=progress), folder / "gap.json", *files]

    def __repr__(self) -> str:
        """What makes it doubtful, the verdict, and a sentence for each finding."""
        doubts = recording_verdict(self.session.findings).remarks
        sentences = [f"  {finding.sentence}" for finding in self.findings]
        return "\n".join([*doubts, f"Gap of {self.session.robot.name}: {verdict_sentence(self.result)}", *sentences])


def find_gap(
    bags: Paths,
    urdf: PathLike | None = None,
    *,
    config: Config | None = None,
    model: PathLike | None = None,
    xacro_args: Texts = (),
    floating_base: bool = False,
    wrench: Texts = (),
    joint_topic: str = "joint_states",
    odom_topic: str = "odom",
    hold_out: float | None = None,
    validate: Paths = (),
    simulated: Paths = (),
    command: str | None = None,
    progress: Progress = silent,
) -> Gap:
    """Find where simulation and measurement disagree, which effect that is, and how much of the gap it closes.

    ``geomid gap`` calls this; its options have the same names.

    Args:
        bags: rosbag folders, or .mcap and .db3 files.
        urdf: path or text of the robot description; None for the identified.urdf beside ``model``, or else what is
            recorded on robot_description in the bags.
        config: the node's parameter file (YAML), or parameters by their full names.
        model: an estimate.json to compare with instead of the URDF's inertias alone.
        xacro_args: arguments, as ``NAME:=VALUE``, of ``urdf``, if that is a .xacro file, which is run.
        floating_base: whether the base moves; its pose is read from ``odom_topic``.
        wrench: wrench sensors, as ``TOPIC:FRAME:ROLE[:AXES]``; ``ROLE`` is mounted or external.
        joint_topic: topic of the joint states.
        odom_topic: topic of the base's pose.
        hold_out: share of each bag's time, at the end, to judge on; None for 0.3, with ``validate`` 0.
        validate: bags to judge on.
        simulated: what your simulator did under the commands of each bag, in their order.
        command: topic of the joints' set-points (JointState), to simulate in closed loop.
        progress: called with what is being done and the share of it, 0 to 1, that is done.

    Raises:
        InputError: a file, an argument or the data cannot be used; the message names it and says what to do.
    """
    parameters = configuration(config, model=model, floating_base=floating_base, wrench=wrench)
    topics = Topics(joint_topic, odom_topic)
    recorded = Bags(fitted=bag_paths(bags), validate=bag_paths(validate), hold_out=hold_out, topics=topics)
    robot, twins = description(urdf, recorded.fitted, model=model, xacro_args=xacro_args), bag_paths(simulated)
    session, recordings = read_with_locked(
        lambda chosen: gap_session(robot.text, chosen, robot.source),
        parameters,
        lambda session: GapReader(session, recorded, progress).read(twins),
    )
    session.settled.extend(robot.notes)
    session.check_description()
    reader = GapReader(session, recorded, progress)
    sharp = reader.sharp()
    commands = reader.sharp(command) if command else []
    try:
        result = find(session, recordings, progress)
    except InputError as error:
        raise InputError(f"{', '.join(map(str, recorded.fitted))}: {error}") from error
    progress("simulating again", 0.0)
    again = simulate_again(session, result, sharp, commands, recordings.cutoff)
    return Gap(
        session=session,
        bags=recorded,
        result=result,
        held_out=recordings.held_out,
        simulated=simulated_again(session.model, again),
        not_simulated=again.skipped,
    )
