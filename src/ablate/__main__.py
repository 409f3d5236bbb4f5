"""Entry point of `python -m ablate` and of the console script `ablate`."""

import re
import sys
from io import TextIOWrapper

from ablate.config import ConfigurationError
from ablate.studies.jobs.compose import read_command_line


def main() -> None:
    """Compose and check the command line, then run its task. Bad input gives one line on stderr and exit code 2."""
    for stream in (sys.stdout, sys.stderr):  # a locale may know no ± and no χ²
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        command = read_command_line(sys.argv[1:])
        if command is None:
            return
        from ablate.tasks import run_task  # heavy imports only after the command line is known to compose

        code = run_task(command)
    except ConfigurationError as error:
        said = re.sub(r"://[^\s@]*@", "://...@", str(error))  # no password on the screen
        print(f"ablate: {said}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit("ablate: interrupted; the same command continues where it stopped")
    sys.exit(code)


if __name__ == "__main__":
    main()
