//! Ways in and out without Rust: `lines_source` makes typed outputs of lines that a program prints, that come
//! as datagrams or over a serial line; `lines_sink` writes what its inputs bring as lines.
//!
//! Invariant: lines are read and written on threads beside the step; whatever comes in them, a bad line is
//! counted and nothing else.
#![forbid(unsafe_code)]

mod clock;
mod described;
mod goal;
mod lines_sink;
mod lines_source;
mod pieces;
mod plan;
mod reader;
mod serial;
mod spelled;
mod values;
#[cfg(test)]
#[path = "../../../tests/src/watchdog.rs"]
#[allow(unreachable_pub, reason = "it is public where it lies")]
mod watchdog;
mod way;
mod writer;

pub use lines_sink::{Given, LinesSink};
pub use lines_source::{BadLine, LinesSource, Taken};

trocar_sdk::trocar_plugin!(LinesSource, LinesSink);
