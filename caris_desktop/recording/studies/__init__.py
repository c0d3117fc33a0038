"""Many sessions: finding them, and figures over all of them."""
