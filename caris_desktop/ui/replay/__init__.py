"""What a replay shows beside the panels: the bar that moves through the session, and the timeline to annotate it."""
