# ruff: noqa: E501 it is a table
"""The catalogue of what goes wrong beside a robot: every fault, the node's answer, and the tests that hold it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Fault:
    """``answer``: R the message or row is rejected, S a new segment begins, W, E the level of the diagnostics, X the
    process refuses. ``tests``: ``file.py::function``, with the parameters' id in brackets where it has one."""

    number: int
    fault: str
    answer: str
    tests: tuple[str, ...]


_message = "test_catalogue_messages.py::test_a_bad_message_is_named_and_leaves_no_trace[{}]".format
_stream = "test_catalogue_messages.py::test_a_bad_stream_is_named_and_leaves_no_trace[{}]".format
_again = "test_catalogue_streams.py::test_what_comes_again_is_waited_out[{}]".format
_jump = "test_catalogue_streams.py::test_time_that_jumps_begins_a_segment_and_costs_nothing[{}]".format
_second = "test_catalogue_graph.py::test_a_second_publisher_is_named_and_believed_no_more_than_the_first[{}]".format
_solver = "test_catalogue_failures.py::test_a_solver_that_fails_keeps_the_last_estimate[{}]".format
_exception = "test_catalogue_failures.py::test_an_exception_costs_the_messages_it_meets[{}]".format
_console = "test_catalogue_console.py::test_{}".format
_supervisor = "test_supervisor.py::test_{}".format


def _bags(name: str) -> str:
    return f"{_BAGS}::test_{name}"


_both = "../session/test_ledger_findings.py::test_a_fault_gets_the_same_answer_in_a_bag_and_in_a_node[{}]".format
_service = "test_catalogue_failures.py::test_what_fails_is_answered_and_stops_nothing[{}]".format
_BAGS = "../files/test_bag_faults.py"
_NAMES = "../commands/test_names.py::test_"
_MISTAKES = "../commands/test_mistakes.py::test_"
_REFUSALS = _MISTAKES + "it_is_refused_with_what_to_do"
_SOLVING = "test_solving_process.py::test_"
_DESCRIPTION = "test_description.py::test_"
_ENDINGS = "test_endings.py::test_"
_FAILURES = "test_catalogue_failures.py::test_"
_GRAPH = "test_catalogue_graph.py::test_"
_STREAMS = "test_catalogue_streams.py::test_"

CATALOGUE = (
    Fault(
        1,
        "effort NaN",
        "R W; longer than `filter.max_gap`: W, that joint's equation is left out",
        (_message("1-nan-effort"), _stream("1-nan-effort-for-ever")),
    ),
    Fault(2, "position NaN", "R W", (_message("2-nan-position"),)),
    Fault(3, "a number is infinite", "R W", (_message("3-infinite"),)),
    Fault(4, "a number like 1e308", "R W", (_message("4-1e308"),)),
    Fault(5, "no velocities", "positions are differentiated, W once", (_stream("5-velocity-empty"),)),
    Fault(6, "no efforts", "R E; for longer, only wrenches are used, E", (_message("6-effort-empty"), _stream("6-effort-empty-for-ever"))),
    Fault(7, "arrays of unequal lengths", "R E", (_message("7-unequal-lengths"),)),
    Fault(8, "all efforts exactly zero in motion", "R E; for longer, only wrenches are used, E", (_message("8-zero-efforts-in-motion"), _stream("8-zero-efforts-for-ever"))),
    Fault(9, "joints in another order, or in several", "matched by name", (_stream("9-another-order"),)),
    Fault(10, "a joint missing", "R W", (_message("10-a-joint-missing"),)),
    Fault(11, "unknown joints", "ignored, W once", (_stream("11-extra-joints"),)),
    Fault(12, "a joint named twice", "R E", (_message("12-a-name-twice"),)),
    Fault(13, "no names", "R E", (_message("13-no-names"),)),
    Fault(14, "two publishers of a topic", "dropped, E naming both", (_second("14-two-publishers"),)),
    Fault(15, "a second stream with prefixed names", "R W; dropped while there are two publishers, E", (_message("15-prefixed-names"), _second("15-a-phantom"))),
    Fault(16, "left and right arm in separate messages", "dropped, E; merged with `merge_joint_states`", (_second("16-an-arm-of-its-own"), "test_catalogue_streams.py::test_16_two_arms_are_put_together")),
    Fault(17, "a publisher replaced by another", "taken", (f"{_GRAPH}17_a_publisher_that_is_replaced",)),
    Fault(18, "stamp zero", "R W", (_message("18-stamp-0"),)),
    Fault(19, "the same stamp again", "R W", (_message("19-duplicate"),)),
    Fault(20, "out of order", "R W", (_message("20-out-of-order"),)),
    Fault(21, "a stamp from the future", "R W, once the next message confirms it", (_message("21-from-the-future"),)),
    Fault(22, "a nanosecond field of a billion or more", "R W", (_message("22-nanoseconds"),)),
    Fault(23, "older than a second", "R W, once the next message confirms it", (_message("23-older-than-a-second"),)),
    Fault(24, "simulation reset", "S W, after ten messages, which are used", (_jump("24-simulation-reset"),)),
    Fault(25, "bag in a loop", "S W, after ten messages, which are used", (_jump("25-bag-loop"),)),
    Fault(26, "clock stepped back by less than `filter.max_gap`", "S if the motion shows it (76), else R W until it has caught up; by more: S", (_again("26-clock-back-a-little"),)),
    Fault(27, "a gap forward", "S W", (_jump("27-gap-forward"),)),
    Fault(28, "paused simulation", "R W", (_again("28-paused-simulation"),)),
    Fault(29, "simulated time without `/clock`", "W; data are used with their own stamps", (f"{_GRAPH}29_simulated_time_without_a_clock",)),
    Fault(30, "messages lost on the way", "counted, W", ("test_inputs.py::test_every_message_is_taken_lost_or_dropped", "test_diagnostics.py::test_what_was_counted_since_the_last_diagnostics_is_said[only what is new]")),
    Fault(31, "queue overflow", "W; messages are dropped while 10,000 messages or 100 MB wait", ("test_worker.py::test_what_waits_is_bounded_by_number_and_bytes",)),
    Fault(32, "bursts", "taken", (f"{_FAILURES}96_a_burst_of_thousands_after_silence_is_taken",)),
    Fault(33, "QoS mismatch: durability", "E naming policy and publisher", (f"{_GRAPH}33_a_description_that_is_not_kept_for_those_who_come_late",)),
    Fault(34, "QoS mismatch: reliability", "E naming policy and publisher", (f"{_GRAPH}34_joint_states_less_reliable_than_is_asked_for",)),
    Fault(35, "wrench with its sign reversed", "E within two seconds of motion; none of its rows is used, earlier ones included, until `~/reset`", ("test_catalogue_wrench.py::test_35_a_sensor_that_is_declared_wrongly_is_named",)),
    Fault(36, "wrench in another frame", "R W if the message says so; otherwise as 35", (_message("36-wrong-frame"), "../checks/test_wrenches.py::test_what_is_wrong_with_a_sensor_is_named")),
    Fault(37, "wrench without a frame", "assumed to be in the declared frame", (_stream("37-no-frame"),)),
    Fault(38, "wrench in another unit", "the same as 35", ("../checks/test_wrenches.py::test_what_is_wrong_with_a_sensor_is_named",)),
    Fault(39, "wrench tared during the run", "E once the normal level is known; its rows are left out from just before the change, until it is as before or `~/reset`; the rows are used if it may be a load: joints or other sensors show a change, too, or no joint is monitored", ("test_worker_wrenches.py::test_only_the_sensor_that_changed_loses_its_rows_and_only_until_it_is_as_before",)),
    Fault(40, "wrench drifting", "as 39; drift below the noise stays in the estimate, which equals that of a run whose sensor stopped just before the gap", ("test_catalogue_wrench.py::test_40_a_sensor_that_drifts_is_named",)),
    Fault(41, "effort saturated", "R W", ("../signals/test_effort_quality.py::test_a_curve_that_is_cut_off_is_refused_where_it_is",)),
    Fault(42, "stamps advancing over frozen numbers", "R W", (_message("42-frozen"),)),
    Fault(43, "description late", "dropped, W", (f"{_DESCRIPTION}a_late_and_at_first_unreadable_description",)),
    Fault(44, "description changed", "E; the old one is kept until `~/reset`", (f"{_DESCRIPTION}a_changed_description_waits_for_a_reset",)),
    Fault(45, "description unreadable", "E; the old one is kept", (f"{_DESCRIPTION}a_late_and_at_first_unreadable_description",)),
    Fault(46, "an inertia that is not physically consistent", "E naming the link", (f"{_DESCRIPTION}a_late_and_at_first_unreadable_description",)),
    Fault(47, "standing still", "R; W as long as there is no estimate", (f"{_FAILURES}47_standing_still",)),
    Fault(48, "rank deficient", "the diagnostics list the links whose masses are identified only in combination", (f"{_STREAMS}48_a_motion_of_one_joint_leaves_links_untold_and_names_them",)),
    Fault(49, "solver not converged, not finite, or failing", "W, E if it fails; the last estimate is kept", (_solver("49-not-converged"), _solver("49-not-a-number"), _solver("49-solver-fails"))),
    Fault(50, "solver timeout", "W; the last estimate is kept", (_solver("50-solver-over-its-time"),)),
    Fault(51, "exception in a callback", "the message is dropped, E", (f"{_FAILURES}what_fails_is_answered_and_stops_nothing",)),
    Fault(52, "exception in a thread", "the message is dropped, or its rows rejected, E", (_exception("52-worker"), _exception("52-rows"))),
    Fault(53, "a solve or the processing of messages hangs", "ended and begun anew, the processing of messages at most three times until `~/reset`; E until there is an estimate again", (f"{_FAILURES}53_a_solver_that_hangs_is_replaced", f"{_FAILURES}53_an_intake_that_hangs_is_replaced_so_many_times")),
    Fault(54, "shutdown from a callback", "ends within two seconds with status 0, the last estimate saved", (f"{_FAILURES}54_a_shutdown_from_a_callback_ends_the_node_well",)),
    Fault(55, "Ctrl-C while solving", "the same", (f"{_ENDINGS}a_busy_node_saves_its_last_estimate",)),
    Fault(56, "Ctrl-C twice", "the same", (f"{_ENDINGS}a_busy_node_saves_its_last_estimate",)),
    Fault(57, "SIGTERM", "the same", (f"{_ENDINGS}a_busy_node_saves_its_last_estimate", f"{_ENDINGS}a_node_told_to_end_while_it_starts", f"{_FAILURES}57_a_node_ends_though_all_its_threads_hang")),
    Fault(58, "bag truncated", "intact messages are read, W with file, offset and count (97); X if there are none", (_BAGS,)),
    Fault(59, "bag with a bit flipped", "X naming file and offset", (_BAGS,)),
    Fault(60, "bag without metadata", "its files are read, W", (_bags("a_recorder_that_was_killed_leaves_no_metadata"),)),
    Fault(61, "bag of a wrong type", "X naming file", (_BAGS,)),
    Fault(62, "crafted bag", "X naming file", (_BAGS,)),
    Fault(63, "empty bag", "X naming file", (_BAGS,)),
    Fault(64, "disk full", "E; estimating goes on", (_service("64-disk-full"),)),
    Fault(65, "disk read-only", "E; estimating goes on", (_service("65-read-only"),)),
    Fault(66, "folder unwritable", "E; estimating goes on", (_service("66-unwritable"),)),
    Fault(67, "disk slow", "E; estimating goes on", (_service("67-disk-slow"),)),
    Fault(68, "a service call in the wrong state", "the response says what is missing", ("test_services.py::test_services_without_a_robot_say_what_is_missing",)),
    Fault(69, "exception in a service", "the response contains it, E", (_service("69-service-fails"),)),
    Fault(70, "unknown or ill-typed parameter", "X naming it at startup; refused later", ("test_parameters.py::test_what_cannot_be_used_is_refused_with_one_message", "test_parameters.py::test_parameters_are_described")),
    Fault(71, "a driver that wraps positions at a whole turn", "unwrapped, W", (_both("71-wraps"),)),
    Fault(73, "positions that jump for up to three messages (encoder glitches)", "R W", (_both("73-position-glitches"),)),
    Fault(74, "effort spikes, shorter than a contact", "R W; kept at rates below 30 Hz, W: they may be motion", (_both("74-effort-spikes"),)),
    Fault(75, "stamps too early by less than `filter.max_gap`", "R W; the next messages are used", (_both("75-stamps-ahead"),)),
    Fault(76, "clock set by less than `filter.max_gap` (NTP), detected from the motion", "S W", (_both("76-clock-set-ahead"),)),
    Fault(77, "receipt stamps in bursts (wireless)", "E; used by their sequence if a period can be identified, else R E", (_both("77-bursts"), "../signals/test_clocks.py::test_uneven_bursts_are_refused")),
    Fault(78, "one joint's effort never changes, and is not zero", "E naming the joint", (_both("78-an-effort-is-constant"),)),
    Fault(82, "two joints with swapped names; left and right", "E naming the joints, if their loads differ", (_both("82-names-exchanged"), "../checks/test_efforts.py::test_what_is_planted_is_named", "../checks/test_efforts.py::test_left_and_right_are_exchanged")),
    Fault(83, "effort unit or sign that changes during the run at all joints", "E", (_both("83-unit-in-mid-run"),)),
    Fault(85, "two thirds of a joint's efforts NaN; two publishers in a bag; a joint NaN throughout", "the message counts are printed and written, W", (_both("85-mostly-nan"), _both("85-two-publishers"), _both("85-nan-throughout"))),
    Fault(87, "messages in pairs or batches (USB, EtherCAT)", "the period from the span of stamps, E", (_both("87-five-per-batch"),)),
    Fault(88, "`merge_joint_states` with a slow gripper", "the rate of the fastest part; positions of slow parts are interpolated, their efforts left out, W", ("test_catalogue_streams.py::test_88_a_slow_gripper_does_not_slow_down_the_arm",)),
    Fault(89, "one part of a merged robot dies", "W naming its joints", (f"{_STREAMS}89_a_part_that_falls_silent_is_named",)),
    Fault(90, "messages are accepted, but yield no rows", "W asking to check the clocks of the topics", ("test_diagnostics.py::test_90_messages_of_which_nothing_comes_are_a_warning",)),
    Fault(91, "the solving process is killed", "restarted, after increasing pauses if it ends without a result, W; no message is lost", (_GRAPH + "91_a_node_whose_process_is_killed_goes_on", _SOLVING + "a_process_that_is_killed_is_replaced", _SOLVING + "one_that_ends_in_every_solve_is_started_after_pauses")),
    Fault(92, "slow solves now and then", "each that hangs is ended and begun anew", (_supervisor("92_what_hung_is_told_until_there_is_an_estimate"),)),
    Fault(93, "a mimic joint that is not in the messages", "follows its master, whose effort drives both", ("../model/test_mimic.py::test_the_masters_efforts_make_the_energy_grow", _supervisor("they_are_locked_when_all_had_the_time_to_be_heard"))),
    Fault(94, "tf_prefix", "R E naming the prefix", (_message("15-prefixed-names"), _REFUSALS)),
    Fault(95, "an infinite speed", "R W", (_message("95-infinite-speed"), _both("95-infinite-speeds"))),
    Fault(96, "thousands of messages at once after silence", "taken", (f"{_FAILURES}96_a_burst_of_thousands_after_silence_is_taken",)),
    Fault(97, "a recorder that was killed; a truncated last file of a split bag; a missing footer", "intact messages are read, W with the count, status 0", (_bags("all_messages_that_are_whole_are_read"), _bags("the_last_file_of_a_split_bag_is_torn"), _bags("a_database_is_read_up_to_the_first_missing_page"), _bags("what_is_in_a_killed_recorders_log_is_read"), _bags("the_command_reads_what_is_whole_and_says_so"))),
    Fault(98, "a bag without CRCs", "nothing is said: a changed number cannot be noticed", (_bags("the_command_reads_what_is_whole_and_says_so"),)),
    Fault(99, "ROS 1 bags; lz4; a folder of bags", "X with the command that converts; read; read", (_bags("the_command_for_a_bag_of_ros_1_makes_one_that_is_read"), _bags("every_compression_of_a_bag"), _bags("a_folder_of_bags_is_all_of_them"))),
    Fault(100, "files of a split bag listed in another order", "read by time", (_bags("files_listed_in_another_order_are_read_by_time"),)),
    Fault(101, "`~/save` under load", "response within five seconds, with the last estimate or the reason why not", (_service("101-solver-busy"), _supervisor("101_what_takes_too_long_is_said"))),
    Fault(102, "too little memory", "X in one sentence", (_MISTAKES + "too_little_memory_is_said_in_one_sentence",)),
    Fault(103, "names with terminal, HTML or formula markup", "shown as plain text", (_NAMES + "names_are_shown_as_they_are_or_as_codes_and_never_obeyed",)),
    Fault(104, "control characters and line ends in names and frames", "shown as escape codes, in terminal, log and diagnostics", (_NAMES + "names_are_shown_as_they_are_or_as_codes_and_never_obeyed", f"{_GRAPH}108_104_what_is_no_message_is_refused_and_said_on_the_console")),
    Fault(105, "a pipe or a device in place of a file", "X naming it", (_REFUSALS,)),
    Fault(106, "a bag that unpacks to hundreds of times its size", "X naming it, before the disk is full", (_bags("what_would_fill_the_disk_is_refused_before"),)),
    Fault(107, "names of 20,000 characters", "accepted, at the cost of their length", (_NAMES + "a_name_costs_no_more_than_its_length",)),
    Fault(108, "nobody reads the diagnostics", "persistent problems are logged once a minute, with what to do", (_console("108_the_console_says_what_is_waited_for"), f"{_GRAPH}108_104_what_is_no_message_is_refused_and_said_on_the_console", _console("what_lasts_is_said_once_a_minute"))),
    Fault(109, "solver trial points that overflow", "the step is shortened", ("../estimation/test_solvers.py::test_trial_points_that_overflow_shorten_the_step",)),
    Fault(110, "xacro, SDF or MJCF in place of URDF; no inertials; joints without a publisher; a cutoff too high for the rate", "X with the command or the parameter that fixes it", (_REFUSALS,)),
)  # fmt: skip


def table() -> str:
    """The catalogue as the page of faults has it."""
    rows = [f"| {entry.number} | {entry.fault} | {entry.answer} |" for entry in CATALOGUE]
    return "\n".join(["| # | fault | answer |", "|---|---|---|", *rows])
