# Short names for what is typed often; every line also works by hand.

# The newcomer's first command.
demo:
    cargo build --release
    ./target/release/trocar demo

# Every test, or the suites named.
test *suites:
    ./tests/run {{suites}}

# What must pass before a change is taken.
ci:
    ./.ci/run

# The figures of docs/BENCHMARKS.md, alone on the machine.
bench:
    cargo build --profile dist -p trocar-cli -p trocar-tests -p trocar-fixture-gauge -p trocar-eyerobot -p trocar-example
    cargo build --release --manifest-path tests/bench/peers/Cargo.toml --target-dir target/peers
    TROCAR_BIN_DIR=$PWD/target/dist GRPCURL=$(find target/outer -name grpcurl -type f | head -1) ./target/dist/bench

# Vision plugins beside OpenCV, and the OCT chain in numpy: makes a venv under target/.
bench-vision:
    python3 tests/bench/peers/vision.py --output target/peers/vision.json

# Writes golden files anew: CLI surface, errors.md, INTERFACES.md, trocar_payloads.h, generated protocol code.
bless:
    cargo run --manifest-path proto/generate/Cargo.toml
    TROCAR_BLESS=1 cargo test -p trocar-model
    TROCAR_BLESS=1 cargo test -p trocar-plugin-api --features manifest
    TROCAR_BLESS=1 cargo test -p trocar-sdk --test c_payloads
    TROCAR_BLESS=1 cargo test -p trocar-cli --test cli_surface

# Interleavings of the real-time core.
loom:
    RUSTFLAGS="--cfg loom" CARGO_TARGET_DIR=target/loom cargo test -p trocar-rt --release --lib loom_

# Licences, advisories, sources.
deny:
    cargo deny check
