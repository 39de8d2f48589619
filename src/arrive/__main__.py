"""The program `arrive`. It also runs on a robot's computer without the libraries of the command line."""

from arrive.output import lost_output, make_output_last
from arrive.startup import INTERRUPTED, interrupt_again, leave_at_once

leave_at_once()  # before anything else is loaded

import importlib.util  # noqa: E402
import sys  # noqa: E402


def main() -> None:
    """Run a command. Only `verify` works with NumPy and onnxruntime alone."""
    make_output_last()
    try:
        _run()
    except KeyboardInterrupt:
        print("arrive: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except SystemExit as stop:
        if stop.code:
            raise
    finally:
        leave_at_once()  # libraries are stopping their threads
    if why := lost_output():
        print(f"arrive: cannot write to standard output: {why}", file=sys.stderr)
        sys.exit(1)


def _run() -> None:
    if importlib.util.find_spec("tyro") is not None:
        from arrive.cli import main as run

        run()
    elif sys.argv[1:2] == ["verify"]:
        from arrive.deployment.verify import main as verify

        interrupt_again()
        verify(sys.argv[2:])
    else:
        print(
            "arrive: this is the controller-only installation, which has only `arrive verify FILE`; "
            "for other commands install the dependencies: pip install . in a checkout",
            file=sys.stderr,
        )
        sys.exit(1)


if __name__ == "__main__":
    main()
