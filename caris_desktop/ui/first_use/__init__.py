"""First start: try a simulated robot, or set up everything step by step."""
