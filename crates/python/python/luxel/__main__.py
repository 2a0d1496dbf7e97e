"""The program `luxel`, as `luxel` on the path or `python -m luxel`."""

import sys

from luxel import _luxel


def main() -> int:
    """Runs the command line and returns its exit code."""
    return _luxel.main(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
