"""Detector backends: one thin runner per inference runtime, behind the interface of ``perception/detector.py``."""
