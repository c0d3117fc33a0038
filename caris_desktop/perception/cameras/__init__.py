"""Cameras of this computer and of the network: one interface, one module each, selected by one string."""
