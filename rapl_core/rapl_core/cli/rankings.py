"""``rapl rankings``: hand on a run's rankings, or take some in."""

import argparse
from pathlib import Path
from typing import Any


def add_to(commands: Any) -> None:
    """Declare the command and its verbs."""
    rankings = commands.add_parser("rankings", help="hand on a run's rankings, or take some in")
    verbs = rankings.add_subparsers(dest="verb", required=True)
    out = verbs.add_parser("export", help="write all rankings, corrected and withdrawn ones too")
    out.add_argument("run", type=Path, help="run folder")
    out.add_argument("out", type=Path, help="folder to write to")
    out.add_argument("--format", choices=("jsonl", "parquet"), default="jsonl")
    out.add_argument("--bags", action="store_true", help="with the bags of the ranked episodes")
    out.set_defaults(work=_export)
    into = verbs.add_parser("import", help="add the rankings that a run lacks, and their bags")
    into.add_argument("run", type=Path, help="run folder")
    into.add_argument("source", type=Path, help="folder of an export, or a .jsonl or .parquet file")
    into.set_defaults(work=_import)


def _export(arguments: argparse.Namespace) -> None:
    from rapl_core.preferences.package import export_package

    done = export_package(arguments.run, arguments.out, arguments.format, arguments.bags)
    print(f"{done.path}: {done.rankings} rankings, {done.episodes} bags copied")


def _import(arguments: argparse.Namespace) -> None:
    from rapl_core.preferences.package import import_package

    done = import_package(arguments.run, arguments.source)
    print(f"{arguments.run}: {done.rankings} rankings added, {done.episodes} bags copied")
