"""Saves estimates in a thread, as a disk may be slow, and answers, as it may be full."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

from geomid_ros.errors import GeomidError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.live.activity import Activity
from geomid_ros.session.session import Session

_LONG = 1.0  # [s]

Answer: TypeAlias = tuple[bool, str]


class Saving:
    """Saves estimates into one folder."""

    def __init__(self, folder: str) -> None:
        """An empty ``folder`` is the working directory."""
        self._folder = Path(folder or ".").resolve()
        self._activity = Activity()
        self._problem = ""
        self._one_at_a_time = threading.Lock()

    @property
    def problems(self) -> tuple[str, ...]:
        """Why the last attempt failed, and that the present one is slow."""
        _, seconds = self._activity.current
        slow = f"saving takes {seconds:.0f} s so far: {self._folder} is slow" if seconds > _LONG else ""
        return tuple(filter(None, (self._problem, slow)))

    def begin(self, session: Session, result: Estimate | GeomidError, done: Callable[[Answer], None]) -> None:
        """Save in a thread.

        Args:
            session: whose estimate it is.
            result: the estimate, or why there is none.
            done: is called in the thread with whether that succeeded, and a sentence.
        """
        self._in_background(lambda: done(self._save(session, result)))

    def save_last(self, session: Session, estimate: Estimate, patience: float) -> str:
        """Save, unless it takes longer than ``patience`` [s]. Returns a sentence on how that went."""
        answers: list[Answer] = []
        self._in_background(lambda: answers.append(self._save(session, estimate))).join(patience)
        return answers[0][1] if answers else f"{self._folder} is too slow to save the last estimate"

    def _in_background(self, act: Callable[[], None]) -> threading.Thread:
        # A daemon: the process may end while a slow disk is waited for.
        thread = threading.Thread(target=act, name="geomid-saving", daemon=True)
        thread.start()
        return thread

    def _save(self, session: Session, result: Estimate | GeomidError) -> Answer:
        if isinstance(result, GeomidError):
            return False, str(result)
        with self._one_at_a_time, self._activity.doing("saving"):
            try:
                session.save(self._folder, result)
            except Exception as error:  # noqa: BLE001 the caller must have an answer
                self._problem = f"the estimate could not be saved: {error}"
                return False, str(error)
        self._problem = ""
        return True, f"written: {self._folder / 'estimate.json'}, {self._folder / 'identified.urdf'}"
