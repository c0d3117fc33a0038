"""Support modules for tests of several packages."""
