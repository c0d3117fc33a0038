"""Tests of recording with the real process and real files."""
