"""Identification node: subscribes to topics and publishes estimates. A :class:`Worker` does the work."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.task import Future
from std_msgs.msg import String
from std_srvs.srv import Trigger

from geomid_ros.errors import GeomidError, InputError
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.live.effort_predictor import EffortPredictor
from geomid_ros.live.searches import NO_DATA, BackgroundSearch, PayloadSearch, look_for_gap
from geomid_ros.live.solving_process import SolvingProcess
from geomid_ros.live.status import Status
from geomid_ros.live.supervisor import Supervisor
from geomid_ros.live.worker import Worker
from geomid_ros.ros.dashboard import DashboardProcess
from geomid_ros.ros.diagnostics import DESCRIPTION, NO_DESCRIPTION, STOPPED, Console, Diagnostics, StatusEvents
from geomid_ros.ros.inputs import Inputs, RosTypes, describe, read_parameters
from geomid_ros.ros.outputs import Outputs, Streaming, latched
from geomid_ros.ros.startup import starting_ros
from geomid_ros.session.configuration import AT_ANY_TIME, BY_NAME, Configuration, find_parameter
from geomid_ros.signals.ledger import Ledger
from geomid_ros.signals.messages import COMMANDS, JOINT_STATES, read_without_rosbags

_TOPIC = f"topic {DESCRIPTION}"
_CHANGED = "the robot description has changed; it is used after ~/reset"


class GeomidNode(LifecycleNodeMixin, Node):
    """Subscribes to ``joint_states``, ``joint_commands``, wrench topics, ``odom`` or ``imu``, and
    ``robot_description``; publishes its results.

    If the parameter ``lifecycle`` asks for it, it is a managed node. Then a transition that raises GeomidError fails,
    and the state stays; after any other error the node is unconfigured.
    """

    def __init__(self, solving: SolvingProcess | None = None) -> None:
        """
        Args:
            solving: the process that solves; None to solve in this one.

        Raises:
            InputError: the parameters do not fit.
        """
        with starting_ros():
            # Undeclared ones are those with a * in the table, and unknown ones, which the callback refuses.
            Node.__init__(
                self,
                "geomid",
                automatically_declare_parameters_from_overrides=True,
                allow_undeclared_parameters=True,
            )
        try:
            self._set_up(solving)
        except BaseException:
            self.destroy_node()  # else the traceback keeps it, and ROS's threads run until the interpreter ends
            raise

    def _set_up(self, solving: SolvingProcess | None) -> None:
        read_without_rosbags(RosTypes())
        self._configuration = read_parameters(self)
        self._console = Console(self.get_logger())
        self._news = StatusEvents()
        self._active: bool = self._configuration["active"]
        self._subscribed = False
        lifecycle = self._configuration["lifecycle"]
        self._configured = lifecycle == "none"
        if lifecycle != "none":
            LifecycleNodeMixin.__init__(self)
            service = self._service_change_state
            service.callback = partial(self._change_state, service.callback)
        create = self.create_publisher if lifecycle == "none" else self.create_lifecycle_publisher
        self._ledger = Ledger()
        self._inputs = Inputs(self, self._ledger)
        predictors = {topic: EffortPredictor(topic) for topic in (JOINT_STATES, COMMANDS)}
        self._streaming = Streaming(self, self._inputs, predictors, self._console.warning)
        self._outputs = Outputs(self, create, self._streaming)
        self._search = BackgroundSearch("no finding", self._outputs.publish_gap)
        self._payload = PayloadSearch(self._outputs.publish_identified_payload)
        self._dashboard: DashboardProcess | None = None
        self._urdf = ""  # latest description, not necessarily the worker's
        self._problem = ""  # with the robot description
        self._supervisor = Supervisor(self._configuration, self._ledger, self._console, self._outputs, solving)
        self._diagnostics = Diagnostics(self.get_fully_qualified_name().lstrip("/"))
        self._diagnostic_arrays = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._serve("start", partial(self._set_active, active=True))
        self._serve("stop", partial(self._set_active, active=False))
        self._serve("reset", self._reset)
        self._serve("find_gap", partial(self._look, self._find_gap))
        self._serve("payload/empty", partial(self._look, self._payload.take_empty))
        self._serve("payload/loaded", partial(self._look, self._payload.take_loaded))
        # In a separate group: other callbacks of its group, those of messages included, would wait for the disk.
        self.create_service(Trigger, "~/save", self._save, callback_group=MutuallyExclusiveCallbackGroup())
        # On the steady clock: if simulated time stands still, the diagnostics must report why.
        self.create_timer(1.0, self._publish_diagnostics, clock=Clock(clock_type=ClockType.STEADY_TIME))
        if self._configuration["dashboard"]:
            self._dashboard = DashboardProcess(self.get_fully_qualified_name())
        if not self._configuration["robot_description"]:
            self._inputs.subscribe(String, DESCRIPTION, self._on_description, latched())
        if not self._active:
            self._console.info("waiting for ~/start, as the parameter active is false")
        self.add_on_set_parameters_callback(self._on_set)
        self.add_post_set_parameters_callback(self._describe)
        if lifecycle == "none":
            self.activate()
            self.configure()  # last, as a later failure would leave its threads running
        elif lifecycle == "autostart" and self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            self.trigger_activate()

    @property
    def _worker(self) -> Worker | None:
        return self._supervisor.worker

    def take_waiting(self) -> None:
        """Take the waiting data. All of them are counted, also after an error."""
        messages, worker = self._streaming.drain(), self._worker
        reason = self._missing if worker is None else STOPPED
        try:
            if worker is not None and self._active:
                worker.enqueue(messages)
                return
        except Exception as error:  # noqa: BLE001 the node must survive
            reason = f"{type(error).__name__} in a callback"
            topics = " or ".join({message.topic for message in messages})
            self.fail(f"a message on {topics} could not be processed", error)
        for message in messages:
            self._ledger.drop(message.topic, reason)

    def wait(self, seconds: float) -> None:
        """Wait. Messages that arrive meanwhile are predicted if the stream has subscribers; else they are taken
        halfway, so that rows come sooner."""
        if self._streaming.active:
            self._streaming.wait(seconds)
            return
        self._streaming.wait(0.5 * seconds)
        self.take_waiting()
        self._streaming.wait(0.5 * seconds)

    def _serve(self, name: str, act: Callable[[], tuple[bool, str]]) -> None:
        """Offer a service that answers even if it fails."""

        def callback(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                response.success, response.message = act()
            except GeomidError as error:
                response.success, response.message = False, str(error)
            except Exception as error:  # noqa: BLE001 the node must survive
                response.success, response.message = False, f"{type(error).__name__}: {error}"
                self.fail(f"~/{name} failed", error)
            return response

        self.create_service(Trigger, f"~/{name}", callback)

    def configure(self) -> None:
        """Begin to identify the robot of the parameter, or that of the topic once its description arrives.

        Raises:
            InputError: the description does not fit the parameters, or the model cannot be read.
        """
        if self._configuration["robot_description"]:
            self._build(self._configuration["robot_description"], "parameter robot_description")
        elif self._urdf:
            self._build(self._urdf, _TOPIC)
        elif self._configuration["model"]:
            EstimateFile.read(Path(self._configuration["model"]))  # fails now, not once a description comes
        self._configured = True

    def activate(self) -> None:
        """Publish the last estimate, and subscribe to the data that the parameters ask for.

        Raises:
            InputError: a topic name is invalid.
        """
        self.deactivate()
        self._inputs.listen_as(self._configuration)
        self._subscribed = True
        if self._worker is not None and self._worker.estimate is not None:
            self._outputs.publish_estimate(self._worker.session, self._worker.estimate)

    def deactivate(self) -> None:
        """Take the waiting data, and unsubscribe from data."""
        self.take_waiting()
        self._inputs.close()
        self._subscribed = False

    def clean_up(self) -> None:
        """End the identifier within two seconds; save the checkpoint and the last estimate."""
        self._configured = False
        self._search.close()
        self._payload.close()
        self._supervisor.close()
        self._outputs.forget()
        self._report("")

    def _on_set(self, parameters: Sequence[RosParameter]) -> SetParametersResult:
        """Use new values of parameters, or refuse them with a reason."""
        try:
            self._use(self._configuration.with_values({parameter.name: parameter.value for parameter in parameters}))
        except GeomidError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _describe(self, parameters: Sequence[RosParameter]) -> None:
        """Describe parameters that were not declared before they were set."""
        describe(self, self._configuration.given_values.keys() & {parameter.name for parameter in parameters})

    def _use(self, configuration: Configuration) -> None:
        before, values = self._configuration, configuration.given_values
        # Without a value, those of one joint or sensor are not at their default: others count there.
        was = before.given_values | {name: before[name] for name in values.keys() & BY_NAME.keys()}
        changed = [name for name, value in values.items() if value != was.get(name)]
        if not changed:
            return
        row_dependent = [name for name in changed if find_parameter(name).change != AT_ANY_TIME]
        worker = self._worker  # has rows, or will have some soon
        if row_dependent and worker and (self._uses_data or worker.session.identifier.counts.made > 0):
            raise InputError(f"{row_dependent[0]} is read-only; it can be set after ~/stop (or deactivate) and ~/reset")
        try:
            self._begin_with(configuration, anew=bool(row_dependent))
        except GeomidError:
            self._begin_with(before, anew=bool(row_dependent))
            raise
        for name in changed:
            self._console.info(f"{name} is now {values[name]}, and was {was.get(name, 'not set')}")

    def _begin_with(self, configuration: Configuration, *, anew: bool) -> None:
        self._configuration = configuration
        self._supervisor.reconfigure(configuration, rebuild=anew)
        if anew and self._configured:
            self.configure()
        if anew and self._subscribed:
            self.activate()

    @property
    def _uses_data(self) -> bool:
        return self._active and self._subscribed

    @property
    def _missing(self) -> str:
        """Reason why there is no worker."""
        return self._unconfigured or NO_DESCRIPTION

    @property
    def _unconfigured(self) -> str:
        """Sentence on the lifecycle state if nothing is configured, else empty."""
        return "" if self._configured else f"the lifecycle state is {self._state_machine.current_state[1]}"

    def _on_description(self, message: String) -> None:
        self._urdf = message.data
        if not self._configured:
            return
        try:
            if self._worker is None:
                self._build(message.data, _TOPIC)
            elif message.data == self._worker.session.urdf:
                self._report("")
            else:
                self._supervisor.new_session(message.data, _TOPIC)  # raises what ~/reset would
                self._report(_CHANGED)
        except GeomidError as error:
            self._report(str(error))

    def _build(self, urdf: str, source: str) -> None:
        self._supervisor.build(urdf, source)
        self._urdf = urdf
        self._report("")

    def _report(self, problem: str) -> None:
        """Report a problem with the robot description in the log and the diagnostics; clear it if empty."""
        if problem and problem != self._problem:
            self._console.error(problem)
        self._problem = problem

    def fail(self, what: str, error: Exception) -> None:
        """Report an exception in the log and the next diagnostics."""
        self._console.error(self._supervisor.failures.add(what, error))

    def _publish_diagnostics(self) -> None:
        self._supervisor.lock_absent_joints()
        self._supervisor.restart_hung_threads()
        self._outputs.publish_wanted()
        status = self._status()
        said, checkpoints = self._diagnostics, self._supervisor.checkpoints
        array = said.array(status, self._search.status, checkpoints.status if checkpoints else None)
        self._console.log_complaints(said.errors, said.warnings, said.remarks)
        self._console.log_events(self._news.since(status))
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostic_arrays.publish(array)

    def _status(self) -> Status:
        status = self._worker.status(self._uses_data) if self._worker is not None else Status(active=self._uses_data)
        problems = (*self._inputs.problems, self._problem, *self._supervisor.problems, *status.problems)
        solving = self._supervisor.solving
        clock = self.get_parameter("use_sim_time").value and not self.get_clock().now().nanoseconds
        missing = "use_sim_time is set, but there are no messages on /clock" if clock else ""
        return replace(
            status,
            problems=tuple(filter(None, problems)),
            warnings=tuple(filter(None, (missing, solving.warning if solving else "", *status.warnings))),
            failures=self._supervisor.failures.counts,
            accounts=self._ledger.topics,
            names=self._inputs.names,
            unconfigured=self._unconfigured,
        )

    def _set_active(self, active: bool) -> tuple[bool, str]:
        if active and not self._subscribed:
            return False, "the lifecycle state is not active"
        self._active = active
        return True, "identifying" if active else "stopped; rows and estimate are kept"

    def _reset(self) -> tuple[bool, str]:
        if self._worker is None:
            return False, self._missing
        if self._urdf != self._worker.session.urdf:
            self._build(self._urdf, _TOPIC)
        self._supervisor.reset()
        self._outputs.forget()
        self._payload.forget()
        return True, "all rows discarded"

    def _look(self, act: Callable[[Worker], tuple[bool, str]]) -> tuple[bool, str]:
        """Act on recent messages, if they are remembered."""
        if self._worker is None:
            return False, self._missing
        if self._configuration["gap.memory"] == 0.0:
            return False, "no messages in memory: the parameter gap.memory is 0"
        return act(self._worker)

    def _find_gap(self, worker: Worker) -> tuple[bool, str]:
        if self._search.running:
            return False, "already running; the result is published on ~/gap"
        messages = worker.recent_messages()
        if not messages:
            return False, NO_DATA
        before = worker.estimate_before_gap, worker.messages_before_gap()
        self._search.start(partial(look_for_gap, worker.session, *before, messages))
        return True, "search started; the result is published on ~/gap"

    async def _save(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._worker is None:
            response.success, response.message = False, self._missing
            return response
        future: Future = Future(executor=self.executor)
        self._supervisor.saving.begin_when_solved(self._worker, future.set_result)
        response.success, response.message = await future
        return response

    def close(self) -> None:
        """End the threads within two seconds, and save the last estimate in the output folder, if there is one."""
        if self._dashboard is not None:
            self._dashboard.close()
        self.deactivate()
        self.clean_up()

    def _change_state(self, change: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
        """Answer that the state does not allow a transition: rclpy raises an error instead of an answer."""
        machine, wanted = self._state_machine, request.transition
        labels = {number: label for number, label, *_ in machine.available_transitions}
        if wanted.label in labels.values() or (not wanted.label and wanted.id in labels):
            return change(request, response)
        names = {number: label for number, label, *_ in machine.transition_graph}
        name = wanted.label or names.get(wanted.id, f"transition {wanted.id}")
        self._console.warning(f"{name} is not possible in state {machine.current_state[1]}")
        response.success = False
        return response

    def _outcome(self, act: Callable[[], None]) -> TransitionCallbackReturn:
        """Act for a transition, and report in the log and the diagnostics why it fails."""
        try:
            act()
        except GeomidError as error:
            self._problem = ""
            self._report(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # noqa: BLE001 rclpy would ignore it silently
            self.fail("a transition failed", error)
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Called by rclpy."""
        return self._outcome(self.configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Called by rclpy."""
        super().on_activate(state)
        outcome = self._outcome(self.activate)
        if outcome != TransitionCallbackReturn.SUCCESS:
            self.on_deactivate(state)
        return outcome

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Called by rclpy."""
        super().on_deactivate(state)
        return self._outcome(self.deactivate)

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Called by rclpy."""
        return self._outcome(self.clean_up)

    def on_shutdown(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Called by rclpy."""
        return self._outcome(self.close)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Called by rclpy."""
        self.on_deactivate(state)
        return self.on_cleanup(state)
