"""Cameras of this computer and of the network: one interface, one file each, chosen by one string."""
