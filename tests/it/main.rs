//! The outer tests: one module per promise, each against built binaries, real plugins and real grpcurl.
//!
//! Invariant: run by `./tests/run`, which builds and fetches what they need; without it they fail and say so.
#![allow(clippy::unwrap_used)]

mod arrows;
mod cli;
mod control_plane;
mod cpp_plugin;
mod demo;
mod deployment;
mod faults;
mod fig4;
mod plugin_guide;
mod plugin_loading;
