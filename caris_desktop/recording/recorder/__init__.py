"""The recorder: a process that writes one session folder at a time, whatever happens to disk and program."""
