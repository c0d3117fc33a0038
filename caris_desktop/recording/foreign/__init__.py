"""Import of bags that other programs recorded."""
