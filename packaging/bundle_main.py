"""Entry point of the bundle: the command caris-desktop, or a module for which the program starts a process."""

import multiprocessing
import runpy
import sys


def main() -> int:
    multiprocessing.freeze_support()
    # The program starts others as `python [-P] -m MODULE`, and in a bundle sys.executable is this file.
    match sys.argv[1:]:
        case ["-m", module, *arguments] | ["-P", "-m", module, *arguments]:
            sys.argv[1:] = arguments
            runpy.run_module(module, run_name="__main__", alter_sys=True)
            return 0
    from caris_desktop.__main__ import main as caris_desktop  # freeze_support may not return

    return caris_desktop()


if __name__ == "__main__":
    sys.exit(main())
