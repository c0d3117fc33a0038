"""The first minutes with the program: try it with a simulated robot, or connect everything, step by step."""
