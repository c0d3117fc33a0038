"""Runner of another module as a program: ``python -m tests.support.run_module MODULE ARGUMENTS...``.

Each child process of multiprocessing imports the main module of its parent again. If that module imported the console,
its eight child processes would import the console too, 1.6 s of CPU time each; this module imports nothing.
"""

import runpy
import sys

if __name__ == "__main__":
    sys.argv = sys.argv[1:]
    runpy.run_module(sys.argv[0], run_name="__main__")
