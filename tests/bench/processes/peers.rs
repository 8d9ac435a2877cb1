//! Others who do the same, built apart from trocar: `tests/bench/peers`.

use std::process::Command;

use trocar_tests::repository;

/// What stands in the table instead.
pub(super) const MISSING: &str = "iceoryx2: `cargo build --release --manifest-path tests/bench/peers/Cargo.toml --target-dir target/peers`";

/// Median way of a sample of iceoryx2 to a process that sleeps until it is told, ns; `None` where it was not
/// built.
pub(super) fn one_way(bytes: usize, count: usize) -> Option<f64> {
    let program = repository().join("target/peers/release/peer-iceoryx2");
    if !program.exists() {
        return None;
    }
    // Should it hang, nobody waits for it.
    let mut command = Command::new("timeout");
    let run = command.arg("30").arg(&program).args([bytes.to_string(), count.to_string()]).output();
    let text = String::from_utf8(run.ok()?.stdout).ok()?;
    text.lines().last()?.split(' ').next()?.parse().ok()
}
