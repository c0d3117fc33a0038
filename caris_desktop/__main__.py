"""Entry point: arguments to the right part of the application."""

import multiprocessing
import sys


def main(arguments: list[str] | None = None) -> int:
    """Run one command; the exit status is 0 when it did what was asked."""
    multiprocessing.freeze_support()
    words = sys.argv[1:] if arguments is None else arguments
    # Late imports: the window must not wait for what only another command needs, nor a child process for any of it.
    from caris_desktop.app import command_table
    from caris_desktop.domain.file_replacement import make_new_files_private
    from caris_desktop.domain.process_settings import title_process

    if arguments is None:  # the whole process is this program
        make_new_files_private()
        title_process(words[0] if words and words[0] in command_table.COMMANDS else "console")
    return command_table.run(words)


if __name__ == "__main__":
    sys.exit(main())
