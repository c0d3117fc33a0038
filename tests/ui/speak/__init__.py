"""Tests of caris_desktop.ui.speak."""
