"""The catalogue's faults that nobody sees who does not watch the diagnostics; and names that must not reach anybody as
they are."""

from __future__ import annotations

import queue
import re
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from files.recordings import TYPES, Recorded

from geomid_ros.checks.verdict import DOUBTFUL, Verdict
from geomid_ros.errors import InputError
from geomid_ros.files.disk import write_text
from geomid_ros.live import saving, supervisor, threads
from geomid_ros.live.status import Listener, Status
from geomid_ros.live.supervisor import Supervisor
from geomid_ros.live.threads import Activity
from geomid_ros.ros import console as module
from geomid_ros.ros.console import AGAIN, Console
from geomid_ros.ros.diagnostics import Diagnostics
from geomid_ros.session.configuration import Configuration
from geomid_ros.signals.ledger import Account, Ledger

from .direct import Direct
from .rig import GOOD, WARN, rigged
from .stage import KINDS, NO_CHOICE, WRIST, Stage, description
from .test_catalogue_merging import part

JOINTS = {"/joint_states": KINDS["/joint_states"]}
WICKED = "\x1b[31mjoint1\nINFO all is well\u202e"
SHOWN = r"\x1b[31mjoint1\nINFO all is well\u202e"


class Lines:
    """A log that remembers."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []

    def info(self, message: str, /) -> None:
        self.lines.append(("info", message))

    def warning(self, message: str, /) -> None:
        self.lines.append(("warning", message))

    def error(self, message: str, /) -> None:
        self.lines.append(("error", message))


class TestConsole:
    """Fault 108."""

    @pytest.fixture
    def clock(self, monkeypatch: pytest.MonkeyPatch) -> list[float]:
        now = [5.0]
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]))
        return now

    def test_what_lasts_is_said_once_a_minute(self, clock: list[float]) -> None:
        log = Lines()
        console = Console(log)
        for second in range(301):
            console.log_complaints([], [f"joint_states rejected: {second} messages"])
            clock[0] += 1.0
        assert [line for line, _ in log.lines] == ["warning"] * (300 // int(AGAIN))

    def test_joints_that_differ_in_a_number_are_others(self) -> None:
        """Sentences that differ in what was measured are the same."""
        log = Lines()
        console = Console(log)
        lines = [f"'{joint}' is {delay} s late" for joint in ("joint4", "joint5") for delay in (2, 0.31, 1e-05)]
        console.log_events(lines)
        assert [line for _, line in log.lines] == lines[::3]

    def test_what_is_gone_again_is_not_said(self, clock: list[float]) -> None:
        log = Lines()
        console = Console(log)
        for second in range(20):
            console.log_complaints([], ["a late message"] if second % 3 == 0 else [])
            clock[0] += 1.0
        assert log.lines == []

    def test_the_end_is_said_once_and_only_of_what_was_said(self, clock: list[float]) -> None:
        log = Lines()
        console = Console(log)
        for complaints in (["a"], ["a", "b"], ["1 c"], ["2 c", "a"], [], ["d"], [], []):
            console.log_complaints([], complaints)
            clock[0] += 1.0
        assert log.lines == [("warning", "a"), ("warning", "2 c"), ("info", "no longer: a; 2 c")]

    def test_what_is_said_at_once_is_said_once(self, clock: list[float]) -> None:
        """A remark on one message; what is a complaint, too."""
        log = Lines()
        console = Console(log)
        console.error("b")
        for complaints in (["a", "b"], ["b"], ["b"], ["b"]):
            console.log_complaints([], complaints, {"a"} & {*complaints})
            clock[0] += 1.0
        assert log.lines == [("error", "b"), ("warning", "a")]

    def test_errors_and_warnings_are_lines_of_their_own(self, clock: list[float]) -> None:
        log = Lines()
        console = Console(log)
        for _ in range(2):
            console.log_complaints(["a", "c"], ["b"])
            clock[0] += 1.0
        assert log.lines == [("error", "a; c"), ("warning", "b")]

    def test_it_remembers_no_more_than_so_much(self, clock: list[float]) -> None:
        console = Console(Lines())
        for number in range(1000):
            name = "".join(chr(97 + int(digit)) for digit in str(number))
            for _ in range(2):
                console.log_complaints([], [f"joint '{name}' is missing"])
            clock[0] += 1.0
        assert len(console._logged) <= 200

    def test_names_are_printable(self) -> None:
        log = Lines()
        Console(log).warning(f"joint '{WICKED}' is missing")
        assert log.lines == [("warning", f"joint '{SHOWN}' is missing")]


def said(process: Any, level: str, words: str) -> bool:
    return re.search(rf"\[{level}\].*{words}", process.output) is not None


def test_108_the_console_says_what_is_waited_for(stage: Stage) -> None:
    """A description; data."""
    node = stage.node(WRIST)
    stage.observer.wait_for(
        lambda: said(
            node, "WARN", r"no robot description yet on /robot_description \(start robot_state_publisher, or set"
        ),
        "a description",
    )
    other = stage.node({**WRIST, "robot_description": description("arm3")}, "-r", "__ns:=/other", name="other/geomid")
    stage.observer.wait_for(
        lambda: said(other, "WARN", r"no messages on /other/joint_states, /wrench \(does the driver run\?"), "messages"
    )


def test_108_104_all_messages_refused_is_said_on_the_console(tmp_path: Path) -> None:
    """With what to do about it; and names from outside are one printable line, there and in the diagnostics."""
    with rigged(tmp_path) as rig:
        names = [WICKED, "joint2", "joint3"]
        bad = [item.changed(name=names) for item in GOOD[:1200] if item.topic == "/joint_states"]
        for begin in range(0, 600, 150):
            rig.send(bad[begin : begin + 150], pause=0.01)
        rig.stage.observer.wait_for(
            lambda: said(
                rig.node, "(WARN|ERROR)", r"joint_states rejected: joint 'joint1' is missing: if nobody publishes"
            ),
            "what all messages lack",
        )
        assert rig.node.output.count("joint 'joint1' is missing") <= 2, "once, not with every message"
        values = rig.settled()
        assert values["joint_states accepted"] == "0"
        twice = [item.changed(name=[WICKED, WICKED, "joint3"]) for item in GOOD[600:1000] if item.topic != "/wrench"]
        begin = len(rig.arrays)
        rig.send(twice)
        rig.says(begin, None, f"joint '{SHOWN}' is named twice")
        assert_printable(rig.arrays)
        assert all(line.isprintable() for line in rig.node.output.splitlines())
        assert not re.search("^INFO all is well", rig.node.output, re.MULTILINE)
        before, after = rig.begin()
        rig.feed(before + after)
        rig.assert_same_as_twin()


def test_104_a_frame_id_is_printable(direct: Direct) -> None:
    before, after = direct.begin()
    direct.feed(before)
    begin = len(direct.arrays)
    wicked = []
    for item in after[:20]:
        if item.topic == "/wrench":
            message = TYPES.deserialize_cdr(TYPES.serialize_cdr(item.message, item.kind), item.kind)
            message.header.frame_id = WICKED
            wicked.append(type(item)(item.topic, item.kind, item.time, message))
    direct.send(wicked)
    direct.says(begin, None, f"frame '{SHOWN}' is not the declared 'wrist_ft'")
    direct.feed([item for item in after if item.topic == "/joint_states" or item not in after[:20]])
    assert_printable(direct.arrays)
    direct.assert_same_as_twin()


def assert_printable(arrays: list[DiagnosticArray]) -> None:
    """Every text of diagnostics."""
    for array in arrays:
        for status in array.status:
            for text in (
                status.name,
                status.message,
                *(text for pair in status.values for text in (pair.key, pair.value)),
            ):
                assert text.isprintable(), text


def test_89_a_part_that_falls_silent_is_named() -> None:
    """Though all that comes is accepted; and it goes on when the part is back."""
    with closing(Direct(merge_joint_states=True)) as direct:

        def send(items: list[Recorded], with_right: bool = True) -> None:
            for item in items:
                if item.topic != "/joint_states":
                    direct.send([item])
                    continue
                direct.send([part(item, slice(0, 2))])
                if with_right:
                    direct.send([part(item, slice(2, None))])

        send(GOOD[:400])
        direct.settled()
        begin = len(direct.arrays)
        send(GOOD[400:1000], with_right=False)
        silent = GOOD[0].message.name[2] if GOOD[0].topic == "/joint_states" else GOOD[1].message.name[2]
        direct.says(begin, WARN, f"joint_states: no data of '{silent}'")
        again = len(direct.arrays)
        send(GOOD[1000:])
        direct.told("rows", again, lambda _, status: "no data of" not in status.message)
        direct.settled(again)


def test_93_a_mimic_joint_is_not_waited_for(stage: Stage) -> None:
    """A finger that follows the last joint, and that no message has; without <mimic> it would be missing."""
    finger = (
        '<link name="finger"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0"'
        ' iyz="0"/></inertial></link><joint name="finger" type="prismatic"><parent link="link3"/><child link="finger"/>'
        '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
        '<mimic joint="joint3" multiplier="0.01"/></joint></robot>'
    )
    stage.node({"robot_description": description("arm3").replace("</robot>", finger), **NO_CHOICE, "solve_period": 0.5})
    stage.observer.publish([item for item in GOOD[:800] if item.topic == "/joint_states"], JOINTS)
    told = stage.fed({"joint_states": 400})
    values = {pair.key: pair.value for pair in told.status[0].values}
    assert values["joint_states accepted"] == "400"
    assert "missing" not in told.status[0].message
    names = {
        status.name for status in stage.observer.diagnostics(lambda values, _: int(values["solves"]) > 0, "").status
    }
    assert "geomid: finger" in names


def status(accepted: int, rows: int, silent: str = "") -> Status:
    accounts = {topic: Account(accepted=0 if topic == silent else accepted) for topic in ("joint_states", "/wrench")}
    return Status(active=True, topics=tuple(accounts), accounts=accounts, rows_made=rows, lag=0.5)


@pytest.mark.parametrize("silent", ["", "/wrench"])
def test_90_messages_of_which_nothing_comes_are_a_warning(silent: str) -> None:
    """Once that lasts longer than the filter needs, and until rows come."""
    diagnostics = Diagnostics("node")
    said = []
    for second in range(12):
        diagnostics.array(status(100 * second, 5, silent))
        said.append([warning for warning in diagnostics.warnings if "have yielded no rows" in warning])
    assert not any(said[:5])
    assert all(said[6:])
    advice = (
        f"none is accepted on {silent}"
        if silent
        else "check that joint_states and /wrench are stamped by the same clock"
    )
    assert said[-1][0].endswith(f": {advice}")
    diagnostics.array(status(1200, 6))
    assert not any("yielded no rows" in warning for warning in diagnostics.warnings)
    for _ in range(9):  # nothing is accepted: something else is wrong, and said
        diagnostics.array(status(1200, 6))
    assert not any("yielded no rows" in warning for warning in diagnostics.warnings)


class Hanging:
    """As much of a solving process as hangs."""

    def __init__(self) -> None:
        self.restarts, self.solves = 0, True

    def give_up(self) -> bool:
        self.restarts += self.solves
        return self.solves


def watching(solving: Any, worker: Any) -> Supervisor:
    """A supervisor of a worker whose results nobody hears."""
    watched = Supervisor(Configuration({}), Ledger(), Lines(), Listener(), solving)
    watched.worker = worker
    return watched


def test_92_what_hung_is_told_until_there_is_an_estimate(monkeypatch: pytest.MonkeyPatch) -> None:
    """A solve that hangs is ended, however often that happens."""
    monkeypatch.setattr(Activity, "current", ("solving", 1e6))
    solving: Any = Hanging()
    idle, solver = SimpleNamespace(current=("", 0.0)), SimpleNamespace(activity=Activity(), solves=7)
    watched = watching(solving, SimpleNamespace(activity=idle, solver=solver))
    for _ in range(20):
        watched.restart_hung_threads()
    assert solving.restarts == 20
    with monkeypatch.context() as well:
        well.setattr(Activity, "current", ("", 0.0))
        watched.restart_hung_threads()
        assert watched.problems[0] == "the solver hung and was restarted"
        solver.solves += 1
        watched.restart_hung_threads()
        assert watched.problems[0] == ""
    solving.solves = False  # it hangs in something else, which nobody can end
    watched.restart_hung_threads()
    assert watched.problems[0] == "the solver thread hangs outside a solve; restart the node"
    monkeypatch.setattr(Activity, "current", ("", 0.0))  # nor does it for ever
    watched.restart_hung_threads()
    assert not any(watched.problems)


def test_92_messages_that_nobody_processes_any_more_hide_no_solver_that_hangs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Activity, "current", ("solving", 1e6))
    monkeypatch.setattr(supervisor, "MOST_RESTARTS", 0)
    solving: Any = Hanging()
    solver = SimpleNamespace(activity=Activity(), solves=7)
    watched = watching(solving, SimpleNamespace(activity=Activity(), solver=solver))
    watched.restart_hung_threads()
    assert solving.restarts == 1
    again, hung, *_ = watched.problems
    assert again.startswith("message processing hangs again")
    assert hung == "the solver hung and was restarted"


def test_92_a_hang_is_known_though_nothing_can_begin_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """And forgotten with the worker that it was of."""
    monkeypatch.setattr(Activity, "current", ("taking", 1e6))
    ended = SimpleNamespace(close=lambda _: None, estimate=None)
    worker = SimpleNamespace(
        activity=Activity(),
        solver=ended,
        session=SimpleNamespace(urdf="<no robot", pipeline=SimpleNamespace(period=0.0)),
        **vars(ended),
    )
    ended.activity = Activity()
    watched = watching(None, worker)
    with pytest.raises(InputError):
        watched.restart_hung_threads()
    assert watched.problems[0] == "message processing hung and was restarted, 1 of at most 3 times"
    watched.close()
    assert not any("hung" in problem for problem in watched.problems)


def test_92_what_goes_on_after_a_hang_has_its_own_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was held up counts from the end of what held it up: the next solve is not ended with it."""
    now = [0.0]
    monkeypatch.setattr(threads, "time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(supervisor, "time", threads.time)
    solving: Any = Hanging()
    solver = SimpleNamespace(activity=Activity(), solves=0)
    watched = watching(solving, SimpleNamespace(activity=Activity(), solver=solver))
    with solver.activity.doing("solving"):
        for now[0] in (supervisor.HANGING + 1.0, supervisor.HANGING + 2.0, 2.0 * supervisor.HANGING):
            watched.restart_hung_threads()
        assert solving.restarts == 1
        now[0] = 3.0 * supervisor.HANGING
        watched.restart_hung_threads()
        assert solving.restarts == 2


VERDICT = Verdict(word=DOUBTFUL, reasons=("it weighs 2464 kg", "it is of another robot"))


class Slow:
    """As much of a worker as saving asks: it has an estimate, or none, and never another one."""

    def __init__(self, estimate: Any) -> None:
        self.session: Any = SimpleNamespace(
            review=SimpleNamespace(verdict=lambda _: VERDICT), pipeline=SimpleNamespace(period=0.0)
        )
        self.estimate = estimate
        self.saved: list[Any] = []

    def close(self, _: float) -> None:
        """At once."""

    def request_estimate(self, done: Any) -> None:
        """Takes for ever."""

    def save(self, _: Any, folder: Path, estimate: Any, verdict: Any) -> list[Path]:
        assert verdict is VERDICT
        self.saved.append(estimate)
        return [folder / "estimate.json"]


class Estimated:
    rows_accepted = 7


def test_66_a_folder_that_cannot_be_written_is_told_at_the_start_and_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    log, worker = Lines(), Slow(Estimated())
    watched = Supervisor(Configuration({"output_folder": "/proc/nope"}), Ledger(), log, Listener(), None)
    assert any(problem.startswith("output_folder /proc/nope: cannot be written") for problem in watched.problems)
    monkeypatch.setattr(saving, "save", lambda *_, **__: write_text(Path("/proc/nope/estimate.json"), ""))
    watched.worker = worker  # type: ignore[assignment]
    watched.close()
    ((level, line),) = log.lines
    assert level == "error"
    assert line.startswith("the last estimate is not saved: /proc/nope/estimate.json: cannot be written")


@pytest.mark.parametrize("estimate", [None, Estimated()], ids=["none", "an old one"])
def test_101_what_takes_too_long_is_said(estimate: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert saving._LATE < saving._LATEST < 5.0
    monkeypatch.setattr(saving, "_LATE", 0.2)
    monkeypatch.setattr(saving, "_LATEST", 1.0 if estimate is None else 20.0)
    answers: queue.SimpleQueue[tuple[bool, str]] = queue.SimpleQueue()
    worker: Any = Slow(estimate)
    monkeypatch.setattr(saving, "save", worker.save)
    saving.Saving(str(tmp_path)).begin_when_solved(worker, answers.put)
    success, message = answers.get(timeout=30.0)
    assert success == (estimate is not None)
    expected = (
        "no estimate yet: the first one takes more than 1 s; ask"
        if estimate is None
        else f"DOUBTFUL: it weighs 2464 kg; DOUBTFUL: it is of another robot; written: {tmp_path}/estimate.json; it "
    )
    assert message.startswith(expected)
    assert worker.saved == ([] if estimate is None else [estimate])
    with pytest.raises(queue.Empty):
        answers.get(timeout=0.5)
