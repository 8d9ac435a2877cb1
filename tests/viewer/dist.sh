#!/usr/bin/env bash
# Builds the viewer from its sources and its locked packages, and compares with the files that are committed and embedded; judges their size.
#
#   dist.sh [--exact NAME...]   all its tests, or only these, named as in their lines `test NAME ... ok`
#
# Invariant: it builds in a copy under the target directory; nothing in the sources is touched. What there is
# no test of ends in 2.
set -u -o pipefail
here=$(cd "$(dirname "$0")/../.." && pwd)
work=${CARGO_TARGET_DIR:-$here/target}/outer/viewer-dist

tests=(the_lock_file_names_no_machine the_committed_files_are_what_the_sources_make types_and_components_check the_page_is_no_larger_than_its_bounds)
wanted=("${tests[@]/#/viewer_dist::}")
if [ "${1:-}" = --exact ]; then
  shift
  for name in "$@"; do
    printf '%s\n' "${wanted[@]}" | grep -qxF -- "$name" || { echo "dist.sh: no test is called $name" >&2; exit 2; }
  done
  [ $# -gt 0 ] || { echo "dist.sh: --exact wants names" >&2; exit 2; }
  wanted=("$@")
elif [ $# -gt 0 ]; then
  echo "dist.sh: $1 is no option; there is --exact NAME..." >&2
  exit 2
fi
wants() { printf '%s\n' "${wanted[@]}" | grep -qxF -- "viewer_dist::$1"; }

command -v npm >/dev/null || { echo "npm is missing, which builds the viewer"; exit 77; }
mkdir -p "$work/host"
rm -rf "$work/proto" "$work/host/web/src" "$work/host/web/dist" "$work/host/web/public"
cp -r "$here/proto" "$work/" || exit 1
(cd "$here/host/web" && tar --exclude=./node_modules --exclude=./dist --exclude=./src/gen -cf - .) | (mkdir -p "$work/host/web" && tar -C "$work/host/web" -xf -) || exit 1
cd "$work/host/web" || exit 1
passed=0 failed=0
judge() { # name, command...
  local name=$1
  wants "$name" || return 0
  shift
  if "$@"; then
    passed=$((passed + 1)) && echo "test viewer_dist::$name ... ok"
  else
    failed=$((failed + 1)) && echo "test viewer_dist::$name ... FAILED"
  fi
}
over() {
  echo "test result: $([ $failed -eq 0 ] && echo ok || echo FAILED). $passed passed; $failed failed; 0 ignored"
  [ $failed -eq 0 ]
  exit
}
no_machine() {
  grep -q '"resolved"' package-lock.json || return 0
  echo "package-lock.json records where packages came from: npm reads omit-lockfile-registry-resolved in host/web/.npmrc"
  return 1
}
judge the_lock_file_names_no_machine no_machine
# With such a file nothing is fetched; and nothing needs to be for that test alone.
if [ $failed -ne 0 ] || [ "${wanted[*]}" = viewer_dist::the_lock_file_names_no_machine ]; then over; fi
npm ci >npm.log 2>&1 || { tail -n 5 npm.log; echo "npm could not fetch the viewer's packages, see $work/host/web/npm.log"; exit 77; }
built() {
  npm run --silent build && return
  echo "host/web cannot be built"
  return 1
}
same() {
  built && diff -rq dist "$here/host/web/dist" && return
  echo "host/web/dist is not what its sources make: run npm ci && npm run build in host/web and commit dist"
  return 1
}
judge the_committed_files_are_what_the_sources_make same
judge types_and_components_check npm run --silent check
# Bytes: what there was when these were set, and 15 % more. Whoever needs more raises them in the same commit, with the reason.
MOST_EMBEDDED=2530000
MOST_GZIPPED=245000
small() {
  local size page
  [ -d dist ] || built || return
  size=$(cat dist/index.html dist/icon.svg dist/assets/* | wc -c)
  page=$(cat dist/assets/index-*.js dist/assets/index-*.css dist/index.html | gzip -9 | wc -c)
  echo "bench viewer bundle: $size bytes embedded, of which the layout's worker $(cat dist/assets/elk-worker* | wc -c); page without it $page bytes gzipped"
  [ "$size" -gt 0 ] && [ "$page" -gt 0 ] && [ "$size" -le $MOST_EMBEDDED ] && [ "$page" -le $MOST_GZIPPED ] && return
  echo "the viewer has grown: $size bytes embedded, $MOST_EMBEDDED are allowed; $page bytes gzipped for the page, $MOST_GZIPPED are allowed"
  return 1
}
judge the_page_is_no_larger_than_its_bounds small
over
