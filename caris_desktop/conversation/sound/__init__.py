"""Sound as numbers: played, taken in, and at another rate."""
