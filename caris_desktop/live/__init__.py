"""Console runtime: services, threads, child processes and the bridge to Qt."""
