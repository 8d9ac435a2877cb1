#!/usr/bin/env bash
# The viewer in a real browser: Debian's chromium, driven by playwright-core, on built programs. Prints libtest's lines.
#
#   run.sh                  all tests but those that judge durations
#   run.sh --times          only tests that judge durations
#   run.sh WORD...          those of all tests whose name holds one of the words
#   run.sh --exact NAME...  only these tests, named as in their lines `test NAME ... ok`
#
# Invariant: what is missing is said in the last line and ends in 77: skipped by name, never passed.
set -u -o pipefail
here=$(cd "$(dirname "$0")" && pwd)
target=${CARGO_TARGET_DIR:-$here/../../target}
work=$target/outer/viewer
mkdir -p "$work"

command -v node >/dev/null && command -v npm >/dev/null || { echo "node and npm are missing, which run the browser's driver"; exit 77; }
if [ -z "${CHROMIUM:-}" ]; then
  if ! command -v chromium >/dev/null; then
    [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null &&
      { apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends chromium fonts-dejavu-core; } >"$work/apt.log" 2>&1
  fi
  CHROMIUM=$(command -v chromium) || { echo "chromium is missing and was not installed (root and apt do it; or set CHROMIUM), see $work/apt.log"; exit 77; }
fi
[ -n "${GRPCURL:-}" ] || { echo "grpcurl is missing: set GRPCURL"; exit 77; }
export CHROMIUM

cp "$here"/package.json "$here"/package-lock.json "$here"/.npmrc "$here"/*.mjs "$work"/ || exit 1
cd "$work" || exit 1
if [ ! -d node_modules/playwright-core ] || ! cmp -s package-lock.json node_modules/.installed; then
  npm ci --ignore-scripts >npm.log 2>&1 || { tail -n 5 npm.log; echo "npm could not fetch playwright-core, see $work/npm.log"; exit 77; }
  cp package-lock.json node_modules/.installed
fi
exec node suite.mjs "$@"
