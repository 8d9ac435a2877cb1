#!/usr/bin/env python3
"""Plain words: comments, the texts that people read, pages and commits.

    python3 tests/words/suite.py                  all of it
    python3 tests/words/suite.py --exact NAME...  only these, named as their lines `test NAME ... ok` name them

Invariant: each rule that fails names the file, the line and the text. `forbidden.txt` beside this file has the words, one a line, with
the ones to write instead.
"""

import fnmatch
import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
COLUMNS = 110
WORDS = 30
# Share of the comment blocks, per cent.
MOST_ODD = 3.0
SUBJECT = 72
# The commits after this one are looked at, where the checkout has it; else the last one.
SINCE = "5d9b1e1"
PAGES = {"README.md": 150, "docs/PLUGIN_GUIDE.md": 250}
ODD = re.compile(r"//[/!]?\s*(What|Who|Whoever|Whatever|One who|Those|It|Of|Where|How)\b")
TEST = re.compile(r"(^tests/|/tests/|/tests\.rs$|_tests\.rs$|/fake|/gen/|/benches/|/examples/)")
# A string literal of Rust: raw, or with escapes.
LITERAL = re.compile(r'\br(#*)"(.*?)"\1|"((?:[^"\\]|\\.)*)"', re.S)


def git(*args):
    """What git says; None where this is no checkout of its own, or git is not there."""
    try:
        done = subprocess.run(["git", *args], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    except OSError:
        return None
    return done.stdout if done.returncode == 0 else None


def all_files():
    found = git("ls-files")
    if found is not None:
        return found.splitlines()
    # A tree without its history: what is built in it apart.
    built = ("target", "node_modules", "__pycache__")
    return [str(path.relative_to(ROOT)) for path in ROOT.rglob("*") if not set(path.relative_to(ROOT).parts) & set(built)]


def listed(*patterns):
    """Files of the tree by name or pattern; all but generated ones."""
    fits = lambda name: any(fnmatch.fnmatch(name, pattern) for pattern in patterns)
    return [name for name in ALL if fits(name) and "/gen/" not in name and (ROOT / name).is_file()]


def lines(name):
    return (ROOT / name).read_text(encoding="utf-8").split("\n")


def comments_are_no_wider():
    """Comment lines of Rust, C, C++ and the interface, which no formatter wraps; rows of tables apart."""
    found = []
    for name in listed("*.rs", "*.h", "*.hpp", "*.cpp", "*.proto"):
        numbered = enumerate(lines(name), 1)
        wide = [at for at, line in numbered if len(line) > COLUMNS and re.match(r"\s*//(?![/!]? \|)", line)]
        found += [f"{name}:{at}: wider than {COLUMNS} columns" for at in wide]
    return found


def comments_open_with_a_noun_or_a_verb():
    blocks, odd = 0, []
    for name in listed("*.rs"):
        before = ""
        for at, line in enumerate(lines(name), 1):
            text = line.strip()
            if text.startswith("//") and not before.startswith("//"):
                blocks += 1
                if ODD.match(text) and not TEST.search(name):
                    odd.append(f"{name}:{at}: {text}")
            before = text
    share = 100 * len(odd) / max(blocks, 1)
    return [f"{share:.1f} % of {blocks} comment blocks open with a word without a noun, {MOST_ODD} % at most:", *odd] if share > MOST_ODD else []


def product_strings():
    """(file, line, text) of each literal that people may read: of product code, with a blank in it."""
    for name in listed("host/*.rs", "plugins/*.rs", "plugin-api/*.rs", "sdk/*.rs"):
        if TEST.search(name):
            continue
        text = (ROOT / name).read_text(encoding="utf-8")
        text = re.sub(r"^\s*#\[cfg\(test\)\]\s*mod \w+ \{.*\Z", "", text, flags=re.M | re.S)
        text = re.sub(r"^\s*//.*$", "", text, flags=re.M)
        for found in LITERAL.finditer(text):
            literal = found.group(2) if found.group(2) is not None else re.sub(r"\\\n\s*", "", found.group(3))
            if " " in literal:
                yield name, text.count("\n", 0, found.start()) + 1, literal.replace("\\n", "\n").replace('\\"', '"')


def sentences_are_short():
    found = []
    for name, at, literal in product_strings():
        # Lists of words, and pages.
        if not re.search(r"[,.:;]", literal) or re.search(r"<[a-z]", literal):
            continue
        for sentence in re.split(r"(?<=[.;:!?])\s+|\n", literal):
            words = re.findall(r"[A-Za-z][A-Za-z'-]*|\{[^}]*\}", sentence)
            if len(words) > WORDS:
                found.append(f"{name}:{at}: {len(words)} words, {WORDS} at most: {' '.join(sentence.split())}")
    return found


def forbidden():
    rows = (line.split("\t") for line in lines("tests/words/forbidden.txt") if line and not line.startswith("#"))
    return [(re.compile(row[0]), row[1]) for row in rows]


def words_are_the_fields_own():
    found, rows = [], forbidden()
    for name, at, literal in product_strings():
        text = re.sub(r"\{[^}]*\}", "{}", literal)
        found += [f"{name}:{at}: write {instead!r}: {literal}" for word, instead in rows if word.search(text)]
    return found


def pages_are_short():
    return [f"{name}: {n} lines, {most} at most" for name, most in PAGES.items() if (n := len(lines(name)) - 1) > most]


def named_files_are_there():
    """Files that the pages about the tree name in backticks, by the end of their path; `src` may be left out."""
    ends = {f"/{name}" for name in listed("*")}
    ends |= {name.replace("/src/", "/") for name in ends}
    found = []
    for page in ("CONTRIBUTING.md", "docs/ARCHITECTURE.md", "docs/GLOSSARY.md", *listed("docs/adr/*.md")):
        named = re.findall(r"`([\w./-]+\.(?:rs|py|mjs|ts|svelte|proto|h|toml|json))`", "\n".join(lines(page)))
        gone = {name for name in named if not any(end.endswith(f"/{name}") for end in ends)}
        found += [f"{page}: {name}: there is no such file" for name in sorted(gone)]
    return found


def links_lead_somewhere():
    """Relative links of the pages: the file is there, and so is the heading behind #."""
    found, headings = [], {}

    def anchors(path):
        if path not in headings:
            text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
            names = re.findall(r"^#+ (.*)$", text, re.M)
            headings[path] = {re.sub(r"[^\w\- ]", "", name.lower().replace("`", "")).strip().replace(" ", "-") for name in names}
        return headings[path]

    for name in listed("*.md"):
        page = ROOT / name
        text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
        for link in re.findall(r"\]\(([^)\s]+)\)", text):
            if re.match(r"[a-z]+:", link):
                continue
            target, _, anchor = link.partition("#")
            path = (page.parent / target).resolve() if target else page
            if not path.exists():
                found.append(f"{name}: {link}: there is no such file")
            elif anchor and path.suffix == ".md" and anchor not in anchors(path):
                found.append(f"{name}: {link}: there is no such heading")
    return found


def commits_say_why():
    which = f"{SINCE}..HEAD" if git("cat-file", "-e", f"{SINCE}^{{commit}}") is not None else "-1"
    log = git("log", which, "--no-merges", "--format=%h%x00%s%x00%b%x01")
    if log is None:
        print("there is no history here: no commit was read")
        return []
    found = []
    for entry in filter(None, (part.strip() for part in log.split("\x01"))):
        number, subject, body = entry.split("\x00")
        if len(subject) > SUBJECT:
            found.append(f"{number}: its subject has {len(subject)} letters, {SUBJECT} at most: {subject}")
        if not body.strip():
            found.append(f"{number}: no body says why: {subject}")
    return found


ALL = all_files()
RULES = [
    comments_are_no_wider,
    comments_open_with_a_noun_or_a_verb,
    sentences_are_short,
    words_are_the_fields_own,
    pages_are_short,
    named_files_are_there,
    links_lead_somewhere,
    commits_say_why,
]


def main():
    exact = "--exact" in sys.argv[1:]
    words = [word for word in sys.argv[1:] if word != "--exact"]
    rules = {f"words::{rule.__name__}": rule for rule in RULES}
    means = (lambda word, name: word == name) if exact else (lambda word, name: word in name)
    if unknown := [word for word in words if not any(means(word, name) for name in rules)]:
        print(f"suite.py: no rule is called {', '.join(unknown)}", file=sys.stderr)
        sys.exit(2)
    passed, failed = 0, 0
    for name, rule in rules.items():
        if words and not any(means(word, name) for word in words):
            continue
        found = rule()
        passed, failed = passed + (not found), failed + bool(found)
        print(f"test {name} ... {'FAILED' if found else 'ok'}", flush=True)
        if found:
            print("\n".join(found), flush=True)
    print(f"test result: {'FAILED' if failed else 'ok'}. {passed} passed; {failed} failed; 0 ignored")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
