"""``trocar-ire``: IPython with a connected session, ``ire``.

Invariant: leaves with the codes of the command line: 0 ok, 1 refused, 2 usage, 3 no GCM.
"""

from __future__ import annotations

import argparse
import sys

import trocar

from . import _ipython


def main(argv: list[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(
        prog="trocar-ire", description="Interactive research environment: IPython with a running trocar system as `ire`."
    )
    parser.add_argument("file", nargs="?", help="run this Python file, then stop (with -i: stay)")
    parser.add_argument(
        "--gcm",
        metavar="ADDR",
        help="address of the GCM to ask; of several, all with commas between them [default: $TROCAR_GCM or 127.0.0.1:50551]",
    )
    parser.add_argument("--name", default="ire", help="name of this process in the graph [default: %(default)s]")
    parser.add_argument("-c", metavar="CODE", dest="code", help="run this code, then stop (with -i: stay)")
    parser.add_argument("-i", dest="stay", action="store_true", help="stay after the file or the code")
    parser.add_argument("--version", action="version", version=f"trocar-ire {trocar.__version__}")
    arguments = parser.parse_args(argv)
    try:
        from IPython import start_ipython
        from traitlets.config import Config
    except ImportError:
        print("trocar-ire: IPython is missing: pip install ipython", file=sys.stderr)
        return 1
    try:
        ire = trocar.connect(arguments.gcm, name=arguments.name)
    except trocar.TrocarError as e:
        print(f"trocar-ire: {e}", file=sys.stderr)
        return 3 if e.code in ("UNAVAILABLE", "DEADLINE_EXCEEDED") else 1
    config = Config()
    config.TerminalInteractiveShell.banner1 = (
        f"trocar {trocar.__version__}: {ire.address}, seen there as {ire.process or 'nobody'}\n"
        "`ire.tree` shows the system, `ire.<TAB>` what can be done with it, `name?` explains.\n"
    )
    config.InteractiveShellApp.extensions = ["trocar.ire"]
    # Attributes are looked up by our own matcher; jedi would only guess.
    config.IPCompleter.use_jedi = False
    given = [] if arguments.code is None else ["-c", arguments.code]
    given += [] if arguments.file is None else [arguments.file]
    given += ["-i"] if arguments.stay and given else []
    with ire:
        start_ipython(argv=given, user_ns={"trocar": trocar, "ire": ire}, config=config)
    return 0


def load_ipython_extension(shell: object) -> None:
    """``%load_ext trocar.ire``: completion of live names and paths."""
    _ipython.install(shell)


if __name__ == "__main__":
    sys.exit(main())
