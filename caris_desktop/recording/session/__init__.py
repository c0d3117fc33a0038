"""A session folder that was written: reading, repairing and checking it, and what happened in it as wholes."""
