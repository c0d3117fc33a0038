"""``caris-desktop plugins``: plug-ins of all groups, and whether each can be loaded."""

import argparse
import multiprocessing
from multiprocessing.connection import Connection

from caris_desktop.domain import plugins
from caris_desktop.domain.plugins import LOAD_WITHIN_S, Plugin, PluginError


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
            wrong = why_unusable(plugin)
            unusable = unusable or bool(wrong)
            mark = "FIX " if wrong else "ok  "
            print(f"  {mark} {plugin.name:<20} {plugin.package}{f': {wrong}.' if wrong else ''}", flush=True)
    return 1 if unusable else 0


def why_unusable(plugin: Plugin) -> str:
    """Why the plug-in cannot be loaded, as a clause; empty if it can. Imports it in a process of its own."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_load, args=(theirs, plugin), daemon=True)
    process.start()
    theirs.close()
    try:
        if not ours.poll(LOAD_WITHIN_S):
            return f"it was not loaded within {LOAD_WITHIN_S:g} s"
        return str(ours.recv())
    except EOFError:
        return "it ended its process"
    finally:
        process.kill()
        process.join()
        ours.close()


def _load(connection: Connection, plugin: Plugin) -> None:
    try:
        with plugins.watched(plugin):
            plugins.load(plugin)
    except PluginError as error:
        connection.send(error.reason)
    else:
        connection.send("")
