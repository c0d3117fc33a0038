"""What runs detectors: one thin runner for each runtime, behind the interface of ``perception/detector.py``."""
