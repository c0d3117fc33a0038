"""Random access to recorded sessions: values by arrival time, and video frames."""
