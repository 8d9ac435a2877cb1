#!/usr/bin/env python3
"""Runs the tests of the Python package in a venv of their own, as a suite of ``tests/run``.

    python3 sdk/python/tests/run.py [PYTEST ARGUMENTS]
    python3 sdk/python/tests/run.py --bench [ARGUMENTS]     tests/bench.py instead: what a call costs
    python3 sdk/python/tests/run.py --oldest [ARGUMENTS]    the same tests with the oldest Python that pyproject.toml promises

Makes the venv under the target directory, installs the package itself into it (``pip install ./sdk/python[ire,test]``), and runs
pytest: those of ``outer/`` against the program in TROCAR_BIN_DIR. Prints libtest's lines; names what was skipped in TROCAR_SKIPS.

Exit 77 when the packages cannot be had.
"""

import hashlib
import os
import pathlib
import shutil
import subprocess
import sys

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
    python = VENV / "bin" / "python"
    if not python.exists():
        VENV.parent.mkdir(parents=True, exist_ok=True)
        made = subprocess.run([sys.executable, "-m", "venv", str(VENV)], capture_output=True, text=True)
        if made.returncode:
            print(f"python: no venv can be made: {last(made.stdout + made.stderr)}")
            return SKIPPED
    # Installed as users do it, anew whenever it changed: what is tested is what is packed.
    state = hashlib.sha256()
    for file in sorted([PACKAGE / "pyproject.toml", *(PACKAGE / "src" / "trocar").iterdir()]):
        if file.is_file():
            state.update(file.name.encode() + file.read_bytes())
    stamp = VENV / "installed"
    if not stamp.exists() or stamp.read_text() != state.hexdigest():
        install = [str(python), "-m", "pip", "install", "-q", "--retries", "1", f"{PACKAGE}[ire,test]"]
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
    env = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "MPLBACKEND": "Agg", "IPYTHONDIR": str(VENV / "ipython")}
    if sys.argv[1:2] == ["--bench"]:
        return subprocess.run([str(python), str(HERE / "bench.py"), *sys.argv[2:]], env=env, cwd=VENV).returncode
    # Not from the source folder: the installed package is meant.
    command = [str(python), "-m", "pytest", "-q", "-p", "no:cacheprovider", str(HERE), *sys.argv[1:]]
    return subprocess.run(command, env=env, cwd=VENV).returncode


def last(text):
    lines = text.strip().splitlines()
    return lines[-1] if lines else "no reason given"


if __name__ == "__main__":
    sys.exit(main())
