#!/usr/bin/env python3
"""Runs the tests of the Python package in a venv of their own, as a suite of ``tests/run``.

    python3 sdk/python/tests/run.py [PYTEST ARGUMENTS]      all tests but those that judge durations
    python3 sdk/python/tests/run.py --times [ARGUMENTS]     only tests that judge durations
    python3 sdk/python/tests/run.py --exact NAME...         only these tests, named as their lines ``test NAME ... ok`` name them
    python3 sdk/python/tests/run.py --bench [ARGUMENTS]     tests/bench.py instead: what a call costs
    python3 sdk/python/tests/run.py --oldest [ARGUMENTS]    any of these with the oldest Python that pyproject.toml promises

Makes the venv under the target directory, installs the package itself into it (as ``pip install ./sdk/python[ire,test]`` does), and
runs pytest: those of ``outer/`` against the program in TROCAR_BIN_DIR. Prints libtest's lines; names what was skipped in TROCAR_SKIPS.

Exit 2 when there is no test of a name, 77 when the packages cannot be had.

Invariant: runs with two interpreters share no file that either writes; two with the same one take turns at its venv.
"""

import fcntl
import hashlib
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
PACKAGE = HERE.parent
ROOT = HERE.parents[2]
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
VENV = TARGET / "outer" / os.environ.get("TROCAR_PYTHON_VENV", "python-venv")
OLDEST = "3.9"
SKIPPED = 77


def oldest():
    """An interpreter of the oldest version: in PATH, or kept by pyenv."""
    assert f'requires-python = ">={OLDEST}"' in (PACKAGE / "pyproject.toml").read_text(), "OLDEST is what pyproject.toml promises"
    told = subprocess.run(["pyenv", "prefix", OLDEST], capture_output=True, text=True).stdout.strip() if shutil.which("pyenv") else ""
    for python in (f"python{OLDEST}", *([f"{told}/bin/python"] if told else [])):
        found = shutil.which(python)
        if found and subprocess.run([found, "--version"], capture_output=True, text=True).stdout.startswith(f"Python {OLDEST}."):
            return found
    return None


def main():
    if sys.argv[1:2] == ["--oldest"]:
        python = oldest()
        if python is None:
            print(f"Python {OLDEST} is not here, neither as python{OLDEST} nor in pyenv")
            return SKIPPED
        # In a venv of its own beside the other one.
        os.environ["TROCAR_PYTHON_VENV"] = f"python-venv-{OLDEST}"
        os.execv(python, [python, __file__, *sys.argv[2:]])
    VENV.parent.mkdir(parents=True, exist_ok=True)
    with open(f"{VENV}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if code := prepared():
            return code
    directory = tempfile.mkdtemp(prefix="trocar-python-")
    code = run(sys.argv[1:], pathlib.Path(directory))
    if code == 1:
        print(f"what the tests left is in {directory}")
    else:
        shutil.rmtree(directory, ignore_errors=True)
    return code


def prepared():
    """Makes the venv and installs the package; answers why that cannot be, as an exit code."""
    python = VENV / "bin" / "python"
    if not python.exists():
        made = subprocess.run([sys.executable, "-m", "venv", str(VENV)], capture_output=True, text=True)
        if made.returncode:
            print(f"python: no venv can be made: {last(made.stdout + made.stderr)}")
            return SKIPPED
    # Installed as users do it, anew whenever it changed: what is tested is what is packed.
    sources = [PACKAGE / "pyproject.toml", PACKAGE / "README.md", *sorted((PACKAGE / "src" / "trocar").iterdir())]
    state = hashlib.sha256()
    for file in sources:
        if file.is_file():
            state.update(file.name.encode() + file.read_bytes())
    stamp = VENV / "installed"
    if stamp.exists() and stamp.read_text() == state.hexdigest():
        return 0
    with tempfile.TemporaryDirectory(prefix="trocar-python-") as copy:
        # A build writes into the folder that it builds.
        for file in sources:
            to = pathlib.Path(copy) / file.relative_to(PACKAGE)
            to.parent.mkdir(parents=True, exist_ok=True)
            if file.is_file():
                shutil.copy(file, to)
        install = [str(python), "-m", "pip", "install", "-q", "--retries", "1", f"{copy}[ire,test]"]
        done = subprocess.run(install, capture_output=True, text=True)
    if done.returncode:
        print(done.stdout + done.stderr)
        # A package of ours that cannot be built is no excuse; packages that cannot be fetched are.
        fetched = subprocess.run([*install[:-1], "numpy"], capture_output=True, text=True)
        if fetched.returncode == 0:
            print("test result: FAILED. 0 passed; 1 failed; 0 ignored")
            return 1
        print(f"the packages cannot be had: {last(done.stderr)}")
        return SKIPPED
    stamp.write_text(state.hexdigest())
    return 0


def run(arguments, directory):
    """The tests or the benchmark, with a directory of their own for all that they write."""
    python = str(VENV / "bin" / "python")
    own = {"XDG_STATE_HOME": "state", "IPYTHONDIR": "ipython", "MPLCONFIGDIR": "matplotlib"}
    env = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "MPLBACKEND": "Agg", **{name: str(directory / at) for name, at in own.items()}}
    if arguments[:1] == ["--bench"]:
        return subprocess.run([python, str(HERE / "bench.py"), *arguments[1:]], env=env, cwd=directory).returncode
    if "--exact" in arguments:
        at = arguments.index("--exact")
        arguments = [*arguments[:at], *(f"--exact={name}" for name in arguments[at + 1 :])]
    # Not from the source folder: the installed package is meant.
    options = ["-q", "-p", "no:cacheprovider", "-o", "console_output_style=classic", f"--basetemp={directory / 't'}"]
    code = subprocess.run([python, "-m", "pytest", *options, str(HERE), *arguments], env=env, cwd=directory).returncode
    # Pytest's 4 is a wrong use; whatever else is not 0 is a failure, also that there was no test to run.
    return {0: 0, 4: 2}.get(code, 1)


def last(text):
    lines = text.strip().splitlines()
    return lines[-1] if lines else "no reason given"


if __name__ == "__main__":
    sys.exit(main())
