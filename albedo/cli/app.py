"""The application: what all commands have in common."""

from __future__ import annotations

import errno
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from albedo.errors import InputError

NOTHING_FITS = 1


BAD_INPUT = 2


INTERRUPTED = 130


class _Commands(TyperGroup):
    """Commands whose bad input ends in one sentence and a status, not in a traceback."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except InputError as error:
            fail(str(error))
        except OSError as error:
            # A reader that has seen enough (| head) is no failure of ours: typer ends quietly.
            if error.errno == errno.EPIPE:
                raise
            where = f" '{error.filename}'" if error.filename else ""
            fail(f"The file{where} cannot be used: {error.strerror or error}")
        except KeyboardInterrupt:
            _end_interrupted()
        except RuntimeError as error:
            # Python 3.11 says so of an interruption while an attribute is told its name.
            if not isinstance(error.__cause__, KeyboardInterrupt):
                raise
            _end_interrupted()


def _end_interrupted() -> NoReturn:
    typer.echo("Interrupted; files that were not finished were not kept.", err=True)
    raise typer.Exit(INTERRUPTED)


def fail(message: str) -> NoReturn:
    sentence = message if message.endswith((".", "?", "!")) else message + "."
    typer.echo(f"Error: {sentence}", err=True)
    raise typer.Exit(BAD_INPUT)


# Plain help: examples hold square brackets, which markup would swallow, and it starts faster.
app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


study_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


app.add_typer(study_app, name="study", help="List and run studies: one file, one question.")


def _print_version(wanted: bool) -> None:
    if wanted:
        import albedo

        typer.echo(f"albedo {albedo.__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Directional albedos of reflectance models, every number with an error bound.

    A model is written as its name and parameters: ward:m=0.1, or
    cook_torrance:m=0.3,distribution=ggx. A sweep is m=0.02..1/32 (32 even steps),
    m=0.001..1/32log, or m=[.1,.2,.5]; a vector is (.9,.5,.1). Models add up, each times a number:
    "phong:n=20 + 0.3*lambert", or "0.5*(phong:n=20 + lambert)".

    \b
    Examples:
      albedo models ward
      albedo eval ward:m=0.1 --theta 0,60,85
      albedo table "ward:m=0.02..1/32" -o ward.nc
      albedo plot ward:m=0.1 phong:n=150 -o albedo.png
    """
