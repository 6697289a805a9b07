"""What the commands print, loaded once there is something to print."""
