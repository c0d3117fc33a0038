"""The parts of the protocol strip."""
