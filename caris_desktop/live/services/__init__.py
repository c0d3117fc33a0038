"""The parts of the running console, a file each: what it can be asked, what it follows, what it runs."""
