"""The running console: threads, child processes and the bridge to Qt."""
