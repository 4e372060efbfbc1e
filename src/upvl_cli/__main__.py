"""Where `upvl` starts, also as `python -m upvl_cli`: ready to be stopped before anything slow is loaded."""

from __future__ import annotations

import os
import signal
import sys

STOPPED = "upvl: stopped; what was finished is kept, and the same command goes on from there\n"
STOPPED_BY_PERSON = 130  # 128 + SIGINT, as shells have it


def main() -> None:
    """Run the command line, and tell in one line how it ended where it did not end well."""
    if sys.platform == "win32":
        sys.exit(_refuse_windows())
    _on_signals(_leave_at_once)
    if os.environ.get("COLUMNS") == "0":
        del os.environ["COLUMNS"]  # some terminals say so, and mean that they do not know
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    # The stages keep the cores busy with frames; threads of the linear algebra would only be in their way,
    # and would add up in another order on a machine with other cores.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from upvl_cli.cli import run

    _on_signals(_interrupt)
    try:
        code = run(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader of our output has left, as `head` does: nothing to say, and nobody to say it to.
        os._exit(1)
    except KeyboardInterrupt:
        code = STOPPED_BY_PERSON
    except OSError as error:
        if error.filename is not None:
            raise
        _say(f"upvl: cannot write to the terminal or file that the output goes to: {error.strerror}\n")
        os._exit(2)
    if code == STOPPED_BY_PERSON:
        _on_signals(signal.SIG_IGN)
        _say(STOPPED)
    sys.exit(code)


def _refuse_windows() -> int:
    """Say what to do on native Windows, which has neither the file locks nor the signals that upvl needs."""
    _say(
        "upvl: native Windows is not supported; run it under WSL: https://learn.microsoft.com/windows/wsl/install\n"
    )
    return 2


def _on_signals(handler: signal._HANDLER) -> None:
    # A closed terminal and a scheduler's end are answered as Ctrl-C is: clean up, say so, leave.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, handler)


def _interrupt(number: int, _: object) -> None:
    _on_signals(signal.SIG_IGN)  # a second Ctrl-C must not break the cleaning up
    raise KeyboardInterrupt


def _leave_at_once(number: int, _: object) -> None:
    """Nothing has begun yet that would have to be cleaned up."""
    _say(STOPPED)
    os._exit(STOPPED_BY_PERSON)


def _say(line: str) -> None:
    os.write(2, line.encode())


if __name__ == "__main__":
    main()
