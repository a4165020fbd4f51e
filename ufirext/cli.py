"""The command line: `ufirext track`, `ufirext demo` and `ufirext certify`."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import typer

__all__ = ["build", "main"]


def build() -> typer.Typer:
    """The application with its commands; what they need is imported here and nowhere earlier."""
    import typer

    from . import __version__
    from .certify_cli import certify
    from .demo.cli import demo
    from .track.command import track

    app = typer.Typer(
        name="ufirext",
        help="Finite-memory state estimation of recorded tracks, and certificates of gains.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
    )

    def version(wanted: bool) -> None:
        if wanted:
            typer.echo(f"ufirext {__version__}")
            raise typer.Exit

    @app.callback()
    def common(
        _version: bool = typer.Option(
            False, "--version", callback=version, is_eager=True, help="Say the version."
        ),
    ) -> None:
        """Finite-memory state estimation of recorded tracks, and certificates of gains."""

    app.command("track")(track)
    app.command("demo")(demo)
    app.command("certify")(certify)
    return app


def main() -> None:
    """Entry point of the console script."""
    try:
        app = build()
    except ModuleNotFoundError as error:
        sys.exit(f"ufirext: the command line needs {error.name}: pip install 'ufirext[cli]'")
    app(prog_name="ufirext")


if __name__ == "__main__":
    main()
