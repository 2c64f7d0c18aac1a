"""What all commands share: exit status, what is printed when something goes wrong, and results that appear whole."""

from __future__ import annotations

import argparse
import errno
import json
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Any, NoReturn

from rich.text import Text

from aridcal.system.errors import AridcalError, printable_lines, shortened
from aridcal.system.interrupt import MESSAGE, SIGNALLED, leave
from aridcal.system.progress import Screen, one_thread, silence_stream
from aridcal.system.writing.signals import Handler, Terminated, handling, terminate

DONE, BUG, BAD_INPUT, NOT_GOOD = 0, 1, 2, 3
PIPED = 200
"""Columns of a table in a pipe: none of ours is wider."""

NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT})
INTERRUPTED, TERMINATED = SIGNALLED + signal.SIGINT, SIGNALLED + signal.SIGTERM

SEED_DIGITS = 18
"""Of a seed: 64 bits hold any number of so many."""


def run(body: Callable[[], int | None]) -> int:
    """Do a command's work, and turn errors into a message and an exit status.

    Args:
        body: The work; what it raises decides, or the status that it returns.

    Returns:
        0 done, 1 a bug, 2 bad input or use, 3 what was checked is not good, 130 after Ctrl-C, 143 after SIGTERM.
    """
    console = Screen(stderr=True)
    status: int | None = DONE
    try:
        with _stopped_politely(), one_thread():
            status = body()
            sys.stdout.flush()  # what cannot be printed is to be known here
    except AridcalError as error:
        # As plain text: a station's name in brackets is no markup, and a path must not be broken into lines.
        message = printable_lines(str(error))
        console.print(Text("error: ", style="bold red") + Text(message, style="not bold"), soft_wrap=True)
        return BAD_INPUT
    except KeyboardInterrupt as stop:
        console.print(MESSAGE, soft_wrap=True)
        return TERMINATED if isinstance(stop, Terminated) else INTERRUPTED
    except BrokenPipeError:  # whoever read the output, `head` for instance, has seen enough
        silence_stream(sys.stdout)
        return status or DONE
    except Exception as error:
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            silence_stream(sys.stdout)
            message = f"error: what was to be printed could not be written: {error.strerror}. Make room"
            console.print(message, soft_wrap=True, markup=False)
            return BAD_INPUT
        console.print_exception()
        console.print("this is a bug in aridcal: please report it with the lines above", style="bold red")
        console.print("`aridcal doctor` tells whether the installation is at fault")
        return BUG
    return status or DONE


class CommandParser(argparse.ArgumentParser):
    """A command's arguments; a slip in them is answered with where to look."""

    def error(self, message: str) -> NoReturn:
        """Print what is wrong and exit with status 2."""
        super().error(f"{printable_lines(message)}\n`{self.prog} --help` has an example")

    def print_help(self, file: Any = None) -> None:
        """Print the help; where nobody reads it that is no error, as it is to the parser of Python 3.11.2."""
        with suppress(BrokenPipeError):
            super().print_help(file)

    def exit(self, status: int = 0, message: str | None = None) -> NoReturn:
        """Exit, with status 2 if the help could not be printed."""
        super().exit(run(lambda: None) or status, message)


def command_parser(command: str, doc: str | None) -> CommandParser:
    """Start a command's arguments from its module's docstring, whose ``Example:`` ends the help.

    Args:
        command: The command's name.
        doc: The module's docstring.
    """
    about, _, example = (doc or "").partition("\nExample:\n")
    return CommandParser(
        prog=f"aridcal {command}",
        description=about.strip(),
        epilog=f"example:\n{example.rstrip()}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def command(
    parser: Callable[[], CommandParser], work: Callable[[argparse.Namespace], int | None]
) -> Callable[..., int]:
    """The ``main`` of a command: it reads the arguments, does the work and prints errors; see :func:`run`.

    Args:
        parser: Makes its arguments.
        work: Does the work with these arguments; returns the exit status.
    """

    def main(argv: Sequence[str] | None = None) -> int:
        """Run the command; returns its exit status."""
        arguments = parser().parse_args(argv)
        return run(lambda: work(arguments))

    return main


def seed_argument(text: str) -> int:
    """A seed of the command line: whole, and not below zero."""
    if not text.isdecimal() or len(text) > SEED_DIGITS:
        raise argparse.ArgumentTypeError(f"should be a whole number from 0 on, not {shortened(text)!r}")
    return int(text)


def for_scripts(command: CommandParser, headline: bool = False) -> None:
    """Give a command the options of those who read its exit status, or its JSON, and not its words.

    Args:
        command: Its arguments.
        headline: Whether it can print its result's headline as JSON.
    """
    command.add_argument("--quiet", action="store_true", help="print nothing but errors")
    if headline:
        command.add_argument(
            "--json", action="store_true", help="print the result's headline as JSON, and no words, to stdout"
        )


def for_clusters(command: CommandParser) -> None:
    """Give a command the address of a cluster that may do its work."""
    command.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="of a Dask cluster, tcp://10.0.0.1:8786 for instance (default: processes of this computer)",
    )


def ask(question: str, answers: Sequence[str], why: str) -> int:
    """Ask on the terminal; the first answer is proposed."""
    from rich.prompt import IntPrompt  # two commands ask, and seldom

    console = Screen(stderr=True)
    console.print(f"{question}? ({why})", markup=False)
    for number, answer in enumerate(answers, start=1):
        console.print(f"  {number}  {answer}", markup=False, highlight=False)
    picks = [str(k + 1) for k in range(len(answers))]
    return IntPrompt.ask("your choice", choices=picks, default=1, console=console) - 1


def answer(text: str) -> tuple[str, int]:
    """A key and the number of an answer: the ``type`` of an argument of argparse."""
    key, _, number = text.partition("=")
    if not key or not number.isdecimal() or len(number) > 3:
        raise argparse.ArgumentTypeError(f"should be KEY=NUMBER, units=2 for instance, not {shortened(text)!r}")
    return key, int(number)


def screens(arguments: argparse.Namespace) -> tuple[Screen, Screen]:
    """The screens for a command's result, and for its progress and remarks.

    In a pipe lines are whole, however long they are: what reads them there breaks them as it likes.
    """
    silent, piped = arguments.quiet or getattr(arguments, "json", False), not sys.stdout.isatty()
    words = Screen(quiet=silent, soft_wrap=piped, width=PIPED if piped else None)
    return words, Screen(stderr=True, quiet=arguments.quiet)


def print_headline(arguments: argparse.Namespace, headline: Mapping[str, Any]) -> None:
    """Print a result's headline as one line of JSON, if that was asked for."""
    if arguments.json:
        print(json.dumps(headline, allow_nan=False))


@contextmanager
def _stopped_politely() -> Iterator[None]:
    handlers: dict[signal.Signals, Handler] = {signal.SIGTERM: terminate}
    if signal.getsignal(signal.SIGINT) is leave:  # from here on there may be half a result to clear away
        handlers[signal.SIGINT] = signal.default_int_handler
    with handling(handlers):
        yield
