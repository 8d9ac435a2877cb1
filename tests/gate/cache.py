#!/usr/bin/env python3
"""Keeps compiled dependencies between runs of `.ci/run` on one machine, under
`${XDG_CACHE_HOME:-~/.cache}/trocar-ci`.

    python3 tests/gate/cache.py restore     puts them into an empty target directory
    python3 tests/gate/cache.py keep        copies those of the target directory

An entry is named after the lock file, the manifests' profiles and the compiler. cargo judges each file by its
own fingerprints all the same, and a file whose sum is not the one that was written down makes the whole entry
void.

Invariant: nothing of our own crates is kept, and nothing here can fail a run: without a cache everything is
compiled.
"""

import hashlib
import json
import os
import pathlib
import shutil
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
MOST_BYTES = 20 * 10**9
# cargo's own folders in a profile's directory.
FOLDERS = (".fingerprint", "build", "deps")
SUMS = "sums.json"


def main(word):
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    home = pathlib.Path(os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache") / "trocar-ci"
    entry = home / key()
    began = time.monotonic()
    if word == "restore":
        said = restore(entry, target)
    else:
        said = keep(entry, target)
        bound(home)
    print(f"cache: {said} ({time.monotonic() - began:.0f} s)", flush=True)


def key():
    """Another lock file, profile, compiler or set of flags is another entry."""
    compiler = subprocess.run(["rustc", "-vV"], capture_output=True, text=True, check=True).stdout
    manifests = [(ROOT / name).read_text() for name in ("Cargo.toml", "Cargo.lock")]
    flags = [os.environ.get(name, "") for name in ("RUSTFLAGS", "CARGO_ENCODED_RUSTFLAGS")]
    return hashlib.sha256("\0".join([compiler, *manifests, *flags]).encode()).hexdigest()[:32]


def restore(entry, target):
    if not (entry / SUMS).exists():
        return "nothing was kept for this lock file and compiler"
    if any((folder / FOLDERS[0]).exists() for folder in profiles(target)):
        return "the target directory is in use already"
    sums = json.loads((entry / SUMS).read_text())
    wrong = next(
        (name for name, one in sums.items() if not (entry / name).is_file() or sum_of(entry / name) != one),
        None,
    )
    if wrong:
        shutil.rmtree(entry)
        return f"{wrong} is not what was kept, so all of it was thrown away"
    for name in sums:
        to = target / name
        to.parent.mkdir(parents=True, exist_ok=True)
        # With its times, by which cargo tells what is older than what.
        shutil.copy2(entry / name, to)
    os.utime(entry)
    return f"{len(sums)} files put into {target}"


def keep(entry, target):
    if (entry / SUMS).exists():
        os.utime(entry)
        return "kept already"
    ours = own_names()
    draft = entry.with_name(f"{entry.name}.{os.getpid()}")
    sums = {}
    for profile in profiles(target):
        for folder in FOLDERS:
            for file in files(profile / folder):
                name = file.relative_to(target)
                if crate_of(file.relative_to(profile / folder).parts[0]) in ours:
                    continue
                (draft / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(file, draft / name)
                sums[str(name)] = sum_of(draft / name)
    if not sums:
        return "nothing is compiled here"
    (draft / SUMS).write_text(json.dumps(sums))
    try:
        draft.rename(entry)
    except OSError:
        # Another run kept the same at the same time.
        shutil.rmtree(draft)
    return f"{len(sums)} files kept"


def profiles(target):
    """The directories in which cargo compiles for us: programs and tests, loom, tsan."""
    found = [target / "release", target / "loom" / "release", target / "tsan" / "debug"]
    return found + sorted(target.glob("tsan/*-*-*/debug"))


def files(folder):
    return (
        [path for path in folder.rglob("*") if path.is_file() and not path.is_symlink()]
        if folder.is_dir()
        else []
    )


def crate_of(entry):
    """ "libserde_json-0123abcd.rlib" and "serde_json-0123abcd" are of serde_json."""
    return entry.rsplit("-", 1)[0].removeprefix("lib").replace("-", "_")


def own_names():
    said = subprocess.run(
        ["cargo", "metadata", "--no-deps", "--format-version", "1"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    packages = json.loads(said.stdout)["packages"]
    names = {package["name"] for package in packages} | {
        target["name"] for package in packages for target in package["targets"]
    }
    return {name.replace("-", "_") for name in names}


def sum_of(path):
    with open(path, "rb") as file:
        return (
            hashlib.file_digest(file, "sha256").hexdigest()
            if hasattr(hashlib, "file_digest")
            else hashlib.sha256(file.read()).hexdigest()
        )


def bound(home):
    """Removes what was not used for longest until the rest is within the bound."""
    entries = sorted(
        (entry for entry in home.iterdir() if entry.is_dir()),
        key=lambda entry: entry.stat().st_mtime,
        reverse=True,
    )
    total = 0
    for number, entry in enumerate(entries):
        total += sum(file.stat().st_size for file in files(entry))
        if total > MOST_BYTES and number > 0:
            shutil.rmtree(entry, ignore_errors=True)


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except (OSError, ValueError, subprocess.CalledProcessError) as error:
        print(f"cache: not used: {error}", flush=True)
