"""What other software wants of an estimate: payloads of robot controllers, inertials of robot descriptions."""
