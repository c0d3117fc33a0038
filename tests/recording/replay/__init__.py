"""Tests of random access to recorded sessions."""
