"""Things that several rooms test with."""
