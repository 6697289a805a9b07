"""The thread that turns rows into estimates."""

from __future__ import annotations

import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeAlias

import numpy as np

from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import WarmStart
from geomid_ros.live.pace import NEW_SHARE, Pace
from geomid_ros.live.status import Listener
from geomid_ros.live.threads import Activity, start_daemon
from geomid_ros.monitoring.change_detection import (
    ALARM,
    ChangeDetector,
    changed_sensors,
    robot_may_have_changed,
    sensor_channels,
)
from geomid_ros.monitoring.payload_watch import Carried
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.payload import payload_watch
from geomid_ros.session.session import Session
from geomid_ros.signals.ledger import count_reason

SOLVING, WATCHING = "solving", "searching for changes"
_EARLIER = 64  # estimates, so many as are made until a gap is known: most of a minute, or more
_CHOSEN_ANEW = 0.5  # share of what is remembered that is new when effects and the prior's weight are chosen anew

Done: TypeAlias = Callable[[Estimate | GeomidError], None]


class Solver:
    """Solves in a thread, as new data make it worth (:class:`Pace`), and when asked. Who wants old data forgotten wants
    changes followed: then it solves in every period.

    An estimate that is worse than none is not kept. The rows of a mounted wrench sensor are left out while it is not
    what it was, unless old rows are forgotten anyway.
    """

    def __init__(self, session: Session, period: float, listener: Listener) -> None:
        """
        Args:
            session: has the rows.
            period: [s] between solves, at least; nothing is solved while no rows come.
            listener: is told of estimates and payloads in the thread.
        """
        self._session = session
        self.period = period  # [s] between solves
        self._forgets = bool(np.isfinite(session.configuration.buffer.forgetting_time))
        self._sensors = sensor_channels(session.model)
        self._listener = listener
        self._told: Carried | None = None  # as the listener was told last
        self._lock = threading.Lock()  # held, briefly, for all that follows
        self.estimate: Estimate | None = None  # the last one
        self._earlier: deque[tuple[int, Estimate]] = deque(maxlen=_EARLIER)  # the last ones, by the instants they know
        self.problem = ""  # why the last try gave no new estimate
        self._failures: Counter[str] = Counter()
        self._epoch = 0  # a result of an earlier one is thrown away
        self.solves = 0  # estimates made so far
        self._solved_rows = 0
        self._pace = Pace()
        self._closing = False
        self._from_scratch: tuple[tuple[int, int], Estimate] | None = None  # the last, and of which epoch and rows
        self.changed_sensors: tuple[str, ...] = ()  # topics of those whose rows are left out
        self.detector = self._new_detector()
        self.activity = Activity()
        self._requests: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()  # None: the thread is to end
        self._thread = start_daemon("solver", self._solve_repeatedly)

    def close(self, patience: float) -> None:
        """End. A solve is finished first, and the estimate made up to date, unless that takes longer than ``patience``
        [s]."""
        self._closing = True
        self._requests.put(None)
        self._thread.join(patience)
        with self._lock:
            self._epoch += 1
            self._closing = False  # nobody waits any more

    def ask(self, done: Done) -> None:
        """Solve from scratch, unless that was done for the same rows. ``done`` is called with the result, in the
        solver's thread."""
        self._requests.put(partial(self._answer, done))

    def watch(self) -> None:
        """Look for changes, as there are rows enough to judge; with whatever is asked for already they are looked for,
        too."""
        if self._requests.empty():
            self._requests.put(self._watch)

    def reset(self) -> None:
        """Forget all rows, and what was learned from them."""
        with self._lock:
            self._session.identifier.reset()
            self._begin_anew()

    def use(self, configuration: Configuration) -> None:
        """Solve all rows anew by another configuration; a solve that runs is thrown away. Raises InputError, and
        changes nothing, if it does not fit."""
        with self._lock:
            self._session.use(configuration)
            self.period = configuration["solve_period"]
            self._solve_afresh()

    def begin_anew(self) -> None:
        """Forget what was learned, or is being solved, from rows some of which were taken back."""
        with self._lock:
            self._begin_anew()

    def _begin_anew(self) -> None:
        self.detector = self._new_detector()
        self.changed_sensors = ()
        self.estimate = None
        self._earlier.clear()
        self.problem = ""
        self._solve_afresh()

    def _solve_afresh(self) -> None:
        """Let the next solve choose its starting point and the prior's weight anew, whatever was solved before."""
        self._epoch += 1
        self._session.warm = None
        self._solved_rows = 0

    @property
    def carried(self) -> Carried | None:
        """A payload that was picked up."""
        payload = self.detector.payload
        return None if payload is None else payload.carried

    def estimate_before(self, instant: int) -> Estimate | None:
        """The last estimate that knows nothing of the instant of this number and later ones; None if it is too long
        ago."""
        known = [estimate for instants, estimate in tuple(self._earlier) if instants <= instant]
        return known[-1] if known else None

    @property
    def failures(self) -> Counter[str]:
        """Exceptions in the solver, by what they said."""
        with self._lock:
            return self._failures.copy()

    def _new_detector(self) -> ChangeDetector:
        """By rows in which each effect has its usual shape alone: all shapes together would fit away what is to be
        noticed, and take long to learn."""
        model = self._session.model
        usual = [*range(len(model.nominal_inertias)), *model.usual_shapes.values()]
        channels = [replace(c, columns=np.intersect1d(c.columns, usual)) for c in model.channels]
        payload = payload_watch(self._session, channels, ALARM)
        return ChangeDetector(channels, self._session.configuration.buffer.forgetting_time, payload)

    def _solve_repeatedly(self) -> None:
        next_solve = time.monotonic()
        while True:
            try:
                request = self._requests.get(timeout=max(0.0, next_solve - time.monotonic()))
            except queue.Empty:
                next_solve = time.monotonic() + self.period
                self._solve_for_new_rows()
                continue
            if request is None:
                if self._closing:
                    self._solve_for_the_last_rows()
                return
            request()

    def _watch(self) -> None:
        with self.activity.doing(WATCHING):
            self._detect_changes()

    def _answer(self, done: Done) -> None:
        with self.activity.doing(SOLVING):
            self._detect_changes()
            result = self._solve_from_scratch()
        done(result)

    def _solve_for_new_rows(self) -> None:
        with self.activity.doing(SOLVING):
            self._detect_changes()
            rows, identifier = self._session.identifier.rows, self._session.identifier
            if rows == self._solved_rows:
                return
            much_is_new = self._forgets or bool(self.problem) or identifier.outgrown(self._solved_rows, NEW_SHARE)
            if self._pace.worth(rows, much_is_new):
                self._solve_once(self._warm_start())
            else:
                self._judge()

    def _solve_for_the_last_rows(self) -> None:
        """Make the estimate up to date where that is a step from the last one: nobody waits for more in the end."""
        warm = self._warm_start()
        step = warm is not None and not warm.effects_alone
        if step and self._session.identifier.rows != self._solved_rows:
            with self.activity.doing(SOLVING):
                self._solve_once(warm)

    def _judge(self) -> None:
        """Judge the data as a whole when there are many new ones; before a solve, which may take long."""
        try:
            if self._session.review.check.due:
                self._session.review.judge()
        except Exception as error:  # noqa: BLE001 as below
            self._fail(error)

    def _detect_changes(self) -> None:
        detector = self.detector
        try:
            while detector.judge():
                self._leave_out_changed_sensors(detector)
            self._tell_payload(detector)
        except Exception as error:  # noqa: BLE001 the thread must outlive it; the diagnostics report it
            self._fail(error)

    def _tell_payload(self, detector: ChangeDetector) -> None:
        if detector is self.detector and (carried := self.carried) is not self._told:
            self._told = carried
            self._listener.carried(carried)

    def _leave_out_changed_sensors(self, detector: ChangeDetector) -> None:
        """Leave out the rows of sensors that have changed; accept for good those that are known to be sound."""
        if self._forgets or not self._sensors:
            return
        changed = changed_sensors(detector.gaps, self._session.model)
        with self._lock:
            if detector is not self.detector:  # all was forgotten meanwhile
                return
            self.changed_sensors = tuple(changed or ())
            for topic, channels in self._sensors.items():
                reason = f"wrench changed: {topic}"
                if changed is None:  # nothing is wrong with the sensor
                    self._session.identifier.take_again(reason, 0)
                elif topic not in changed:
                    self._session.identifier.take_again(reason, detector.judged)
                elif self._session.identifier.leave_out(reason, channels, changed[topic]):
                    self._solve_afresh()
        robot = robot_may_have_changed(detector.gaps, self._session.model)
        doubted = [] if robot else [place for places in self._sensors.values() for place in places]
        self._session.identifier.settle(detector.normal(doubted))

    def _warm_start(self) -> WarmStart | None:
        """Where to start; None, or at the effects alone, which choose the prior's weight anew, when that was chosen for
        other data, or for much fewer."""
        with self._lock:
            warm = self._session.warm
            if warm is None or self.problem:
                return None
            return replace(warm, effects_alone=self._session.identifier.outgrown(warm.rows, _CHOSEN_ANEW))

    def _solve_from_scratch(self) -> Estimate | GeomidError:
        """What is asked for twice is solved once: who has asked again was told that it takes long."""
        with self._lock:
            data = self._epoch, self._session.identifier.rows
        if self._from_scratch is not None and self._from_scratch[0] == data:
            return self._from_scratch[1]
        result = self._solve_once(None)
        self._from_scratch = (data, result) if isinstance(result, Estimate) else None
        return result

    def _solve_once(self, warm: WarmStart | None) -> Estimate | GeomidError:
        with self._lock:
            rows, epoch, instants = self._session.identifier.rows, self._epoch, self._session.identifier.instants
        self._judge()
        try:
            self._session.review.check_description()
            estimate = self._finite(self._session.identifier.solve(warm))
            if self._keep(estimate, rows, epoch, warm):
                self._earlier.append((instants, estimate))
                self._listener.estimate(self._session, estimate)
        except Exception as error:  # noqa: BLE001 the last estimate stays; the diagnostics report it
            if not isinstance(error, GeomidError):
                self._fail(error)
            with self._lock:
                if epoch == self._epoch:
                    self.problem = f"no estimate: {error}"
            return error if isinstance(error, GeomidError) else GeomidError(str(error))
        return estimate

    def _finite(self, estimate: Estimate) -> Estimate:
        if np.all(np.isfinite(estimate.parameters)):
            return estimate
        raise GeomidError("the solver's result is not finite")

    def _keep(self, estimate: Estimate, rows: int, epoch: int, warm: WarmStart | None) -> bool:
        """Keep an estimate, unless its rows were forgotten meanwhile or it is worse than the one before."""
        with self._lock:
            if epoch != self._epoch:
                return False
            self.solves += 1
            self._solved_rows = rows
            if not estimate.converged and self.estimate is not None and self.estimate.converged:
                self.problem = f"no new estimate: {estimate.reason}"
                return False
            self.problem = ""
            self.estimate = estimate
            chosen = rows if warm is None or warm.effects_alone else warm.rows
            self._session.warm = WarmStart(estimate.parameters, chosen, estimate.spreads)
            return True

    def _fail(self, error: Exception) -> None:
        with self._lock:
            count_reason(self._failures, f"the solver failed: {type(error).__name__}: {error}")
