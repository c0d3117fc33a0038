"""Keyboard input: teleoperation keys, key positions, push-to-talk, and what a key does now."""
