//! `display`: where video ends: its figures, and a window. The picture's address is `/video` of the host.
//!
//! Invariant: the step counts, and copies a frame where a window is open and a free buffer is there; whatever
//! waits for people is in a thread of its own.
#![forbid(unsafe_code)]
#![cfg_attr(not(feature = "window"), allow(dead_code, reason = "only a window draws"))]

mod component;
mod drawing;
mod freshness;
mod handoff;
mod latency;
mod mark;
mod window;

pub use component::Display;
pub use latency::Latency;

trocar_sdk::trocar_plugin!(Display);
