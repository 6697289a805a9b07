"""Monitoring of a stream: detection of changes and of payloads."""
