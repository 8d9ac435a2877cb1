//! Where the built things are: the binary `trocar`, the plugins, the fixtures, grpcurl.
//!
//! Invariant: a missing one ends the test with the command that provides it; nothing is skipped here.

use std::env;
use std::path::{Path, PathBuf};

/// What `./tests/run` has built and fetched.
pub struct Built;

impl Built {
    /// The binary `trocar`.
    #[must_use]
    pub fn trocar() -> PathBuf {
        present(Self::dir().join("trocar"))
    }

    /// The directory of the built binary and plugins.
    #[must_use]
    pub fn dir() -> PathBuf {
        from_env("TROCAR_BIN_DIR")
    }

    /// A plugin of `plugins/` or a Rust fixture, by the name of its library: `eyerobot` is
    /// `libtrocar_eyerobot.so`.
    #[must_use]
    pub fn plugin(name: &str) -> PathBuf {
        present(Self::dir().join(format!("libtrocar_{name}.so")))
    }

    /// A fixture plugin that a C++ compiler built.
    #[must_use]
    pub fn cpp_plugin(name: &str) -> PathBuf {
        present(from_env("TROCAR_CPP_DIR").join(format!("libtrocar_{name}.so")))
    }

    #[must_use]
    pub fn grpcurl() -> PathBuf {
        from_env("GRPCURL")
    }
}

/// The root of the checkout.
#[must_use]
pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().map(Path::to_path_buf).unwrap_or_default()
}

fn from_env(name: &str) -> PathBuf {
    env::var_os(name).map(PathBuf::from).unwrap_or_else(|| {
        panic!("{name} is not set: the outer tests are run by ./tests/run, which builds what they need")
    })
}

fn present(path: PathBuf) -> PathBuf {
    assert!(path.exists(), "{} is not there: run ./tests/run, which builds it", path.display());
    path
}
