"""``caris-desktop plugins``: plug-ins of all groups, and whether each can be loaded."""

import argparse

from caris_desktop.domain import plugins
from caris_desktop.domain.plugin_process import why_unusable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--all", action="store_true", help="list the built-in ones too")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 1 if one of them cannot be loaded."""
    unusable = False
    for group in plugins.GROUPS:
        shown = [one for one in plugins.installed(group).values() if arguments.all or not one.is_built_in]
        version = plugins.INTERFACES[group]
        print(f"{group} (interface version {version}){'' if shown else ': no plug-ins'}", flush=True)
        for plugin in shown:
            wrong = "" if plugin.is_built_in else why_unusable(plugin)
            unusable = unusable or bool(wrong)
            mark = "FIX " if wrong else "ok  "
            print(f"  {mark} {plugin.name:<20} {plugin.package}{f': {wrong}.' if wrong else ''}", flush=True)
    return 1 if unusable else 0
