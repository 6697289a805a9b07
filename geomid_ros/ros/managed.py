"""Node that a lifecycle manager may configure, activate and shut down."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from geomid_ros.errors import GeomidError


class Managed(LifecycleNodeMixin):
    """Lifecycle transitions of a node. Each does one thing, which a node without a manager does by itself.

    A transition that raises GeomidError fails, and the state stays. After any other error the node is unconfigured.
    """

    def manage(self) -> None:
        """Offer the services of a managed node. Without this call, the class does nothing."""
        LifecycleNodeMixin.__init__(self)
        service = self._service_change_state
        service.callback = partial(self._answered, service.callback)

    def _answered(self, change: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
        """Answer that the state does not allow a transition: rclpy raises an error instead of an answer."""
        try:
            return change(request, response)
        except RuntimeError as error:  # raised by rclpy
            self.fail("a transition failed", error)
            response.success = False
            return response

    @abstractmethod
    def configure(self) -> None:
        """Create the identifier."""

    @abstractmethod
    def activate(self) -> None:
        """Subscribe to data."""

    @abstractmethod
    def deactivate(self) -> None:
        """Unsubscribe from data. Rows and estimate are kept."""

    @abstractmethod
    def clean_up(self) -> None:
        """Write the checkpoint, and discard rows and estimate."""

    @abstractmethod
    def close(self) -> None:
        """End for good."""

    @abstractmethod
    def refuse(self, problem: str) -> None:
        """Log why a transition fails."""

    @abstractmethod
    def fail(self, what: str, error: Exception) -> None:
        """Log an exception."""

    def start(self) -> None:
        """Configure and activate, as far as that succeeds."""
        if self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            self.trigger_activate()

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

    def _outcome(self, act: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            act()
        except GeomidError as error:
            self.refuse(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # noqa: BLE001 rclpy would ignore it silently
            self.fail("a transition failed", error)
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS
