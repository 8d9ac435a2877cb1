#!/usr/bin/env bash
# Builds the plugins of one earlier minor of the ABI out of this repository's own history: build.sh MINOR COMMIT
#
# 1.0 is of 289555c, 1.1 of aa22543: the last commits whose SDKs spoke them. Built by rustc 1.95 and g++ on x86-64, stripped, without the
# paths of the machine that built them.
set -eu -o pipefail
minor=${1:?usage: build.sh MINOR COMMIT}
commit=${2:?usage: build.sh MINOR COMMIT}
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
trap 'git -C "$here" worktree remove --force "$work/source"; rm -rf "$work"' EXIT
git -C "$here" worktree add --detach "$work/source" "$commit"
export RUSTFLAGS="--remap-path-prefix=${CARGO_HOME:-$HOME/.cargo}=/cargo --remap-path-prefix=$work=/work"
(cd "$work/source" && CARGO_TARGET_DIR="$work/target" cargo build --release --locked -p trocar-example)
bash "$work/source/tests/fixtures/plugins/cpp_filter/build.sh" "$work"
mkdir -p "$here/$minor"
for file in "$work/target/release/libtrocar_example.so" "$work/libtrocar_cpp_filter.so"; do
  strip --strip-unneeded -o "$here/$minor/$(basename "$file")" "$file"
done
