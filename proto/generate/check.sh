#!/usr/bin/env bash
# Compares the committed code of trocar.v1 with what its .proto files give. A suite of tests/run: prints libtest's lines.
set -u
target=${CARGO_TARGET_DIR:-$(cd "$(dirname "$0")/../.." && pwd)/target}
word=ok passed=1 failed=0
cargo run --quiet --manifest-path "$(dirname "$0")/Cargo.toml" --target-dir "$target/generate" -- --check || { word=FAILED passed=0 failed=1; }
echo "test generated::the_committed_code_is_what_the_proto_files_give ... $word"
echo "test result: $word. $passed passed; $failed failed; 0 ignored"
[ $failed -eq 0 ]
