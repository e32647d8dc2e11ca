"""The command line: ``tledface VERB``."""

from tledface.cli.app import app, main

__all__ = ["app", "main"]
