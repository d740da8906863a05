"""The command line, a module for each command."""

from acoustube.cli._app import app, main

__all__ = ["app", "main"]
