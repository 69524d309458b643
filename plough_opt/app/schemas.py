"""`plough-opt schema` and `plough-opt completion`: what editors and shells complete by."""

import argparse
import json

import shtab

from plough_opt.problem_file.json_schema import file_schema


def schema(_options: argparse.Namespace) -> None:
    """Print the JSON schema of problem files."""
    print(json.dumps(file_schema(), indent=2, allow_nan=False))


def completion(options: argparse.Namespace) -> None:
    """Print a script for a shell that completes commands, options and file names."""
    print(shtab.complete(options.parser, shell=options.shell))
