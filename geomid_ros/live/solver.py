"""The solver's thread: decides when enough data are new, and turns rows into estimates."""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import takewhile
from typing import TypeAlias

import numpy as np

from geomid_ros.checks.sample_reservoir import FEWEST
from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import WarmStart
from geomid_ros.live.status import Failures, Listener
from geomid_ros.live.threads import Activity, start_daemon
from geomid_ros.model.samples import Samples
from geomid_ros.monitoring.change_detection import (
    PART,
    ChangeDetector,
    changed_sensors,
    robot_may_have_changed,
    sensor_channels,
)
from geomid_ros.monitoring.payload_watch import CarriedPayload
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.payload import change_detector
from geomid_ros.session.session import Session
from geomid_ros.signals.settings import MOST_WAITING
from geomid_ros.types import IntArray

NEW_SHARE = 1.0 / 11.0
"""Fraction of the remembered data that must be new for a solve: the data have then grown by a tenth, and standard
deviations have fallen by a twentieth. The estimate moves by less than a third of its standard deviation."""
_PERIODS = 10  # after which a solve is due in any case


class Pace:
    """Decides at the end of each period whether a solve is due."""

    def __init__(self) -> None:
        self._seen = 0  # number of rows one period ago
        self._skipped = 0  # periods since the last solve

    def is_due(self, rows: int, much_is_new: bool) -> bool:
        """True if a solve is due: if much is new, at every tenth period, or once no more data come.

        Args:
            rows: present number of rows, some of them newer than the last estimate.
            much_is_new: True if at least :data:`NEW_SHARE` of them is new.
        """
        ceased, self._seen = rows == self._seen, rows
        self._skipped += 1
        if not (much_is_new or ceased or self._skipped == _PERIODS):
            return False
        self._skipped = 0
        return True


SOLVING, WATCHING = "solving", "searching for changes"
_FAILURE = "the solver failed"
_CARRIED = "payload carried"  # why rows are left out
_EARLIER = 64  # estimates kept: those made until a gap is detected, over most of a minute or more
CHOSEN_ANEW = 0.5
"""New fraction of the data at which effects and the prior's weight are selected again."""

Done: TypeAlias = Callable[[Estimate | GeomidError], None]


class Solver:
    """Solves in a thread: when enough data are new (:class:`Pace`), and on request. With a finite forgetting time,
    changes are to be followed, so it solves in every period.

    Estimates that are not finite are discarded, and one that did not converge does not replace one that did. Rows
    are left out while a payload is carried, and from the check of the recording, too; its messages are forgotten
    once it is put down. The rows of a mounted wrench sensor are left out while the sensor is changed, unless old
    rows are forgotten anyway.
    """

    def __init__(self, session: Session, period: float, listener: Listener, failures: Failures) -> None:
        """
        Args:
            session: session with the rows.
            period: [s] between solves, at least; nothing is solved while no rows come.
            listener: receives estimates and payloads in the solver's thread.
            failures: counts exceptions.
        """
        self._session, self._listener, self._failures = session, listener, failures
        self.period = period  # [s] between solves
        self._forgets = bool(np.isfinite(session.configuration.buffer.forgetting_time))
        self._sensors = sensor_channels(session.model)
        self._reported: CarriedPayload | None = None  # last payload passed to the listener
        self._carried_since = 0  # stamp [ns] since which anything was carried last
        self._reported_gaps: set[str] | None = None  # channels of the last gaps passed to the listener
        self._lock = threading.RLock()  # held briefly, for all fields below
        self.estimate: Estimate | None = None  # the last one
        self._earlier: deque[tuple[int, Estimate]] = deque(maxlen=_EARLIER)  # latest ones, with their sample counts
        self.problem = ""  # why the last solve gave no new estimate
        self._epoch = 0  # results of earlier epochs are discarded
        self.solves = 0  # number of estimates so far
        self._solved_rows = 0
        self._unchecked: deque[tuple[int, Samples]] = deque(maxlen=MOST_WAITING)  # with the numbers of the next ones
        self._awaiting: tuple[int, Estimate] | None = None  # to be confirmed, with the number of the next sample
        self._later: deque[tuple[int, Samples]] = deque(maxlen=MOST_WAITING)  # since then, with the same numbers
        session.review.await_confirmation()
        self._pace = Pace()
        self._from_scratch: tuple[tuple[int, int], Estimate] | None = None  # the latest, with its epoch and rows
        self.changed_sensors: tuple[str, ...] = ()  # topics of sensors whose rows are left out
        self.detector = self._new_detector()
        self.activity = Activity()
        self._requests: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()  # None: the thread is to end
        self._thread = start_daemon("solver", self._solve_repeatedly)

    def close(self, patience: float) -> None:
        """End the thread. A running solve is finished first and the estimate updated, but for no longer than
        ``patience`` [s]."""
        self._requests.put(self._solve_for_last_rows)
        self._requests.put(None)
        self._thread.join(patience)
        with self._lock:
            self._epoch += 1  # nobody waits for a result any more

    def request(self, done: Done) -> None:
        """Solve from scratch, unless that was done for the same rows. ``done(result)`` is called in the solver's
        thread."""
        self._requests.put(partial(self._answer, done))

    def request_change_search(self) -> None:
        """Request a search for changes, as there are enough rows. Requests that wait already include one."""
        if self._requests.empty():
            self._requests.put(self._watch)

    def check_later(self, samples: Samples, ends: IntArray) -> None:
        """Give samples to the check of the recording, once it is known that nothing was carried. ``ends (N,)``: the
        number of samples with rows up to each."""
        pieces = [range(len(samples))[begin : begin + PART] for begin in range(0, len(samples), PART)]
        with self._lock:
            self._unchecked += [(int(ends[piece[-1]]), samples.select(np.array(piece))) for piece in pieces]

    def reset(self) -> None:
        """Discard all rows and what was learned from them."""
        with self._lock:
            self._unchecked.clear()
            self._session.identifier.reset()
            self.begin_anew()

    def reconfigure(self, configuration: Configuration) -> None:
        """Solve all rows again with another configuration; a running solve is discarded. Raises InputError, and changes
        nothing, if the configuration does not fit."""
        with self._lock:
            self._session.reconfigure(configuration)
            self.period = configuration["solve_period"]
            self._solve_afresh()

    def begin_anew(self) -> None:
        """Discard what was learned, or is being solved, from rows some of which were taken back."""
        with self._lock:
            self._session.watch = None
            self.detector = self._new_detector()
            self.changed_sensors = ()
            self.estimate = None
            self._earlier.clear()
            self._awaiting = None
            self._later.clear()
            self._session.review.await_confirmation()
            self.problem = ""
            self._solve_afresh()

    def _solve_afresh(self) -> None:
        """Let the next solve choose its starting point and the prior's weight again."""
        self._epoch += 1
        self._session.warm_start = None
        self._solved_rows = 0

    @property
    def payload(self) -> CarriedPayload | None:
        """Payload that was picked up; None if there is none."""
        payload = self.detector.payload
        return None if payload is None else payload.payload

    def estimate_before(self, instant: int) -> Estimate | None:
        """Return the last estimate from samples before this index; None if that is too long ago."""
        with self._lock:
            earlier = [estimate for samples, estimate in self._earlier if samples <= instant]
        return earlier[-1] if earlier else None

    def _new_detector(self) -> ChangeDetector:
        """Return a detector that goes on with what is known of payloads."""
        detector = change_detector(self._session)
        if detector.payload is not None and self._session.watch is not None:
            with self._failures.counted("what is known of payloads could not be restored"):
                detector.payload.restore(self._session.watch)
        return detector

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
            identifier, solved = self._session.identifier, self._solved_rows
            if (rows := identifier.rows) == solved:
                return
            much_is_new = self._forgets or bool(self.problem) or identifier.has_grown_beyond(solved, NEW_SHARE)
            if self._pace.is_due(rows, much_is_new):
                self._solve_once(self._warm_start())
            else:
                self._judge()

    def _solve_for_last_rows(self) -> None:
        """Update the estimate at the end if a warm start suffices; a longer solve is not waited for."""
        warm = self._warm_start()
        if warm and not warm.effects_alone and self._session.identifier.rows != self._solved_rows:
            with self.activity.doing(SOLVING):
                self._solve_once(warm)

    def _judge(self) -> None:
        """Run the checks of the recording when many data are new; before a solve, which may take long."""
        with self._failures.counted(_FAILURE):
            if self._session.review.check.due:
                self._session.review.judge()

    def _detect_changes(self) -> None:
        detector = self.detector
        with self._failures.counted(_FAILURE):
            while detector.test():
                self._judge_rows(detector)
            self._judge_rows(detector)
            if detector is self.detector:
                self._report_changes(detector)

    def _report_changes(self, detector: ChangeDetector) -> None:
        if (carried := self.payload) is not self._reported:
            self._reported = carried
            self._listener.on_payload(carried)
        gaps = [gap for gap in detector.gaps if gap.since is not None]
        if (channels := {gap.channel for gap in gaps}) != self._reported_gaps:
            self._reported_gaps = channels
            self._listener.on_gaps(gaps)

    def _judge_rows(self, detector: ChangeDetector) -> None:
        """Leave out what the detector found to be changed, and accept for good what is sound."""
        suspect: list[int] = []
        with self._lock:
            if detector is not self.detector:  # it was reset meanwhile
                return
            if not self._forgets and self._sensors:
                self._leave_out_changed_sensors(detector)
                robot_changed = robot_may_have_changed(detector.gaps, self._session.model)
                suspect = [] if robot_changed else [place for places in self._sensors.values() for place in places]
            samples = self._leave_out_carried(detector)
            check = self._session.review.check
        self._session.identifier.settle(detector.unchanged_before(suspect))
        if samples:
            with self._failures.counted("a check of the recording failed"):
                check.add(Samples.concatenate([piece for _, piece in samples]))
            if self._session.review.unconfirmed:
                self._later += samples

    def _leave_out_carried(self, detector: ChangeDetector) -> list[tuple[int, Samples]]:
        """Leave out the rows with a payload, and return the unchecked samples that are known to be without, with the
        numbers of the next ones."""
        identifier, known, judged = self._session.identifier, detector.weighed_before, detector.searched_until
        self._session.watch = None if detector.payload is None else detector.payload.memory
        if self.payload is not None:
            self._carried_since = self.payload.picked_up
            if identifier.leave_out(_CARRIED, range(len(self._session.model.channels)), known):
                self._solved_rows = 0  # the estimate may have learned from them
        elif identifier.restore_rows(_CARRIED, judged):
            known = 0  # the payload was just put down: all that waits may be with it
            self._session.recent.forget(self._carried_since, detector.searched_stamp)
        else:
            judged = known
        unchecked = self._unchecked
        taken = [unchecked.popleft() for _ in takewhile(lambda item: item[0] <= judged, tuple(unchecked))]
        return [piece for piece in taken if piece[0] <= known]

    def _leave_out_changed_sensors(self, detector: ChangeDetector) -> None:
        """Leave out the rows of changed sensors."""
        changed, identifier = changed_sensors(detector.gaps, self._session.model), self._session.identifier
        self.changed_sensors = tuple(changed or ())
        for topic, channels in self._sensors.items():
            reason = f"wrench changed: {topic}"
            if changed is None:  # the robot may have changed, not a sensor
                identifier.restore_rows(reason, 0)
            elif topic not in changed:
                identifier.restore_rows(reason, detector.searched_until)
            elif identifier.leave_out(reason, channels, changed[topic]):
                self._solve_afresh()

    def _warm_start(self) -> WarmStart | None:
        """Return the starting point of the next solve; None before the first, and after a failed one. If much is new,
        it has the effects only, and the prior's weight is chosen again."""
        with self._lock:
            warm = self._session.warm_start
            if warm is None or self.problem:
                return None
            return replace(warm, effects_alone=self._session.identifier.has_grown_beyond(warm.rows, CHOSEN_ANEW))

    def _solve_from_scratch(self) -> Estimate | GeomidError:
        """Solve from scratch, or return the result for the same rows: clients ask again after a timeout."""
        with self._lock:
            data = self._epoch, self._session.identifier.rows
        if self._from_scratch is not None and self._from_scratch[0] == data:
            return self._from_scratch[1]
        result = self._solve_once(None)
        self._from_scratch = (data, result) if isinstance(result, Estimate) else None
        return result

    def _solve_once(self, warm: WarmStart | None) -> Estimate | GeomidError:
        with self._lock:
            rows, epoch, samples = self._session.identifier.rows, self._epoch, self._session.identifier.sample_count
        self._judge()
        try:
            self._session.review.check_description()
            estimate = self._finite(self._session.identifier.solve(warm))
            if self._keep(estimate, rows, samples, epoch, warm):
                self._listener.on_estimate(self._session, estimate)
        except Exception as error:  # noqa: BLE001 the last estimate stays; the diagnostics report it
            if not isinstance(error, GeomidError):
                self._failures.add(_FAILURE, error)
            with self._lock:
                if epoch == self._epoch:
                    self.problem = f"no estimate: {error}"
            return error if isinstance(error, GeomidError) else GeomidError(str(error))
        return estimate

    def _confirm_with_later(self) -> None:
        """Let the samples since an estimate, once there are enough, decide whether estimates are confirmed; then await
        those since the last one."""
        if self._awaiting is not None:
            known, estimate = self._awaiting
            later = [piece for end, piece in self._later if end - len(piece) >= known]
            if sum(map(len, later)) < FEWEST:
                return
            self._session.review.confirm(estimate, later)
        self._awaiting = self._earlier[-1]
        self._later.clear()  # to save memory

    def _finite(self, estimate: Estimate) -> Estimate:
        if np.all(np.isfinite(estimate.parameters)):
            return estimate
        raise GeomidError("the solver's result is not finite")

    def _keep(self, estimate: Estimate, rows: int, samples: int, epoch: int, warm: WarmStart | None) -> bool:
        """Keep an estimate from the first ``samples``, unless its rows were discarded meanwhile or it did not converge
        while the previous one did."""
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
            prior_rows = rows if warm is None or warm.effects_alone else warm.rows
            self._session.warm_start = WarmStart(estimate.parameters, prior_rows, estimate.prior_stds)
            self._earlier.append((samples, estimate))
            self._confirm_with_later()
            return True
