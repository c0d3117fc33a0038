"""Simulated robot, in its own process behind a rosbridge websocket."""
