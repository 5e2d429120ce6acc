"""`scanrender`: commands, and the one place where errors become exit codes."""

from __future__ import annotations

import importlib
import io
import sys

import click

from scanrender import __version__
from scanrender.errors import ScanrenderError

# Command -> (module, sentence). Modules are imported when their command is called, so that
# `--help` answers at once.
COMMANDS = {
    "demo": ("demo", "Make our own raw head, prepare it, and render its turntable."),
    "run": ("run", "Run a pipeline on one or several scans; what is done already stays."),
    "cache": ("cache", "Say what earlier runs left, check it, and why it would be made again."),
    "report": ("morning", "Write the page that explains a folder of results: report.html."),
    "prep": ("prep", "Prepare a raw scan: clean, simplify, unwrap, bake into an asset folder."),
    "render": ("render", "Render frames and buffers of a prepared asset."),
    "plan": ("plan", "Say what a shot can leave out, what that changes, and what it saves."),
    "bench": ("bench", "Measure what preparing a scan costs, and what it loses."),
    "trade": ("trade", "Measure what each setting costs in time and in error against truth."),
    "compare": ("compare", "Say how far one rendered picture is from another."),
    "stress": (
        "stress",
        "Render extreme scenes and hold each to what any picture must keep.",
    ),
    "inspect": ("inspect", "Say what is in a raw scan and how healthy it is."),
    "validate": ("validate", "Check pipeline files without running them; needs no GL."),
    "schema": ("schema", "Print the JSON Schema of pipeline files; needs no GL."),
    "doctor": ("doctor", "Say what this machine has, and what to do about what it has not."),
}


class LazyGroup(click.Group):
    """Lists commands from a table and imports only the one that is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        module = importlib.import_module(f"scanrender.cli.{COMMANDS[name][0]}")
        command = module.command
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, sentence) for name, (_, sentence) in COMMANDS.items()])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            import difflib

            near = difflib.get_close_matches(args[0], COMMANDS, 1)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            raise click.UsageError(f"There is no command {args[0]!r}.{hint}", ctx)
        return super().resolve_command(ctx, args)


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Exit codes: 0 ok, 1 bug, 2 usage, 3 config, 4 scan unusable, 5 stage failed, "
    "6 no usable GL, 7 output not writable, 8 several jobs and some failed, 130 interrupted.",
)
@click.version_option(__version__, prog_name="scanrender")
def cli() -> None:
    """A raw 3D scan of a person goes in, a believable skin turntable comes out."""


def main() -> None:
    """Run the command line and exit with its documented code."""
    debug = "--debug" in sys.argv
    # Names of files may hold bytes that are no text: shown with a mark, as stderr does.
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        code = cli.main(standalone_mode=False)
    except click.exceptions.Exit as stop:
        code = stop.exit_code
    except click.ClickException as error:
        error.show()
        code = error.exit_code
    except (KeyboardInterrupt, click.Abort):
        click.echo("interrupted; what was complete stays", err=True)
        code = 130
    except ScanrenderError as error:
        if debug:
            raise
        click.echo(f"scanrender: {error}", err=True)
        code = error.exit_code
    except BrokenPipeError:
        # The reader of our output went away (scanrender schema | head): not an error of ours.
        sys.stderr.close()
        code = 0
    except Exception as error:
        if debug:
            raise
        click.echo(
            f"scanrender: this is a bug in scanrender: {type(error).__name__}: {error}\n"
            "  to do: run the same command with --debug and report what it prints",
            err=True,
        )
        code = 1
    sys.exit(code if isinstance(code, int) else 0)
