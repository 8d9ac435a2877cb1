//! `display`: where video ends: off-screen with its figures, in a browser as MJPEG, in a window.
//!
//! Invariant: the step counts, and copies a frame where somebody looks, or may come, and a free buffer is
//! there; whatever waits for people or networks is in threads of its own.
#![forbid(unsafe_code)]

mod component;
mod freshness;
mod handoff;
mod latency;
mod mark;
mod mjpeg;
mod reply;
mod request;
mod server;
mod viewing;
#[cfg(test)]
#[path = "../../../tests/src/watchdog.rs"]
#[allow(unreachable_pub, reason = "it is public where it lies")]
mod watchdog;
mod window;

pub use component::Display;
pub use latency::Latency;
pub use server::Serving;

trocar_sdk::trocar_plugin!(Display);
