//! Writes `proto/src/gen` from the `.proto` files, and the sums by which a test sees that both belong
//! together.
//!
//! Invariant: needs no protoc, so that a machine with only a Rust toolchain can regenerate.
//!
//! `cargo run --manifest-path proto/generate/Cargo.toml` writes; with `-- --check` it compares and writes
//! nothing.
#![forbid(unsafe_code)]

use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::{env, fs};

use prost::Message;
use sha2::{Digest, Sha256};

const FILES: [&str; 7] = ["types", "gcm", "attach", "interact", "plugin", "guest", "agent"];
const JOURNAL: &str = "trocar/journal/v1/journal.proto";
const JOURNAL_CODE: &str = "trocar.journal.v1.rs";
const ETCD: &str = "etcdserverpb/rpc.proto";
const ETCD_CODE: &str = "etcdserverpb.rs";
const GENERATED: [&str; 4] = ["trocar.v1.rs", "trocar.v1.bin", JOURNAL_CODE, ETCD_CODE];
const SUMS: &str = "sha256";

fn main() -> Result<ExitCode, Box<dyn Error>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize()?;
    let committed = root.join("src/gen");
    match env::args().nth(1).as_deref() {
        None => {
            generate(&root, &committed)?;
            Ok(ExitCode::SUCCESS)
        }
        Some("--check") => check(&root, &committed),
        Some(other) => Err(format!("`{other}` is not an option; --check compares and writes nothing").into()),
    }
}

/// Compares the committed files with what the `.proto` files give.
fn check(root: &Path, committed: &Path) -> Result<ExitCode, Box<dyn Error>> {
    let fresh = Scratch::new("check")?;
    generate(root, &fresh.0)?;
    let differs = |name: &&str| fs::read(fresh.0.join(name)).ok() != fs::read(committed.join(name)).ok();
    let stale: Vec<&str> = GENERATED.iter().chain([&SUMS]).copied().filter(|name| differs(&name)).collect();
    if stale.is_empty() {
        return Ok(ExitCode::SUCCESS);
    }
    eprintln!(
        "proto/src/gen is not what the .proto files give ({}): run \
         `cargo run --manifest-path proto/generate/Cargo.toml` and commit proto/src/gen",
        stale.join(", ")
    );
    Ok(ExitCode::FAILURE)
}

/// Writes code, descriptors and sums into `out`.
fn generate(root: &Path, out: &Path) -> Result<(), Box<dyn Error>> {
    let mut compiler = protox::Compiler::new([root])?;
    compiler.include_imports(true).include_source_info(true);
    compiler.open_files(FILES.map(|file| format!("trocar/v1/{file}.proto")))?;
    let set = compiler.file_descriptor_set();
    // `rpc Connect` would collide with the constructor that `build_transport(true)` makes.
    tonic_prost_build::configure()
        .build_transport(false)
        .out_dir(out)
        .emit_rerun_if_changed(false)
        .compile_fds(set.clone())?;
    fs::write(out.join("trocar.v1.bin"), set.encode_to_vec())?;
    journal(root, out)?;
    etcd(root, out)?;

    let files = FILES.map(|file| format!("trocar/v1/{file}.proto"));
    let sources =
        files.into_iter().chain([JOURNAL.to_owned(), ETCD.to_owned()]).map(|file| (file, root.to_path_buf()));
    let results = GENERATED.map(|name| (name.to_owned(), out.to_path_buf()));
    let mut sums = String::new();
    for (name, folder) in sources.into_iter().chain(results) {
        let sum = Sha256::digest(fs::read(folder.join(&name))?);
        let hex: String = sum.iter().map(|byte| format!("{byte:02x}")).collect();
        sums.push_str(&format!("{hex}  {name}\n"));
    }
    fs::write(out.join(SUMS), sums)?;
    Ok(())
}

/// Writes the code of the journal. It is no part of the descriptors: no port speaks it.
fn journal(root: &Path, out: &Path) -> Result<(), Box<dyn Error>> {
    let mut compiler = protox::Compiler::new([root])?;
    compiler.include_imports(true).include_source_info(true);
    compiler.open_file(JOURNAL)?;
    // Code of the files that it imports is made, too, and is there already.
    let all = Scratch::new("journal")?;
    tonic_prost_build::configure()
        .build_client(false)
        .build_server(false)
        .out_dir(&all.0)
        .emit_rerun_if_changed(false)
        .compile_fds(compiler.file_descriptor_set())?;
    fs::copy(all.0.join(JOURNAL_CODE), out.join(JOURNAL_CODE))?;
    Ok(())
}

/// Writes the code of etcd's API, which trocar calls and no port serves.
fn etcd(root: &Path, out: &Path) -> Result<(), Box<dyn Error>> {
    let mut compiler = protox::Compiler::new([root])?;
    compiler.include_source_info(true);
    compiler.open_file(ETCD)?;
    tonic_prost_build::configure()
        .build_server(false)
        .build_transport(false)
        .out_dir(out)
        .emit_rerun_if_changed(false)
        .compile_fds(compiler.file_descriptor_set())?;
    Ok(())
}

/// A directory that is removed with its owner.
struct Scratch(PathBuf);

impl Scratch {
    fn new(of: &str) -> std::io::Result<Self> {
        let path = env::temp_dir().join(format!("trocar-generate-{of}-{}", std::process::id()));
        fs::create_dir(&path)?;
        Ok(Self(path))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // A directory that stays behind harms nobody.
        let _ = fs::remove_dir_all(&self.0);
    }
}
