//! The dlopen boundary between a trocar host and its plugins: `repr(C)` tables, payload descriptions, the
//! manifest.
//!
//! Invariant: append, never edit. A table starts with its `struct_size`; an entry is read only when it lies
//! inside it. Nothing allocated on one side is freed on the other. `sdk/c/trocar_plugin.h` is the same
//! contract for C and C++.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod abi;
mod const_text;
#[cfg(feature = "manifest")]
pub mod contracts;
pub mod desc;
pub mod environment;
#[cfg(feature = "layout")]
pub mod layout;
pub mod limits;
#[cfg(feature = "manifest")]
pub mod manifest;
pub mod note;
pub mod rate;
mod render;
mod types;
pub mod units;

pub use abi::{ABI_MAJOR, ABI_MINOR, ENTRY_SYMBOL, EntryFn, has_entry};
pub use render::{render, render_description};

#[cfg(not(all(
    target_os = "linux",
    target_env = "gnu",
    any(target_arch = "x86_64", target_arch = "aarch64")
)))]
compile_error!("trocar runs on Linux with glibc, x86-64 or aarch64; Python clients run anywhere");
