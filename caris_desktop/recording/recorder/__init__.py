"""Recorder process: writes one session folder at a time, robust against crashes and a full disk."""
