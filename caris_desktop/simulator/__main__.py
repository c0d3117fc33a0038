"""``python -m caris_desktop.simulator``: the simulated robot without the rest of the program."""

import argparse
import sys


def main() -> int:
    """Parse the arguments and run the robot."""
    # Late: the camera process imports this module too, and needs little of it.
    from caris_desktop.domain.process_settings import title_process
    from caris_desktop.simulator.simulate_command import add_arguments, run

    title_process("simulate")
    parser = argparse.ArgumentParser(prog="python -m caris_desktop.simulator", description=__doc__)
    add_arguments(parser)
    return run(parser.parse_args())


if __name__ == "__main__":
    sys.exit(main())
