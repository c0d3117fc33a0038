"""Entry point: arguments to the right part of the application."""

import sys


def main() -> int:
    return 0


if __name__ == "__main__":
    sys.exit(main())
