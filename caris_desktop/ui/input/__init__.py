"""Keyboard input: teleoperation keys, physical keys, and push-to-talk."""
