"""The program `arrive`, also on a robot's computer, where the command line's own libraries are missing."""

import importlib.util
import sys


def main() -> None:
    """Run a command; of all commands `verify` needs NumPy and onnxruntime alone."""
    if importlib.util.find_spec("tyro") is not None:
        from arrive.cli import main as run

        run()
    elif sys.argv[1:2] == ["verify"]:
        from arrive.deployment.verify import main as verify

        verify(sys.argv[2:])
    else:
        print(
            "arrive: this is the controller's installation, which has only `arrive verify FILE`; "
            "for all else: pip install arrive",
            file=sys.stderr,
        )
        sys.exit(1)


if __name__ == "__main__":
    main()
