"""Follow what a running node finds: link masses as they come in, and what it warns of.

Needs ROS 2. Start a node and a recording, each in a terminal of its own, then this script; Ctrl-C ends it::

    geomid_node --ros-args -p robot_description:="$(cat bags/arm7.urdf)"
    geomid play bags/arm7
    python examples/live_subscriber.py
"""

import signal
from threading import Event

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import InertiaStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions


class Listener(Node):
    """Prints the outputs of a node that is called ``/geomid``."""

    def __init__(self) -> None:
        super().__init__("geomid_listener")
        # Inertias are latched: who comes late gets the last ones at once. One message per link.
        latched = QoSProfile(depth=256, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(InertiaStamped, "geomid/inertias", self.on_inertia, latched)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_diagnostics, 10)

    def on_inertia(self, message: InertiaStamped) -> None:
        """The centre of mass is in the link's frame, the inertia about it in the link's axes."""
        com = message.inertia.com
        print(f"{message.header.frame_id}: {message.inertia.m:.3f} kg at ({com.x:+.3f}, {com.y:+.3f}, {com.z:+.3f}) m")

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """The stream's status warns of bad messages and of gaps that open."""
        for status in message.status:
            if status.name.endswith(": stream") and status.level != DiagnosticStatus.OK:
                print(f"warning: {status.message}")


# Ctrl-C only asks to stop: rclpy may be in the middle of a message.
stopped = Event()
signal.signal(signal.SIGINT, lambda *_: stopped.set())
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
listener = Listener()
while not stopped.is_set():
    rclpy.spin_once(listener, timeout_sec=0.2)
